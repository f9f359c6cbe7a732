//! Losses of the user's own, in Python: how the networks' guidance calls them.

use ccdiff_nets::guidance::{Called, GuidanceContext, PythonCost, Rollout};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray4};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Mutex;

/// What costs raised, until the failed plan raises it anew.
static RAISED: Mutex<Vec<PyErr>> = Mutex::new(Vec::new());

/// What a cost raised for which a plan failed, in these words.
pub(crate) fn raised(message: &str) -> Option<PyErr> {
    let all = RAISED.lock().map(|mut all| std::mem::take(&mut *all)).unwrap_or_default();
    all.into_iter().find(|error| message.contains(&error.to_string()))
}

/// Calls `ccdiff_env.traffic.cost.evaluate` with the states [N, M, T, 4] of samples of a world, and with what is known of its
/// agents. What it raises is kept ([`raised`]): planning threads cannot raise it.
pub fn call_cost(
    cost: &PythonCost,
    context: &GuidanceContext<'_>,
    plans: &[&Rollout],
    moves: bool,
) -> Result<Called, String> {
    let (m, t) = (context.num_agents(), plans.first().map_or(0, |plan| plan.num_steps));
    let call = |py: Python<'_>| -> PyResult<Called> {
        let of_plan = |plan: &&Rollout| {
            let row = |at: usize| {
                let heading_rad = libm::atan2f(plan.sin[at], plan.cos[at]);
                [plan.x_m[at], plan.y_m[at], plan.speed_mps[at], heading_rad]
            };
            (0..m * t).flat_map(row).collect::<Vec<f32>>()
        };
        let states: Vec<f32> = plans.iter().flat_map(of_plan).collect();
        let states = PyArray1::from_vec(py, states).reshape([plans.len(), m, t, 4])?;
        let known = PyDict::new(py);
        let rows =
            |row: &dyn Fn(usize) -> Vec<f32>| (0..m).flat_map(row).collect::<Vec<f32>>().into_pyarray(py);
        let pose = |a: usize| {
            let pose = context.poses[a];
            vec![pose.position.x, pose.position.y, pose.heading_rad]
        };
        known.set_item("pose", rows(&pose).reshape([m, 3])?)?;
        known.set_item("speed_mps", rows(&|a| vec![context.speed_mps[a]]))?;
        let size = |a: usize| vec![context.length_m[a], context.width_m[a]];
        known.set_item("size_m", rows(&size).reshape([m, 2])?)?;
        for (name, flags) in
            [("moving", &context.moving), ("guided", &context.guided), ("target", &context.partner)]
        {
            known.set_item(name, flags.clone().into_pyarray(py))?;
        }
        known.set_item("dt_s", context.dt_s)?;
        let arguments = (&cost.call, cost.own_gradient, moves, states, known);
        let made = py.import("ccdiff_env.traffic.cost")?.call_method1("evaluate", arguments)?;
        let (losses, gradient): (PyReadonlyArray2<'_, f32>, PyReadonlyArray4<'_, f32>) = made.extract()?;
        Ok((losses.as_slice()?.to_vec(), gradient.as_slice()?.to_vec()))
    };
    Python::attach(call).map_err(|error| {
        let message = error.to_string();
        if let Ok(mut all) = RAISED.lock() {
            all.push(error);
        }
        message
    })
}
