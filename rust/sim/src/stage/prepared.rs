//! A scene with everything a world derives from it once: indices, footprints, routes. Shared by all worlds.

use crate::geom::{Bitmap, Boundary, Polygon, Real, Region};
use crate::observe::{BevConfig, MapSegments};
use crate::scene::{AgentKind, LaneIndex, Map, Scene};
use crate::stage::centre_line::CentreLine;
use crate::stage::log::Log;
use crate::stage::route::Route;
use crate::state::Footprint;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

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

/// What a scene is made ready with, whatever the sizes of its agents.
#[derive(Debug)]
pub struct Stage {
    /// The scene itself.
    pub scene: Arc<Scene>,
    /// Kinds of the agents.
    pub kinds: Vec<AgentKind>,
    /// Where vehicles may drive: the drivable area, else the lanes' polygons; `None` where the map has neither, and
    /// then nothing is ever off the road.
    pub road: Option<Region>,
    /// Edge of the road, made when somebody asks for distances to it.
    pub(crate) road_edge: OnceLock<Boundary>,
    /// Nearest-lane index; `None` without lanes.
    pub lanes: Option<LaneIndex>,
    /// Route of each agent.
    pub routes: Vec<Route>,
    /// Centre line along the route of each agent, made when it is first asked for.
    centre_lines: Vec<OnceLock<CentreLine>>,
    /// The log step by step.
    pub(crate) log: Log,
    /// Map segments for observations.
    pub segments: MapSegments,
    /// What does not move in bird's-eye rasters; `None` without rasters.
    pub(crate) ground: Option<Bitmap>,
    /// Steps at which the logs of vehicles leave the road, made when they are first asked for.
    road_exits: OnceLock<Vec<Vec<usize>>>,
}

impl PreparedScene {
    /// Derives everything from a scene; the ground for rasters where there are some.
    pub fn new(scene: Arc<Scene>, bev: Option<&BevConfig>) -> Self {
        let map = &scene.map;
        let lanes = LaneIndex::new(map);
        let routes = Route::of_all(&scene, lanes.as_ref());
        let footprints = scene.agents.iter().map(|a| Footprint::new(a.length_m, a.width_m)).collect();
        let stage = Stage {
            kinds: scene.agents.iter().map(|a| a.kind).collect(),
            log: Log::new(&scene),
            segments: MapSegments::new(map),
            ground: bev.map(|bev| bev.ground(map)),
            road_exits: OnceLock::new(),
            road: Region::new(&Self::road_polygons(map)),
            road_edge: OnceLock::new(),
            lanes,
            centre_lines: routes.iter().map(|_| OnceLock::new()).collect(),
            routes,
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

    /// Whether the log of a vehicle leaves the road after a step, at another one at the latest.
    pub(crate) fn leaves_road(&self, agent_idx: usize, from: usize, to: usize) -> bool {
        let Some(road) = &self.road else { return false };
        let exits = |a: usize| {
            let mut was_on = false;
            let leaves = |t: &usize| {
                let Some((pose, _)) = self.log.at(a, *t) else { return false };
                let on = road.holds_square(pose.position, self.footprints[a].radius_m)
                    || self.footprints[a].at(&pose).corners().iter().all(|c| road.contains(*c));
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
        let make = || CentreLine::new(&self.scene.map, &self.routes[agent_idx].path);
        self.centre_lines[agent_idx].get_or_init(make)
    }

    /// Where vehicles may drive, as polygons.
    pub(crate) fn road_polygons(map: &Map) -> Vec<Polygon> {
        match map.drivable_area.is_empty() {
            true => map.lanes.iter().map(|l| l.polygon.clone()).collect(),
            false => map.drivable_area.clone(),
        }
    }

    /// Position along its route of an agent at a step, metres; where it is not logged, that of the step logged before.
    pub fn logged_s_m(&self, agent_idx: usize, step_idx: usize) -> Real {
        let follow = || self.log.along(agent_idx, &self.routes[agent_idx]);
        self.log.route_s_m[agent_idx].get_or_init(follow)[step_idx]
    }
}
