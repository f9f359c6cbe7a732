//! A traffic model written in Python, as a policy of a batch: one call per plan phase for all worlds that are due.

use ccdiff_sim::SimError;
use ccdiff_sim::dynamics::Dynamics;
use ccdiff_sim::geom::{Pose2, Vector2};
use ccdiff_sim::options;
use ccdiff_sim::options::within;
use ccdiff_sim::policy::{PlanRecord, PlanRequest, PlanState, TrafficPolicy};
use numpy::{Element, PyArray1, PyArray3, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

options! {
    /// Options of a traffic model of one's own, written in Python: `ccdiff_env.traffic.PythonTraffic`.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct PythonOptions {
        /// The model; in files its path, `"module:name"`, for the reader.
        model: String = String::new();
        /// Steps from one plan to the next.
        replan_steps: usize = 5, range within(1.0, 10_000.0);
        /// Past states of each agent, the present one included.
        history_states: usize = 31, range within(1.0, 1000.0);
    }
}

/// Traffic that follows the plans of a Python object.
pub(crate) struct PythonPolicy {
    name: String,
    options: PythonOptions,
    /// Called with the arrays of [`PythonPolicy::arrays`]; returns float32 [M, T, 3] or [M, T, 2].
    model: Py<PyAny>,
    dynamics: Dynamics,
}

/// Agents of the worlds that are due: number of the world among them, and index in its scene.
type Rows = Vec<(usize, usize)>;

impl PythonPolicy {
    pub(crate) fn new(name: &str, options: PythonOptions, model: Py<PyAny>) -> Self {
        Self { name: name.into(), options, model, dynamics: Dynamics::default() }
    }

    /// What the model is told: M agents of W worlds, H states each.
    fn arrays<'py>(
        &self,
        py: Python<'py>,
        due: &[&PlanRequest<'_>],
        rows: &Rows,
    ) -> PyResult<Bound<'py, PyDict>> {
        fn shaped<'py, T: Element>(
            py: Python<'py>,
            values: Vec<T>,
            shape: &[usize],
        ) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
            PyArray1::from_vec(py, values).reshape(shape)
        }
        let (m, h) = (rows.len(), self.options.history_states);
        let past = rows.iter().flat_map(|(w, a)| {
            let history = due[*w].world.history;
            let first = history.map_or(0, |p| p.len().saturating_sub(h));
            (first..first + h).filter_map(move |k| history.map(|p| p.at(*a, k)))
        });
        let past: Vec<_> = past.collect();
        let world = |row: &(usize, usize)| due[row.0].world;
        let of_rows = |f: &dyn Fn(&(usize, usize)) -> i64| rows.iter().map(f).collect::<Vec<_>>();
        let of_worlds = |f: &dyn Fn(&PlanRequest<'_>) -> i64| due.iter().map(|r| f(r)).collect::<Vec<_>>();
        let footprint = |row: &(usize, usize)| {
            let agent = &world(row).scene.scene.agents[row.1];
            [agent.length_m, agent.width_m]
        };
        let dict = PyDict::new(py);
        let position = past.iter().flat_map(|p| [p.position.x, p.position.y]).collect();
        dict.set_item("position_m", shaped::<f32>(py, position, &[m, h, 2])?)?;
        let heading = past.iter().map(|p| p.heading_rad).collect();
        dict.set_item("heading_rad", shaped::<f32>(py, heading, &[m, h])?)?;
        let speed = past.iter().map(|p| p.speed_mps).collect();
        dict.set_item("speed_mps", shaped::<f32>(py, speed, &[m, h])?)?;
        dict.set_item("valid", shaped(py, past.iter().map(|p| p.valid).collect(), &[m, h])?)?;
        dict.set_item("size_m", shaped(py, rows.iter().flat_map(footprint).collect(), &[m, 2])?)?;
        let kinds = rows.iter().map(|row| world(row).scene.kinds[row.1] as u8).collect();
        dict.set_item("kind", shaped::<u8>(py, kinds, &[m])?)?;
        let drives = rows.iter().map(|(w, a)| due[*w].drives(*a)).collect();
        dict.set_item("drives", shaped::<bool>(py, drives, &[m])?)?;
        dict.set_item("world", shaped(py, of_rows(&|r| r.0 as i64), &[m])?)?;
        dict.set_item("agent", shaped(py, of_rows(&|r| r.1 as i64), &[m])?)?;
        dict.set_item("scene_idx", shaped(py, of_worlds(&|r| r.world.scene_idx as i64), &[due.len()])?)?;
        let elapsed = of_worlds(&|r| r.world.elapsed_steps as i64);
        dict.set_item("elapsed_steps", shaped(py, elapsed, &[due.len()])?)?;
        let seeds = due.iter().map(|r| r.world.noise_seed).collect();
        dict.set_item("seed", shaped::<u64>(py, seeds, &[due.len()])?)?;
        Ok(dict)
    }

    fn ask(&self, py: Python<'_>, due: &[&PlanRequest<'_>], rows: &Rows) -> PyResult<Vec<PlanState>> {
        let answer = self.model.bind(py).call1((self.arrays(py, due, rows)?,))?;
        let answer = answer.cast_into::<PyArray3<f32>>()?;
        let (steps, width) = (answer.shape()[1], answer.shape()[2]);
        let answer = answer.try_readonly()?;
        let flat = answer.as_slice()?;
        let mut plans: Vec<PlanState> = due.iter().map(|r| empty(r, steps)).collect();
        // whoever calls has checked the shape
        for (row, plan) in rows.iter().zip(flat.chunks_exact((steps * width).max(1))) {
            if due[row.0].drives(row.1) {
                self.add(&mut plans[row.0], due[row.0], row.1, plan, width);
            }
        }
        for plan in &mut plans {
            let p = &mut plan.record;
            let m = p.agents.len();
            (p.follows_plan, p.guided, p.selected_sample) = (vec![true; m], vec![false; m], vec![0; m]);
            (p.graph, p.ttc_s) = (vec![false; m * m], vec![f32::INFINITY; m * m]);
            p.realism_cost = vec![0.0; m];
            p.shift_sigmas = vec![0.0; m];
        }
        Ok(plans)
    }

    /// Adds what an agent does in the coming steps: poses, or actions of the unicycle.
    fn add(
        &self,
        plan: &mut PlanState,
        request: &PlanRequest<'_>,
        agent_idx: usize,
        steps: &[f32],
        width: usize,
    ) {
        let (states, dt_s) = (request.world.states, request.world.config.dt_s);
        let footprint = &request.world.scene.footprints[agent_idx];
        let mut kin = states.kin_state(agent_idx);
        let mut at = states.position(agent_idx);
        plan.record.agents.push(agent_idx);
        for step in steps.chunks_exact(width) {
            if let [acceleration, yaw_rate] = step {
                self.dynamics.step(&mut kin, [*acceleration, *yaw_rate, 0.0], dt_s, footprint);
                plan.record.samples.extend([kin.x, kin.y, kin.heading_rad]);
                plan.speed_mps.push(kin.speed_mps);
            } else if let [x, y, heading_rad] = step {
                let pose = Pose2::new(*x, *y, *heading_rad);
                let way = pose.position - at;
                at = pose.position;
                plan.record.samples.extend([*x, *y, *heading_rad]);
                plan.speed_mps.push(way.dot(&Vector2::new(pose.cos, pose.sin)) / dt_s);
            }
        }
    }
}

