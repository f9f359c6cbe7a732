//! A traffic model written in Python, as a driver of a batch: one call per plan phase for all worlds that are due.

use crate::traffic_batch::{self, Row, Told};
use ccdiff_sim::SimError;
use ccdiff_sim::drivers::{Driver, DriverModel, Kind, PlanRecord, PlanRequest, PlanState};
use ccdiff_sim::dynamics::Dynamics;
use ccdiff_sim::geom::{Pose2, Vector2};
use ccdiff_sim::options;
use ccdiff_sim::options::within;
use numpy::{PyArray3, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Traffic of a model of the user's own.
pub(crate) const KIND: Kind = Kind {
    name: "python",
    title: "Python model",
    style: "other",
    options: Some(&PythonOptions::TABLE),
    always: false,
    make: None,
};

options! {
    /// Options of a custom traffic model, written in Python: `ccdiff_env.traffic.PythonTraffic`.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct PythonOptions {
        /// The model; in files its path, `"module:name"`, for the reader.
        model: String = String::new();
        /// Steps from one plan to the next.
        replan_steps: usize = 5, range within(1.0, 10_000.0);
        /// Past states of each agent, the present one included.
        history_states: usize = 31, range within(1.0, 1000.0);
        /// Fewest states that the log must have at the start of an episode, the present one included; an environment
        /// that starts earlier is refused. Missing states are not valid.
        least_history_states: usize = 1, range within(1.0, 1000.0);
        /// Points on each vehicle's route, 2 m apart from its position on.
        route_points: usize = 41, range within(0.0, 1000.0);
    }
}

/// Traffic that follows the plans of a Python object.
pub(crate) struct PythonDriver {
    name: String,
    options: PythonOptions,
    /// Called with the arrays of [`traffic_batch::arrays`]; returns float32 [M, T, 3] or [M, T, 2].
    model: Py<PyAny>,
    dynamics: Dynamics,
}

impl PythonDriver {
    pub(crate) fn new(name: &str, options: PythonOptions, model: Py<PyAny>) -> Self {
        Self { name: name.into(), options, model, dynamics: Dynamics::default() }
    }

    /// What the model is told of the worlds that are due.
    fn told<'a>(&self, due: &[&PlanRequest<'a>]) -> ccdiff_sim::Result<Vec<Told<'a>>> {
        let of_world = |request: &&PlanRequest<'a>| {
            let world = request.world;
            let history = world.history.filter(|h| h.len() >= self.options.history_states);
            let history = history.ok_or_else(|| {
                let message = "the world keeps too short a history".into();
                SimError::Driver { driver: self.name.clone(), message }
            })?;
            let row = |agent_idx: usize| Row {
                agent_idx,
                drives: request.drives(agent_idx),
                is_ego: world.drivers[agent_idx] == Driver::External || world.ego == Some(agent_idx),
                // kept for route followers only
                route_s_m: match world.drivers[agent_idx] {
                    Driver::REPLAY => {
                        let path = &world.scene.routes[agent_idx].path;
                        path.project(world.states.position(agent_idx)).s_m
                    }
                    _ => world.route_s_m[agent_idx],
                },
            };
            let active = &world.states.active;
            Ok(Told {
                scene: world.scene,
                scene_idx: world.scene_idx,
                history,
                elapsed_steps: world.elapsed_steps,
                seed: world.noise_seed,
                criticality: request.plan_override.criticality.unwrap_or_default(),
                rows: (0..active.len()).filter(|a| active[*a]).map(row).collect(),
            })
        };
        due.iter().map(of_world).collect()
    }

    fn ask(&self, py: Python<'_>, due: &[&PlanRequest<'_>], told: &[Told<'_>]) -> PyResult<Vec<PlanState>> {
        let (states, points) = (self.options.history_states, self.options.route_points);
        let answer = self.model.bind(py).call1((traffic_batch::arrays(py, told, states, points)?,))?;
        let answer = answer.cast_into::<PyArray3<f32>>()?;
        let (steps, width) = (answer.shape()[1], answer.shape()[2]);
        let answer = answer.try_readonly()?;
        let flat = answer.as_slice()?;
        let mut plans = vec![PlanState::default(); due.len()];
        // the caller has checked the shape
        let rows = told.iter().enumerate().flat_map(|(w, world)| world.rows.iter().map(move |row| (w, row)));
        for ((w, row), plan) in rows.zip(flat.chunks_exact((steps * width).max(1))) {
            if row.drives {
                self.add(&mut plans[w], due[w], row.agent_idx, plan, width);
            }
        }
        for (PlanState { record, .. }, request) in plans.iter_mut().zip(due) {
            let PlanRecord { agents, samples, .. } = std::mem::take(record);
            let made = PlanRecord::of_one_sample(request.world.elapsed_steps, agents, steps);
            *record = PlanRecord { samples, ..made };
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
        let (states, dt_s) = (request.world.states, request.world.dt_s);
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

impl DriverModel for PythonDriver {
    fn name(&self) -> &str {
        "python"
    }

    fn history_states(&self) -> usize {
        self.options.history_states
    }

    fn least_history_states(&self) -> usize {
        self.options.least_history_states
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> ccdiff_sim::Result<Vec<Option<PlanState>>> {
        let is_due: Vec<bool> = requests.iter().map(|r| r.is_due(self.options.replan_steps)).collect();
        let due: Vec<&PlanRequest<'_>> =
            requests.iter().zip(&is_due).filter(|(_, due)| **due).map(|(r, _)| r).collect();
        let told = self.told(&due)?;
        if told.iter().all(|world| world.rows.is_empty()) {
            return Ok(vec![None; requests.len()]);
        }
        let plans = Python::attach(|py| {
            self.ask(py, &due, &told).map_err(|error| {
                let message = error.to_string();
                // left where the caller finds it: the model's own exception reaches the user
                error.restore(py);
                SimError::Driver { driver: self.name.clone(), message }
            })
        })?;
        let mut plans = plans.into_iter();
        Ok(is_due.into_iter().map(|due| if due { plans.next() } else { None }).collect())
    }
}
