//! The Python module `ccdiff_env._native`: a translation, no arithmetic.

mod causal;
mod errors;
mod metrics;
mod models;
mod render;
mod scene;
mod scene_map;

use pyo3::prelude::*;

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    causal::register(m)?;
    metrics::register(m)?;
    models::register(m)?;
    render::register(m)?;
    scene::register(m)?;
    Ok(())
}
