//! Plans of a world as arrays, by the names of their table.

use ccdiff_sim::drivers::{PlanField, PlanRecord};
use numpy::{Element, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

/// A field of a plan's record as Python sees it; `field` where it is an array.
trait Shown {
    fn shown<'py>(&self, py: Python<'py>, field: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>>;
}

impl Shown for usize {
    fn shown<'py>(&self, py: Python<'py>, _: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>> {
        Ok(self.into_pyobject(py)?.into_any())
    }
}

impl Shown for Vec<String> {
    fn shown<'py>(&self, py: Python<'py>, _: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyTuple::new(py, self)?.into_any())
    }
}

impl Shown for Vec<usize> {
    fn shown<'py>(&self, py: Python<'py>, field: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.iter().map(|i| *i as i64).collect(), field)
    }
}

impl Shown for Vec<bool> {
    fn shown<'py>(&self, py: Python<'py>, field: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.clone(), field)
    }
}

impl Shown for Vec<f32> {
    fn shown<'py>(&self, py: Python<'py>, field: Option<&PlanField>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.clone(), field)
    }
}

/// A new array of the field's shape; `None` where it was not kept.
fn array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    field: Option<&PlanField>,
) -> PyResult<Bound<'py, PyAny>> {
    let array = PyArray1::from_vec(py, values);
    match field {
        Some(f) if f.optional && f.len == 0 => Ok(py.None().into_bound(py)),
        Some(f) => Ok(array.reshape(f.shape.as_slice())?.into_any()),
        None => Ok(array.into_any()),
    }
}

macro_rules! dictionary {
    ($($name:ident),+) => {
        /// A plan as a dictionary of new arrays: names and shapes as in [`PlanRecord`].
        pub(crate) fn dict<'py>(py: Python<'py>, plan: &PlanRecord) -> PyResult<Bound<'py, PyDict>> {
            let fields = plan.fields();
            let dict = PyDict::new(py);
            $(
                let name = stringify!($name);
                let field = fields.iter().find(|f| f.name == name);
                dict.set_item(name, plan.$name.shown(py, field)?)?;
            )+
            Ok(dict)
        }
    };
}

ccdiff_sim::with_plan_fields!(dictionary);
