//! Planners that drive an agent through its action: PDM-Closed, and the intelligent driver model on the centre line.

mod egos;
mod network;
mod network_of_ego;

pub use egos::{EGOS, EgoParts, Egos, EgosConfig};
pub use network_of_ego::{NetworkOfEgo, Tensors};

use crate::dynamics::{Action, Dynamics, KinState, UnicycleLimits};
use crate::error::{Result, SimError};
use crate::events::leader;
use crate::geom::{Real, math};
use crate::pdm::{Scene, plan, steering};
use crate::policy::{IdmConfig, TrafficPolicy, idm_towards};
use crate::world::VecWorld;
use network::Network;

/// Acceleration of an ego that its network does not plan for, m/s².
const WITHOUT_PLAN_MPS2: Real = -4.0;

/// What an ego does from here: its acceleration (m/s²) and yaw rate (rad/s).
type Act = fn(&Asked<'_>) -> [Real; 2];

/// A planner of the package.
#[derive(Debug)]
pub struct PlannerKind {
    /// Its name.
    pub name: &'static str,
    act: Act,
}

/// All of them: a new one is a function and a line here.
pub static PLANNERS: &[PlannerKind] = &[
    // proposals, rolled out and scored; against the samples of a network where there is one, else at constant velocity
    PlannerKind { name: "pdm", act: pdm },
    // the intelligent driver model of the worlds, along the centre line at the road's limit
    PlannerKind { name: "idm", act: idm },
    // the plan of a network
    PlannerKind { name: "plan", act: follow },
];

struct Asked<'a> {
    scene: Scene<'a>,
    idm: &'a IdmConfig,
    network: Option<&'a Network>,
    world_idx: usize,
}

/// Drives the first slot of worlds. Holds nothing but what its network has seen.
#[derive(Debug)]
pub struct Planner {
    act: Act,
    network: Option<Network>,
}

impl Planner {
    /// A planner for any number of worlds, of [`PLANNERS`] by name, and its network.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for any other name.
    pub fn new(name: &str, network: Option<Box<dyn TrafficPolicy>>) -> Result<Self> {
        let kind = PLANNERS.iter().find(|kind| kind.name == name).ok_or_else(|| {
            let names: Vec<&str> = PLANNERS.iter().map(|kind| kind.name).collect();
            SimError::unknown("planner", format!("{name:?}"), format!("one of {}", names.join(", ")))
        })?;
        Ok(Self { act: kind.act, network: network.map(Network::new) })
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
        world.decoder().dynamics().check_moves_by_itself()?;
        let status = world.status(world_idx)?;
        let seat = world.slot_agents(world_idx)?.first().copied().flatten();
        let Some(ego) = seat.filter(|ego| status.states.active[*ego]) else { return Ok(Action::default()) };
        let prepared = world.prepared(status.scene_idx)?;
        let config = world.config();
        let scene = Scene::new(&prepared, status.states, ego, config.dt_s, config.speed_limit_mps);
        let asked = Asked { scene, idm: &config.idm, network: self.network.as_ref(), world_idx };
        Ok(encoded(world, &asked.scene, (self.act)(&asked)))
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

fn pdm(asked: &Asked<'_>) -> [Real; 2] {
    let Asked { scene, network, world_idx, .. } = asked;
    let num_futures = network.map_or(1, |n| n.num_samples(*world_idx));
    let path = |sample, agent| (*network)?.path(scene.states, *world_idx, sample, agent);
    let plan = plan(scene, num_futures, path);
    [plan.acceleration_mps2, scene.yaw_rate(plan.offset_m)]
}

/// Acceleration and yaw rate towards a pose and speed after the step; braking where there is none.
fn follow(asked: &Asked<'_>) -> [Real; 2] {
    let scene = &asked.scene;
    let next = asked.network.and_then(|n| n.next(asked.world_idx, scene.ego));
    let Some((pose, speed_mps)) = next else { return [WITHOUT_PLAN_MPS2, 0.0] };
    let to = KinState { x: pose.position.x, y: pose.position.y, heading_rad: pose.heading_rad, speed_mps };
    let from = scene.states.kin_state(scene.ego);
    let action = Dynamics::default().inverse(&from, &to, scene.dt_s, scene.footprint(scene.ego));
    [action[0], action[1]]
}

/// Acceleration of the worlds' IDM behind whoever is ahead on the centre line, and the yaw rate that follows the line.
fn idm(asked: &Asked<'_>) -> [Real; 2] {
    let Asked { scene, idm, .. } = asked;
    let (states, ego, line, place) = (scene.states, scene.ego, scene.line, scene.place);
    let speed = states.speed_mps[ego].max(0.0);
    let now = line.at(place.s_m);
    let wanted =
        now.limit_mps.min(scene.speed_limit_mps).min(line.at(place.s_m + 0.5 * speed).curve_speed_mps);
    let footprints = &scene.prepared.footprints;
    let ahead = leader(states, footprints, line.polyline(), place.s_m, ego, idm.anticipation_s);
    let acceleration = idm_towards(idm, speed, wanted, ahead.map(|l| (l.gap_m, l.speed_mps)));
    let (error_sin, _) = math::sin_cos(math::wrap_angle(states.heading_rad[ego] - now.heading_rad));
    [acceleration, steering(&UnicycleLimits::default(), speed, now.curvature_1pm, error_sin, place.lateral_m)]
}
