//! Batches for traffic models in Python from logs: what a model is told in a world that stands there, and what came after.

use crate::scene::PyScene;
use crate::traffic_batch::{Row, Told, arrays, set_states};
use ccdiff_bridge::errors::py::{ConfigError, SceneError, ShapeError};
use ccdiff_sim::scene::{AgentKind, EGO_ID, Scene};
use ccdiff_sim::stage::{History, PreparedScene};
use ccdiff_sim::world::Rng;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Refuses scenes and steps that make no batch.
fn check(scenes: &[Arc<Scene>], steps: &[usize]) -> PyResult<()> {
    if scenes.len() != steps.len() {
        let message =
            format!("steps has {} elements, expected {}, one for each scene", steps.len(), scenes.len());
        return Err(ShapeError::new_err(message));
    }
    for (scene, step) in scenes.iter().zip(steps) {
        if *step >= scene.num_steps {
            let (name, most) = (&scene.name, scene.num_steps - 1);
            return Err(ConfigError::new_err(format!(
                "steps: {step} of scene {name:?}, expected 0 to {most}"
            )));
        }
        if (scene.dt_s - scenes[0].dt_s).abs() > 1e-6 {
            let (name, dt_s, expected) = (&scene.name, scene.dt_s, scenes[0].dt_s);
            let message =
                format!("scene {name:?}: dt is {dt_s}, expected {expected}, that of the first scene");
            return Err(SceneError::new_err(message));
        }
    }
    Ok(())
}

/// The arrays of a batch at steps of logged scenes, and the logged states after them: `position_m` [M, F, 2],
/// `heading_rad`, `speed_mps`, `valid` [M, F].
#[pyfunction]
pub(crate) fn traffic_batch_from_log<'py>(
    py: Python<'py>,
    scenes: Vec<PyRef<'py, PyScene>>,
    steps: Vec<usize>,
    num_states: usize,
    num_points: usize,
    num_future: usize,
    seed: u64,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    let logged: Vec<Arc<Scene>> = scenes.iter().map(|s| Arc::clone(&s.scene)).collect();
    check(&logged, &steps)?;
    let prepared: Vec<Arc<PreparedScene>> = scenes.iter().map(|s| s.prepared()).collect();
    let histories: Vec<History> =
        logged.iter().zip(&steps).map(|(scene, step)| History::from_log(scene, *step, num_states)).collect();
    let worlds: Vec<Told<'_>> = prepared
        .iter()
        .zip(&histories)
        .zip(&steps)
        .enumerate()
        .map(|(w, ((scene, history), step))| {
            let there = (0..scene.scene.num_agents()).filter(|a| scene.scene.is_valid(*a, *step));
            let row = |agent_idx: usize| Row {
                agent_idx,
                drives: scene.kinds[agent_idx] == AgentKind::Vehicle,
                is_ego: scene.scene.agents[agent_idx].id == EGO_ID,
                route_s_m: scene.logged_s_m(agent_idx, *step),
            };
            let seed = Rng::new(seed).split(w as u64).next_u64();
            let rows = there.map(row).collect();
            Told { scene, scene_idx: w, history, elapsed_steps: 0, seed, criticality: 0.0, rows }
        })
        .collect();
    let batch = arrays(py, &worlds, num_states, num_points)?;
    let mut after = Vec::new();
    for (world, step) in worlds.iter().zip(&steps) {
        let future = History::from_log(&world.scene.scene, step.saturating_add(num_future), num_future);
        after.extend(
            world
                .rows
                .iter()
                .flat_map(|row| (0..num_future).map(|k| future.at(row.agent_idx, k)).collect::<Vec<_>>()),
        );
    }
    let future = PyDict::new(py);
    let num_rows = worlds.iter().map(|w| w.rows.len()).sum();
    set_states(&future, &after, [num_rows, num_future])?;
    Ok((batch, future))
}
