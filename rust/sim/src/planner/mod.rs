//! Planners that drive an agent through its action: PDM-Closed, and the intelligent driver model on the centre line.

mod egos;
mod network;
mod network_of_ego;

pub use egos::{EGOS, EgoParts, Egos, EgosConfig};
pub use network_of_ego::{NetworkOfEgo, Tensors};

use crate::dynamics::{Action, Dynamics, KinState, UnicycleLimits};
use crate::error::{Result, SimError};
use crate::events::leader;
use crate::geom::{Pose2, Real, math};
use crate::pdm::{Scene, plan, steering};
use crate::policy::{IdmConfig, TrafficPolicy, idm_towards};
use crate::world::VecWorld;
use network::Network;

/// Acceleration of an ego that its network does not plan for, m/s².
const WITHOUT_PLAN_MPS2: Real = -4.0;

/// What drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlannerKind {
    /// Proposals, rolled out and scored; against the samples of a network where there is one, else at constant velocity.
    Pdm,
    /// The intelligent driver model of the worlds, along the centre line at the road's limit.
    Idm,
    /// The plan of a network.
    Plan,
}

/// Drives the first slot of worlds. Holds nothing but what its network has seen.
#[derive(Debug)]
pub struct Planner {
    kind: PlannerKind,
    network: Option<Network>,
}

impl Planner {
    /// A planner for any number of worlds, and its network.
    pub fn new(kind: PlannerKind, network: Option<Box<dyn TrafficPolicy>>) -> Self {
        Self { kind, network: network.map(Network::new) }
    }

    /// The actions of the first slots of some worlds in the form that [`VecWorld::step`] takes; zeros where nobody is in it.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Config`] for assisted dynamics; what stops the network.
    pub fn act(&mut self, world: &VecWorld, worlds: &[usize]) -> Result<Vec<Action>> {
        if let Some(network) = &mut self.network {
            network.plan(world, worlds)?;
        }
        worlds.iter().map(|i| self.act_in(world, *i)).collect()
    }

    fn act_in(&self, world: &VecWorld, world_idx: usize) -> Result<Action> {
        if let Dynamics::Assisted(_) = world.decoder().dynamics() {
            let expected = "a model of motion by itself".into();
            return Err(SimError::Config {
                field: "action.dynamics".into(),
                got: "assisted".into(),
                expected,
            });
        }
        let status = world.status(world_idx)?;
        let seat = world.slot_agents(world_idx)?.first().copied().flatten();
        let Some(ego) = seat.filter(|ego| status.states.active[*ego]) else { return Ok(Action::default()) };
        let prepared = world.prepared(status.scene_idx)?;
        let config = world.config();
        let scene = Scene::new(&prepared, status.states, ego, config.dt_s, config.speed_limit_mps);
        let action = match self.kind {
            PlannerKind::Pdm => pdm(&scene, self.network.as_ref(), world_idx),
            PlannerKind::Idm => idm(&scene, &config.idm),
            PlannerKind::Plan => follow(&scene, self.network.as_ref().and_then(|n| n.next(world_idx, ego))),
        };
        Ok(encoded(world, &scene, action))
    }
}

/// Acceleration (m/s²) and yaw rate (rad/s) as an action of the world's own dynamics.
fn encoded(world: &VecWorld, scene: &Scene<'_>, [acceleration, yaw_rate]: [Real; 2]) -> Action {
    let (decoder, ego) = (world.decoder(), scene.ego);
    let physical = match decoder.dynamics() {
        Dynamics::Unicycle(_) => [acceleration, yaw_rate, 0.0],
        other => {
            let from = scene.states.kin_state(ego);
            let mut to = from;
            let footprint = scene.footprint(ego);
            Dynamics::default().step(&mut to, [acceleration, yaw_rate, 0.0], scene.dt_s, footprint);
            other.inverse(&from, &to, scene.dt_s, footprint)
        }
    };
    decoder.encode(&physical)
}

fn pdm(scene: &Scene<'_>, network: Option<&Network>, world_idx: usize) -> [Real; 2] {
    let num_futures = network.map_or(1, |n| n.num_samples(world_idx));
    let path = |sample, agent| network?.path(scene.states, world_idx, sample, agent);
    let plan = plan(scene, num_futures, path);
    [plan.acceleration_mps2, scene.yaw_rate(plan.offset_m)]
}

/// Acceleration and yaw rate towards a pose and speed after the step; braking where there is none.
fn follow(scene: &Scene<'_>, next: Option<(Pose2, Real)>) -> [Real; 2] {
    let Some((pose, speed_mps)) = next else { return [WITHOUT_PLAN_MPS2, 0.0] };
    let to = KinState { x: pose.position.x, y: pose.position.y, heading_rad: pose.heading_rad, speed_mps };
    let from = scene.states.kin_state(scene.ego);
    let action = Dynamics::default().inverse(&from, &to, scene.dt_s, scene.footprint(scene.ego));
    [action[0], action[1]]
}

/// Acceleration of the worlds' IDM behind whoever is ahead on the centre line, and the yaw rate that follows the line.
fn idm(scene: &Scene<'_>, idm: &IdmConfig) -> [Real; 2] {
    let (states, ego, line, place) = (scene.states, scene.ego, scene.line, scene.place);
    let speed = states.speed_mps[ego].max(0.0);
    let now = line.at(place.s_m);
    let wanted =
        now.limit_mps.min(scene.speed_limit_mps).min(line.at(place.s_m + 0.5 * speed).curve_speed_mps);
    let footprints = &scene.prepared.footprints;
    let ahead = leader(states, footprints, line.polyline(), place.s_m, ego, idm.anticipation_s);
    let acceleration = idm_towards(idm, speed, wanted, ahead.map(|l| (l.gap_m, l.speed_mps)));
    let heading_error = math::wrap_angle(states.heading_rad[ego] - now.heading_rad);
    [
        acceleration,
        steering(&UnicycleLimits::default(), speed, now.curvature_1pm, heading_error, place.lateral_m),
    ]
}
