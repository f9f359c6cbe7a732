//! The Python module `ccdiff_env._native`: a translation, no arithmetic.

mod errors;

use pyo3::prelude::*;

#[pymodule]
fn _native(_m: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
