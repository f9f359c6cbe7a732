//! Scenes and drivers on their way from one extension module to the other, in capsules.

use crate::errors::py;
use ccdiff_sim::drivers::DriverModel;
use ccdiff_sim::scene::Scene;
use pyo3::exceptions::{PyImportError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;
use std::ffi::CStr;
use std::sync::{Arc, Mutex, PoisonError};

const SCENE: &CStr = c"ccdiff_env._native.scene";
const DRIVER: &CStr = c"ccdiff_env._models.driver";

/// A driver of a batch of worlds.
pub type BoxedDriver = Box<dyn DriverModel>;

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

/// A driver for the other module, which takes it out once.
///
/// # Errors
/// Those of Python.
pub fn driver_capsule(py: Python<'_>, driver: BoxedDriver) -> PyResult<Bound<'_, PyCapsule>> {
    PyCapsule::new_with_value(py, Mutex::new(Some(driver)), DRIVER)
}

/// The driver in a capsule of the other module.
///
/// # Errors
/// `PolicyError` where it has been taken before.
pub fn take_driver(capsule: &Bound<'_, PyCapsule>) -> PyResult<BoxedDriver> {
    let pointer = capsule.pointer_checked(Some(DRIVER))?.cast::<Mutex<Option<BoxedDriver>>>();
    #[allow(unsafe_code, reason = "modules of one build: check_build")]
    // SAFETY: the capsule of this name holds such a lock and is alive; both modules have the same layout of it
    let slot = unsafe { pointer.as_ref() };
    let taken = slot.lock().unwrap_or_else(PoisonError::into_inner).take();
    taken.ok_or_else(|| {
        py::PolicyError::new_err("a driver drives one batch of worlds: this one drives another")
    })
}
