//! Scenes and policies on their way from one extension module to the other, in capsules.

use crate::errors::py;
use ccdiff_sim::policy::TrafficPolicy;
use ccdiff_sim::scene::Scene;
use pyo3::exceptions::{PyImportError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use std::ffi::CStr;
use std::sync::{Arc, Mutex, PoisonError};

const SCENE: &CStr = c"ccdiff_env._native.scene";
const POLICY: &CStr = c"ccdiff_env._models.policy";

/// A policy of a batch of worlds.
pub type Policy = Box<dyn TrafficPolicy>;

/// Compares how the two modules were compiled.
///
/// # Errors
/// `ImportError` where they differ.
pub fn check_build(native: &Bound<'_, PyModule>) -> PyResult<()> {
    let theirs: u64 = native.call_method0("build_mark")?.extract()?;
    if theirs == ccdiff_sim::build_mark() {
        return Ok(());
    }
    Err(PyImportError::new_err(
        "ccdiff_env._models and ccdiff_env._native are of different builds: install the package again (make setup)",
    ))
}

/// A scene for the other module.
///
/// # Errors
/// Those of Python.
pub fn scene_capsule(py: Python<'_>, scene: Arc<Scene>) -> PyResult<Bound<'_, PyCapsule>> {
    PyCapsule::new_with_value(py, scene, SCENE)
}

/// A scene of `_native`, as an argument of a function of `_models`.
#[derive(Clone)]
pub struct Handed(pub Arc<Scene>);

impl<'a, 'py> FromPyObject<'a, 'py> for Handed {
    type Error = PyErr;

    fn extract(scene: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let Ok(capsule) = scene.call_method0("_handed") else {
            let got = scene.get_type().name()?;
            return Err(PyTypeError::new_err(format!("{got} is not a Scene")));
        };
        let pointer = capsule.cast::<PyCapsule>()?.pointer_checked(Some(SCENE))?.cast::<Arc<Scene>>();
        #[allow(unsafe_code, reason = "modules of one build: check_build")]
        // SAFETY: the capsule of this name holds an `Arc<Scene>` and is alive; both modules have the same layout of it
        Ok(Self(Arc::clone(unsafe { pointer.as_ref() })))
    }
}

/// A policy for the other module, which takes it out once.
///
/// # Errors
/// Those of Python.
pub fn policy_capsule(py: Python<'_>, policy: Policy) -> PyResult<Bound<'_, PyCapsule>> {
    PyCapsule::new_with_value(py, Mutex::new(Some(policy)), POLICY)
}

/// The policy in a capsule of the other module.
///
/// # Errors
/// `PolicyError` where it has been taken before.
pub fn taken_policy(capsule: &Bound<'_, PyCapsule>) -> PyResult<Policy> {
    let pointer = capsule.pointer_checked(Some(POLICY))?.cast::<Mutex<Option<Policy>>>();
    #[allow(unsafe_code, reason = "modules of one build: check_build")]
    // SAFETY: the capsule of this name holds such a lock and is alive; both modules have the same layout of it
    let slot = unsafe { pointer.as_ref() };
    let taken = slot.lock().unwrap_or_else(PoisonError::into_inner).take();
    taken.ok_or_else(|| {
        py::PolicyError::new_err("a policy drives one batch of worlds: this one drives another")
    })
}
