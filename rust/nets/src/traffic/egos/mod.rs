//! The policy of an ego as traffic: vehicles decide on what they would observe as the ego, and drive as it would.

mod network;

pub use network::NetworkOfEgo;

use crate::compute::weights::Entry;
use crate::error::Result;
use crate::traffic::{followed, stands};
use ccdiff_sim::drivers::{AgentMotion, DriverModel, Kind, PlanRecord, PlanRequest, PlanState, WorldView};
use ccdiff_sim::dynamics::Dynamics;
use ccdiff_sim::events::off_road;
use ccdiff_sim::geom::Real;
use ccdiff_sim::observe::{EgoFacts, Layout, ObservationConfig, Observer, View};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::world::{ActionConfig, ActionDecoder, assisted_action, place_on_route};
use ccdiff_sim::{SimError, options};
use std::collections::BTreeMap;

/// Traffic of egos.
pub const EGOS: Kind = Kind {
    name: "egos",
    title: "trained egos",
    style: "other",
    options: Some(&EgosConfig::TABLE),
    always: false,
    make: None,
};

options! {
    /// Options of traffic that the policy of an ego drives.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct EgosConfig {
        /// The policy: one of those that ship, or the path of a `.safetensors` file.
        policy: String = "ego".into();
    }
}

/// What a policy of an ego is made of.
#[derive(Debug)]
pub struct EgoParts {
    /// What it observes.
    pub observation: ObservationConfig,
    /// What its actions mean.
    pub action: ActionConfig,
    /// Steps for which it holds an action.
    pub decision_steps: usize,
    /// Its weights, by name.
    pub tensors: BTreeMap<String, Entry>,
}

/// Numbers that a vehicle remembers from one decision to the next: its action, and whether it has been on the road.
const REMEMBERED: usize = 3;

/// Traffic in which each vehicle decides as the policy does, and holds what it decided.
///
/// Vehicles that never move in the log stay parked; those at the end of their route leave; all other agents follow the log.
#[derive(Debug)]
pub struct Egos {
    observer: Observer,
    decoder: ActionDecoder,
    network: NetworkOfEgo,
    row: Vec<Real>,
    decision_steps: usize,
}

impl Egos {
    /// Traffic of a policy.
    ///
    /// # Errors
    /// [`SimError::Config`] where observation and actions do not fit together, [`crate::ModelError::Checkpoint`] where the
    /// weights do not.
    pub fn new(parts: EgoParts) -> Result<Self> {
        let layout = Layout::new(&parts.observation)?;
        let decoder = ActionDecoder::new(&parts.action);
        if decoder.num_actions().is_some() || matches!(decoder.dynamics(), Dynamics::DeltaPose(_)) {
            return Err(SimError::config("egos.policy", "other actions", "accelerations and turns").into());
        }
        if parts.decision_steps == 0 {
            return Err(SimError::config("egos.policy.decision_steps", 0, "at least 1").into());
        }
        let network = NetworkOfEgo::new(&layout, decoder.width(), parts.tensors)?;
        let row = vec![0.0; layout.size];
        let (observer, decision_steps) = (Observer::new(layout), parts.decision_steps);
        Ok(Self { observer, decoder, network, row, decision_steps })
    }

