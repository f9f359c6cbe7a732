//! A scene with everything a world derives from it once: indices, footprints, routes. Shared by all worlds.

use crate::geom::{Pose2, Real};
use crate::observe::BevConfig;
use crate::scene::{AgentKind, LEVEL_M, Scene};
use crate::stage::centre_line::CentreLine;
use crate::stage::ground::{Ground, Grounds};
use crate::stage::hitch::{chains, hitches};
use crate::stage::log::{Log, STEEPEST};
use crate::stage::route::Route;
use crate::state::{Footprint, Height};
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

/// An agent this near to its route is on the route's ground, metres.
const ON_ROUTE_M: Real = 4.0;

/// A scene made ready to be stepped.
#[derive(Debug)]
pub struct PreparedScene {
    /// Footprints of the agents.
    pub footprints: Vec<Footprint>,
    stage: Arc<Stage>,
}

impl Deref for PreparedScene {
    type Target = Stage;

    #[inline]
    fn deref(&self) -> &Stage {
        &self.stage
    }
}

impl Deref for Stage {
    type Target = Ground;

    /// The ground as a whole, of all levels.
    #[inline]
    fn deref(&self) -> &Ground {
        &self.grounds.whole
    }
}

/// What is derived from a scene, whatever the sizes of its agents.
#[derive(Debug)]
pub struct Stage {
    /// The scene itself.
    pub scene: Arc<Scene>,
    /// Kinds of the agents.
    pub kinds: Vec<AgentKind>,
    grounds: Grounds,
    /// Towed vehicles, each with the one that tows it, see [`hitches`].
    pub hitches: Vec<(usize, usize)>,
    /// The chain of each agent; empty where none is towed.
    pub(crate) chains: Vec<u32>,
    /// Route of each agent.
    pub routes: Vec<Route>,
    /// Centre line along the route of each agent, made when it is first asked for.
    centre_lines: Vec<OnceLock<CentreLine>>,
    /// The log step by step.
    pub(crate) log: Log,
    /// Steps at which the logs of vehicles leave the road, made when they are first asked for.
    road_exits: OnceLock<Vec<Vec<usize>>>,
}

impl PreparedScene {
    /// Derives everything from a scene; the ground for rasters where there are some.
    pub fn new(scene: Arc<Scene>, bev: Option<&BevConfig>) -> Self {
        let grounds = Grounds::new(&scene, bev);
        let routes = Route::of_all(&scene, grounds.whole.lanes.as_ref());
        let footprints = scene.agents.iter().map(|a| Footprint::new(a.length_m, a.width_m)).collect();
        let hitches = hitches(&scene);
        let stage = Stage {
            kinds: scene.agents.iter().map(|a| a.kind).collect(),
            log: Log::new(&scene),
            grounds,
            road_exits: OnceLock::new(),
            centre_lines: routes.iter().map(|_| OnceLock::new()).collect(),
            routes,
            chains: chains(&hitches, scene.num_agents()),
            hitches,
            scene,
        };
        Self { footprints, stage: Arc::new(stage) }
    }

    /// The same with some agents, by their indices, larger or smaller by a factor.
    pub(crate) fn resized(&self, agents: &[(usize, Real)]) -> Self {
        let mut footprints = self.footprints.clone();
        for (a, factor) in agents {
            let f = footprints[*a];
            footprints[*a] = Footprint::new(2.0 * f.half_length_m * factor, 2.0 * f.half_width_m * factor);
        }
        Self { footprints, stage: Arc::clone(&self.stage) }
    }

    /// The ground of the level of an elevation, metres; the whole one without an elevation.
    #[inline]
    pub fn at(&self, elevation_m: Option<Real>) -> &Ground {
        self.grounds.at(&self.scene.map, elevation_m)
    }

    /// Height from the route where it is near, else from the nearest lane of its level, else as a step before.
    pub(crate) fn height(&self, agent_idx: usize, pose: &Pose2, s_m: Real, before: Height) -> Height {
        let route = &self.routes[agent_idx];
        let is_near = |height: &Height| {
            (height.elevation_m - before.elevation_m).abs() <= LEVEL_M
                && (route.path.at(s_m).position - pose.position).norm() <= ON_ROUTE_M
        };
        let of_lane = || {
            let lanes = self.at(Some(before.elevation_m)).lanes.as_ref()?;
            let hit = lanes.nearest(pose.position, pose.cos, pose.sin, lanes.reach_m())?;
            let [here, ahead] =
                [0.0, 1.0].map(|m| self.scene.map.lanes[hit.lane_idx as usize].height(hit.s_m + m));
            let grade = if hit.agrees() { ahead? - here? } else { here? - ahead? };
            Some(Height { elevation_m: here?, grade: grade.clamp(-STEEPEST, STEEPEST) })
        };
        let still = Height { grade: 0.0, ..before };
        route.height(s_m).filter(is_near).or_else(of_lane).unwrap_or(still)
    }

    /// Whether an agent is towed by another one.
    pub(crate) fn is_towed(&self, agent_idx: usize) -> bool {
        self.hitches.iter().any(|(towed, _)| *towed == agent_idx)
    }

    /// Whether the log of a vehicle leaves the road after a step, at another one at the latest.
    pub(crate) fn leaves_road(&self, agent_idx: usize, from: usize, to: usize) -> bool {
        if self.road.is_none() {
            return false;
        }
        let exits = |a: usize| {
            let mut was_on = false;
            let leaves = |t: &usize| {
                let Some((pose, _)) = self.log.at(a, *t) else { return false };
                let height = self.log.height(a, *t).map(|height| height.elevation_m);
                let Some(road) = &self.at(height).road else { return false };
                let on = road.holds_square(pose.position, self.footprints[a].radius_m)
                    || road.holds_box(&self.footprints[a].at(&pose));
                std::mem::replace(&mut was_on, on) && !on
            };
            (0..self.scene.num_steps).filter(leaves).collect()
        };
        let all = || {
            let vehicles = (0..self.kinds.len()).map(|a| (a, self.kinds[a] == AgentKind::Vehicle));
            vehicles.map(|(a, is)| if is { exits(a) } else { Vec::new() }).collect()
        };
        self.road_exits.get_or_init(all)[agent_idx].iter().any(|t| (from + 1..=to).contains(t))
    }

    /// Centre line of the lanes along an agent's route.
    pub fn centre_line(&self, agent_idx: usize) -> &CentreLine {
        let make = || CentreLine::new(&self.scene.map, &self.routes[agent_idx]);
        self.centre_lines[agent_idx].get_or_init(make)
    }

    /// Position along its route of an agent at a step, metres; where it is not logged, that of the step logged before.
    pub fn logged_s_m(&self, agent_idx: usize, step_idx: usize) -> Real {
        let follow = || self.log.along(agent_idx, &self.routes[agent_idx]);
        self.log.route_s_m[agent_idx].get_or_init(follow)[step_idx]
    }
}
