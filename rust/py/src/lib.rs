//! The Python module `ccdiff_env._native`: a translation, no arithmetic. It needs no torch.

mod causal;
mod drivers;
mod egos;
mod enter;
mod logged_batch;
mod map_queries;
mod metrics;
mod networks;
mod planner;
mod python_policy;
mod render;
mod scene;
mod scene_map;
mod schemas;
mod step_arrays;
mod swift;
mod traffic_batch;
mod world;
mod world_plans;
mod world_state;

use pyo3::prelude::*;

/// A number that `_models` compares with its own: how the simulator within was compiled.
#[pyfunction]
fn build_mark() -> u64 {
    ccdiff_sim::build_mark()
}

/// Holds all later work of the process to the instructions that every processor has; the bits stay the same.
#[pyfunction]
fn hold_to_base() {
    ccdiff_sim::hold_to_base();
}

#[pymodule]
fn _native(m: &Bound<'_, PyModule>) -> PyResult<()> {
    causal::register(m)?;
    logged_batch::register(m)?;
    map_queries::register(m)?;
    metrics::register(m)?;
    networks::register(m)?;
    drivers::register(m)?;
    egos::register(m)?;
    swift::register(m)?;
    planner::register(m)?;
    render::register(m)?;
    scene::register(m)?;
    schemas::register(m)?;
    world::register(m)?;
    m.add_function(wrap_pyfunction!(build_mark, m)?)?;
    m.add_function(wrap_pyfunction!(hold_to_base, m)?)?;
    Ok(())
}
