//! Planners that drive an agent through its action: PDM-Closed, and the intelligent driver model on the centre line.

use crate::drivers::{IdmConfig, braking, idm_towards};
use crate::dynamics::{Action, Dynamics, UnicycleLimits};
use crate::error::{Result, SimError};
use crate::events::leader;
use crate::geom::{Real, math};
use crate::pdm::{Scene, plan, steering};
use crate::world::VecWorld;

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
    // proposals, rolled out and scored
    PlannerKind { name: "pdm", act: pdm },
    // the intelligent driver model of the worlds, along the centre line at the road's limit
    PlannerKind { name: "idm", act: idm },
];

struct Asked<'a> {
    scene: &'a Scene<'a>,
    idm: &'a IdmConfig,
}

/// Drives the first slot of worlds.
#[derive(Debug)]
pub struct Planner {
    act: Act,
}

impl Planner {
    /// A planner for any number of worlds, of [`PLANNERS`] by name.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for any other name.
    pub fn new(name: &str) -> Result<Self> {
        let kind = PLANNERS.iter().find(|kind| kind.name == name).ok_or_else(|| {
            let names: Vec<&str> = PLANNERS.iter().map(|kind| kind.name).collect();
            SimError::unknown("planner", format!("{name:?}"), format!("one of {}", names.join(", ")))
        })?;
        Ok(Self { act: kind.act })
    }

    /// The actions of the first slots of some worlds in the form that [`VecWorld::step`] takes; zeros for empty slots.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Config`] for assisted dynamics.
    pub fn act(&self, world: &VecWorld, worlds: &[usize]) -> Result<Vec<Action>> {
        worlds.iter().map(|i| self.act_in(world, *i)).collect()
    }

    fn act_in(&self, world: &VecWorld, world_idx: usize) -> Result<Action> {
        world.decoder().dynamics().check_moves_by_itself()?;
        let status = world.status(world_idx)?;
        let seat = status.slots.first().and_then(|slot| slot.agent_idx);
        let Some(ego) = seat.filter(|ego| status.states.active[*ego]) else { return Ok(Action::default()) };
        let prepared = world.prepared(status.scene_idx)?;
        let config = world.config();
        let scene =
            Scene::new(&prepared, status.states, ego, config.dt_s, config.speed_limit_mps, status.step_idx);
        // it waits while its log backs up
        let wanted = match prepared.routes[ego].backs_up(status.step_idx) {
            true => [braking(&config.idm, status.states.speed_mps[ego], config.dt_s), 0.0],
            false => (self.act)(&Asked { scene: &scene, idm: &config.idm }),
        };
        Ok(encoded(world, &scene, wanted))
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
    let plan = plan(asked.scene);
    [plan.acceleration_mps2, asked.scene.yaw_rate(plan.offset_m)]
}

/// Acceleration of the worlds' IDM behind the leader on the centre line, and the yaw rate that follows the line.
fn idm(asked: &Asked<'_>) -> [Real; 2] {
    let Asked { scene, idm } = asked;
    let (states, ego, line, place) = (scene.states, scene.ego, scene.line, scene.place);
    let speed = states.speed_mps[ego].max(0.0);
    let now = line.at(place.s_m);
    let wanted =
        now.limit_mps.min(scene.speed_limit_mps).min(line.at(place.s_m + 0.5 * speed).curve_speed_mps);
    let footprints = &scene.prepared.footprints;
    let ahead = leader(states, footprints, line.polyline(), place.s_m, ego, idm.anticipation_s);
    let mut acceleration = idm_towards(idm, speed, wanted, ahead.map(|l| (l.gap_m, l.speed_mps)));
    if let Some(stop_m) = scene.stop_m {
        let gap_m = stop_m - place.s_m - scene.footprint(ego).half_length_m;
        acceleration = acceleration.min(idm_towards(idm, speed, wanted, Some((gap_m, 0.0))));
    }
    let (error_sin, _) = math::sin_cos(math::wrap_angle(states.heading_rad[ego] - now.heading_rad));
    [acceleration, steering(&UnicycleLimits::default(), speed, now.curvature_1pm, error_sin, place.lateral_m)]
}
