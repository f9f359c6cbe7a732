//! The Python module `ccdiff_env._models`: networks on libtorch, loaded when one is first wanted.
//!
//! `import torch` comes first: it brings libtorch into the process.

mod models;
mod traffic;

use pyo3::prelude::*;

#[pymodule]
fn _models(m: &Bound<'_, PyModule>) -> PyResult<()> {
    ccdiff_bridge::check_build(&m.py().import("ccdiff_env._native")?)?;
    ccdiff_models::guidance::connect(ccdiff_bridge::call_cost);
    models::register(m)?;
    traffic::register(m)
}