/// A plan without agents.
fn empty(request: &PlanRequest<'_>, steps: usize) -> PlanState {
    let (made_at, num_samples, num_steps) = (request.world.elapsed_steps, 1, steps);
    PlanState {
        record: PlanRecord { made_at, num_samples, num_steps, ..PlanRecord::default() },
        ..PlanState::default()
    }
}

impl TrafficPolicy for PythonPolicy {
    fn name(&self) -> &str {
        "python"
    }

    fn history_states(&self) -> usize {
        self.options.history_states
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> ccdiff_sim::Result<Vec<Option<PlanState>>> {
        let is_due: Vec<bool> = requests.iter().map(|r| r.is_due(self.options.replan_steps)).collect();
        let due: Vec<&PlanRequest<'_>> =
            requests.iter().zip(&is_due).filter(|(_, due)| **due).map(|(r, _)| r).collect();
        let there = |(w, r): (usize, &&PlanRequest<'_>)| {
            let active = &r.world.states.active;
            (0..active.len()).filter(|a| active[*a]).map(move |a| (w, a)).collect::<Vec<_>>()
        };
        let rows: Rows = due.iter().enumerate().flat_map(there).collect();
        if rows.is_empty() {
            return Ok(vec![None; requests.len()]);
        }
        let plans = Python::attach(|py| {
            self.ask(py, &due, &rows).map_err(|error| {
                let message = error.to_string();
                // left where the caller finds it: the model's own exception reaches the user
                error.restore(py);
                SimError::Policy { policy: self.name.clone(), message }
            })
        })?;
        let mut plans = plans.into_iter();
        Ok(is_due.into_iter().map(|due| if due { plans.next() } else { None }).collect())
    }
}
