//! The Python module `ccdiff_env._native`: a translation, no arithmetic.

mod causal;
mod drivers;
mod enter;
mod errors;
mod metrics;
mod models;
mod python_policy;
mod render;
mod scene;
mod scene_map;
mod world;
mod world_picture;
mod world_plans;
mod world_state;

use pyo3::prelude::*;

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    causal::register(m)?;
    metrics::register(m)?;
    drivers::register(m)?;
    models::register(m)?;
    render::register(m)?;
    scene::register(m)?;
    world::register(m)?;
    Ok(())
}