    /// What a vehicle does in the steps of a decision: adds its poses and speeds to the plan, and what it remembers.
    fn decide(&mut self, world: &WorldView<'_>, a: usize, before: [Real; REMEMBERED], plan: &mut PlanState) {
        let (states, scene) = (world.states, world.scene);
        let s_m = world.route_s_m[a];
        let (place, _) = place_on_route(states, scene, a, s_m, world.speed_limit_mps);
        let ground = scene.at(states.elevation_m(a));
        let off = ground.road.as_ref().map(|road| off_road(states, a, &scene.footprints[a], road).corner);
        let has_been_on_road = before[2] > 0.0 || off == Some(false);
        let route = &scene.routes[a].path;
        let view = View {
            states,
            footprints: &scene.footprints,
            kinds: &scene.kinds,
            segments: &ground.segments,
            map: &scene.scene.map,
            road: ground.road.as_ref(),
            lights: &scene.routes[a].lights,
            step_idx: world.step_idx,
            dt_s: world.dt_s,
            route,
            route_s_m: s_m,
            agent_idx: a,
            facts: EgoFacts {
                last_action: [before[0], before[1]],
                place,
                off_road: off == Some(true) && has_been_on_road,
                collided: false,
                route_remaining_m: route.length_m() - s_m,
                goal_ahead_m: route.length_m() - s_m,
                time_remaining: 1.0,
                time_left_s: Real::MAX,
                goal_speed_mps: Real::MAX,
            },
        };
        self.observer.write(&view, &mut self.row);
        let action = self.network.act(&self.row);
        let command = self.decoder.decode(&action);
        let physical = match self.decoder.dynamics() {
            Dynamics::Assisted(limits) => assisted_action(limits, world, a, command),
            _ => command,
        };
        let mut state = states.kin_state(a);
        for _ in 0..self.decision_steps {
            self.decoder.dynamics().step(&mut state, physical, world.dt_s, &scene.footprints[a]);
            plan.record.samples.extend([state.x, state.y, state.heading_rad]);
            plan.speed_mps.push(state.speed_mps);
        }
        let normalised = self.decoder.normalise(&command);
        remember(&mut plan.memory, a, [normalised[0], normalised[1], Real::from(has_been_on_road)]);
    }

    fn planned(&mut self, request: &PlanRequest<'_>) -> PlanState {
        let world = &request.world;
        let (states, scene) = (world.states, world.scene);
        self.observer.enter(&scene.footprints, &scene.kinds, &scene.segments);
        let decides = |a: &usize| {
            request.drives(*a)
                && states.active[*a]
                && scene.kinds[*a] == AgentKind::Vehicle
                && !scene.routes[*a].is_parked()
        };
        let agents: Vec<usize> = (0..states.len()).filter(decides).collect();
        self.observer.prepare(states, agents.len());
        let mut plan = PlanState { memory: vec![0; 4 * REMEMBERED * states.len()], ..PlanState::default() };
        for a in &agents {
            let before = request.plan.map_or([0.0; REMEMBERED], |p| remembered(&p.memory, *a));
            self.decide(world, *a, before, &mut plan);
        }
        let record = PlanRecord::of_one_sample(world.elapsed_steps, agents, self.decision_steps);
        plan.record = PlanRecord { samples: plan.record.samples, ..record };
        plan
    }
}

fn remember(memory: &mut [u8], a: usize, numbers: [Real; REMEMBERED]) {
    for (to, number) in memory.chunks_exact_mut(4).skip(a * REMEMBERED).zip(numbers) {
        to.copy_from_slice(&number.to_le_bytes());
    }
}

fn remembered(memory: &[u8], a: usize) -> [Real; REMEMBERED] {
    let mut numbers = [0.0; REMEMBERED];
    for (number, bytes) in numbers.iter_mut().zip(memory.chunks_exact(4).skip(a * REMEMBERED)) {
        *number = bytes.try_into().map_or(0.0, Real::from_le_bytes);
    }
    // a snapshot may hold anything
    if numbers.iter().all(|n| n.is_finite()) { numbers } else { [0.0; REMEMBERED] }
}

impl DriverModel for Egos {
    fn name(&self) -> &str {
        EGOS.name
    }

    fn history_states(&self) -> usize {
        1
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> ccdiff_sim::Result<Vec<Option<PlanState>>> {
        let held = self.decision_steps;
        Ok(requests.iter().map(|r| r.is_due(held).then(|| self.planned(r))).collect())
    }

    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        // who entered after the decision waits for the next one
        followed(world, plan, agent_idx).unwrap_or_else(|| stands(world, agent_idx))
    }
}
