//! The arrays of a step that Rust writes.

use ccdiff_bridge::errors::py;
use ccdiff_sim::world::{ArraySpec, StepBuffers};
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// An array of a dtype and shape in C order.
pub(crate) fn typed<'a, 'py, T: Element>(
    what: &str,
    array: &'a Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<&'a Bound<'py, PyArrayDyn<T>>> {
    let fail = |got: String| {
        let dtype = numpy::dtype::<T>(array.py());
        Err(py::ShapeError::new_err(format!(
            "{what} is {got}, expected a C-contiguous {dtype} array of shape {shape:?}"
        )))
    };
    let Ok(typed) = array.cast::<PyArrayDyn<T>>() else {
        return match array.cast::<numpy::PyUntypedArray>() {
            Ok(other) => fail(format!("{} {:?}", other.dtype(), other.shape())),
            Err(_) => fail(array.get_type().name().map_or_else(|_| "no array".into(), |n| n.to_string())),
        };
    };
    if typed.shape() != shape || !typed.is_c_contiguous() {
        let layout = if typed.is_c_contiguous() { "" } else { ", not C-contiguous" };
        return fail(format!("{} {:?}{layout}", typed.dtype(), typed.shape()));
    }
    Ok(typed)
}

/// An array that Rust writes, checked for dtype, shape and layout.
pub(crate) fn writable<'py, T: Element>(
    what: &str,
    array: &Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    typed(what, array, shape)?.try_readwrite().map_err(|_| {
        py::ShapeError::new_err(format!(
            "{what} is read-only, or given twice, expected a writable array of its own"
        ))
    })
}

/// An array of a step; `None` where the configuration does not ask for it.
fn step_array<'py, T: Element>(
    array: &Bound<'py, PyAny>,
    spec: &ArraySpec,
) -> PyResult<Option<PyReadwriteArrayDyn<'py, T>>> {
    match (array.is_none(), spec.shape.is_empty()) {
        (true, true) => Ok(None),
        (false, true) => Err(py::ShapeError::new_err(format!("{} is given, expected None", spec.name))),
        _ => writable(spec.name, array, &spec.shape).map(Some),
    }
}

/// The elements of an array that may be absent.
pub(crate) fn elements<'a, T: Element>(
    array: &'a mut Option<PyReadwriteArrayDyn<'_, T>>,
) -> PyResult<&'a mut [T]> {
    Ok(match array {
        Some(array) => array.as_slice_mut()?,
        None => &mut [],
    })
}

macro_rules! outputs {
    ($($name:ident: $type:ty),+) => {
        /// The arrays of one call.
        pub(crate) struct Outputs<'py> {
            $(pub(crate) $name: Option<PyReadwriteArrayDyn<'py, $type>>),+
        }

        impl<'py> Outputs<'py> {
            /// Takes the arrays that a caller hands over in the order of their specifications.
            pub(crate) fn check(given: &Bound<'py, PyTuple>, specs: &[ArraySpec]) -> PyResult<Self> {
                if given.len() != specs.len() {
                    let (got, expected) = (given.len(), specs.len());
                    return Err(py::ShapeError::new_err(format!("{got} arrays, expected {expected}")));
                }
                let mut arrays = given.iter().zip(specs);
                let mut next = || arrays.next().ok_or_else(|| py::ShapeError::new_err("an array too few"));
                Ok(Self { $($name: { let (array, spec) = next()?; step_array(&array, spec)? }),+ })
            }

            pub(crate) fn buffers(&mut self) -> PyResult<StepBuffers<'_>> {
                Ok(StepBuffers { $($name: elements(&mut self.$name)?),+ })
            }
        }
    };
}

ccdiff_sim::with_step_arrays!(outputs);
