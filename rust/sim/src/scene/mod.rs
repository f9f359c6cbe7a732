//! A scene: logged tracks of all agents on a map, in the scene's own frame. Immutable, shared by `Arc`.
//!
//! What flows in: a loader's arrays (nuScenes, ScenarioNet, a recorded rollout). What flows out: the log that
//! worlds start from, replay and compare with. Nothing here knows a data set.

mod cell_border;
mod contour;
mod lane_index;
mod lane_links;
mod lane_path;
mod levels;
mod lights;
mod map;
mod mend;
mod road_area;
mod road_blocks;
pub mod synthetic;

pub use lane_index::{LaneHit, LaneIndex, NearLanes};
pub use lane_links::link_lanes;
pub(crate) use lane_path::follow;
pub use levels::{PartElevations, cut_by_level, level_bounds, range_of, road_areas};
pub use lights::{Light, LightAlong, LightState};
pub use map::{Elevations, HIGHEST_M, LEVEL_M, Lane, LaneKind, Map};
pub use mend::{LONGEST_GAP_S, Mended};
pub use road_area::{RoadParts, road_area};
pub use road_blocks::progress_along_log;

use crate::error::{Result, SimError};
use crate::geom::{Point2, Pose2, Real, Vector2};
use crate::named::named;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Id of the ego agent in every scene.
pub const EGO_ID: &str = "ego";

/// Most metres that all lines of a map, and all logged paths, may have together: worlds keep points along them.
const LONGEST_M: f64 = 5e6;
/// Largest length and width of an agent, metres.
const LARGEST_M: Real = 1e3;

named! {
    /// Kind of an agent, coarse enough to be the same for every data set.
    #[derive(PartialOrd, Ord, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum AgentKind {
        /// Cars, trucks, buses, trailers, construction and emergency vehicles.
        Vehicle = "vehicle",
        /// People on foot, in wheelchairs, with strollers or personal mobility devices.
        Pedestrian = "pedestrian",
        /// Bicycles.
        Cyclist = "cyclist",
        /// Motorcycles.
        Motorcycle = "motorcycle",
        /// Barriers, cones, debris, racks: obstacles that never move by themselves.
        Static = "static",
    }
}

/// What is constant about an agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Agent {
    /// Instance token of the data set; [`EGO_ID`] for the ego. Unique in the scene.
    pub id: String,
    /// Coarse kind.
    pub kind: AgentKind,
    /// The data set's own category name.
    pub category: String,
    /// Length along the heading, metres, > 0.
    pub length_m: Real,
    /// Width, metres, > 0.
    pub width_m: Real,
    /// Height, metres, >= 0 (0: unknown).
    pub height_m: Real,
}

/// Logged states of A agents over T steps, row-major [A, T]: the entry of agent a at step t is `a * T + t`.
///
/// Entries where `valid` is false are zero and mean nothing.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Tracks {
    /// Centre of the box in the scene frame, metres.
    pub position: Vec<Point2>,
    /// Heading, radians, unwrapped along each track: neighbouring valid steps differ by less than π.
    pub heading_rad: Vec<Real>,
    /// Velocity in the scene frame, metres per second.
    pub velocity: Vec<Vector2>,
    /// Whether the agent is present.
    pub valid: Vec<bool>,
    /// Elevation of the ground below the box, metres; empty where the scene is flat or nothing says how high it lies.
    pub elevation_m: Vec<Real>,
}

/// One scene. Agent 0 is the ego where the data has one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Name, such as `scene-0061`.
    pub name: String,
    /// The data set's token of the scene.
    pub token: String,
    /// Map location, such as `boston-seaport`.
    pub location: String,
    /// Where the scene comes from: data set and version, or file.
    pub source: String,
    /// Global x, y of the scene frame's origin, metres: global = origin + scene frame.
    pub origin: [f64; 2],
    /// Time between steps, seconds.
    pub dt_s: Real,
    /// Number of logged steps T.
    pub num_steps: usize,
    /// Agents, A of them.
    pub agents: Vec<Agent>,
    /// Logged states [A, T].
    pub tracks: Tracks,
    /// Map round the scene, in the scene frame.
    pub map: Arc<Map>,
}

impl Scene {
    /// Checks every rule and returns the scene; the only way a scene gets into a world.
    ///
    /// # Errors
    /// [`SimError::Scene`] names the first field that is not finite, not positive, of the wrong length or twice there.
    pub fn validated(self) -> Result<Self> {
        let fail = |field: String, got: String, expected: &'static str| {
            Err(SimError::Scene { scene: self.name.clone(), field, got, expected: expected.into() })
        };
        let (num_agents, num_steps) = (self.agents.len(), self.num_steps);
        if num_agents == 0 {
            return fail("agents".into(), "empty".into(), "at least one agent");
        }
        if num_steps == 0 {
            return fail("num_steps".into(), "0".into(), "at least one step");
        }
        if !(1e-3..=10.0).contains(&self.dt_s) {
            return fail("dt_s".into(), self.dt_s.to_string(), "0.001 to 10 seconds");
        }
        let texts = [&self.name, &self.token, &self.location, &self.source];
        let texts = texts.into_iter().chain(self.agents.iter().flat_map(|a| [&a.id, &a.category]));
        let controls =
            |c: char| c.is_control() || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        if let Some(text) = texts.into_iter().find(|text| text.contains(controls)) {
            return fail("name".into(), format!("{text:?}"), "text without control characters");
        }
        if !self.origin.iter().all(|v| v.is_finite()) {
            return fail("origin".into(), format!("{:?}", self.origin), "finite numbers");
        }
        let Some(entries) = num_agents.checked_mul(num_steps) else {
            return fail("num_steps".into(), num_steps.to_string(), "a number of logged steps");
        };
        for (name, len) in [
            ("tracks.position", self.tracks.position.len()),
            ("tracks.heading_rad", self.tracks.heading_rad.len()),
            ("tracks.velocity", self.tracks.velocity.len()),
            ("tracks.valid", self.tracks.valid.len()),
        ] {
            if len != entries {
                return fail(name.into(), format!("{len} entries"), "agents x steps entries");
            }
        }
        let mut ids: Vec<&str> = self.agents.iter().map(|a| a.id.as_str()).collect();
        ids.sort_unstable();
        if let Some(pair) = ids.windows(2).find(|w| w[0] == w[1]) {
            return fail(
                "agents[].id".into(),
                format!("{:?} twice", pair[0]),
                "ids that are unique in the scene",
            );
        }
        let is_limit = |limit: Real| limit.is_finite() && limit > 0.0;
        for (i, lane) in self.map.lanes.iter().enumerate() {
            if let Some(limit) = lane.speed_limit_mps.filter(|limit| !is_limit(*limit)) {
                let field = format!("map.lanes[{i}] {:?} speed_limit_mps", lane.id);
                return fail(field, limit.to_string(), "a positive finite number, or none");
            }
        }
        for (i, a) in self.agents.iter().enumerate() {
            let sides_hold = [a.length_m, a.width_m].iter().all(|side| *side > 0.0 && *side <= LARGEST_M);
            if !(sides_hold && (0.0..=LARGEST_M).contains(&a.height_m)) {
                let got = format!("{} x {} x {} m", a.length_m, a.width_m, a.height_m);
                let expected = "a positive length and width, and a height, of at most 1000 m";
                return fail(format!("agents[{i}] {:?} size", a.id), got, expected);
            }
        }
        for (i, ok) in self.tracks.valid.iter().enumerate() {
            let (p, h, v) = (self.tracks.position[i], self.tracks.heading_rad[i], self.tracks.velocity[i]);
            if *ok && ![p.x, p.y, v.x, v.y, h].iter().all(|x| x.abs() < map::FARTHEST_M) {
                let field = format!("track of {:?} at step {}", self.agents[i / num_steps].id, i % num_steps);
                let got = format!("position {p}, heading {h}, velocity ({}, {})", v.x, v.y);
                return fail(field, got, "finite numbers within 1000 km");
            }
        }
        if let Some((field, got)) = self.height_fault() {
            return fail(field, got, "one finite number within 9 km for each entry, or none at all");
        }
        let logged_m = self.logged_m();
        if logged_m > LONGEST_M {
            return fail("tracks.position".into(), format!("{logged_m:.0} m of paths"), "at most 5000 km");
        }
        if let Some(field) = self.map.first_fault() {
            return fail(
                format!("map.{field}"),
                "not finite, farther than 1000 km away, or dangling".into(),
                "finite points within 1000 km and lane indices in range",
            );
        }
        let short = |light: &Light| light.states.len() != num_steps;
        if let Some(i) = self.map.lights.iter().position(short) {
            let got = format!("{} states", self.map.lights[i].states.len());
            return fail(format!("map.lights[{i}].states"), got, "one for each logged step");
        }
        let length_m = self.map.length_m();
        if length_m > LONGEST_M {
            return fail("map".into(), format!("{length_m:.0} m of lines"), "at most 5000 km");
        }
        Ok(self)
    }

    /// The first field of elevations that has not as many as there are entries, or one that is no height on Earth.
    fn height_fault(&self) -> Option<(String, String)> {
        type Heights<'a> = (String, &'a [Real], usize, Option<&'a [bool]>);
        let fault = |(field, heights, entries, counts): Heights<'_>| {
            if !heights.is_empty() && heights.len() != entries {
                return Some((field, format!("{} entries for {entries}", heights.len())));
            }
            let is_bad = |i: usize| heights[i].is_nan() || heights[i].abs() > HIGHEST_M;
            let bad = (0..heights.len()).find(|i| counts.is_none_or(|counts| counts[*i]) && is_bad(*i))?;
            Some((format!("{field}[{bad}]"), heights[bad].to_string()))
        };
        let (tracks, map) = (&self.tracks, &self.map);
        let of_tracks: Heights<'_> =
            ("tracks.elevation_m".into(), &tracks.elevation_m, tracks.valid.len(), Some(&tracks.valid));
        let of_lanes = map.lanes.iter().enumerate().map(|(i, lane)| -> Heights<'_> {
            (format!("map.lanes[{i}].elevation_m"), &lane.elevation_m, lane.centreline.len(), None)
        });
        let parts = [
            map.drivable_area.len(),
            map.road_dividers.len(),
            map.lane_dividers.len(),
            map.ped_crossings.len(),
            map.walkways.len(),
            map.stop_lines.len(),
            map.carpark_areas.len(),
        ];
        let of_layers = map.elevation_m.layers().into_iter().zip(parts).map(|((name, ranges), parts)| {
            (format!("map.elevation_m.{name}"), ranges.as_flattened(), 2 * parts, None)
        });
        std::iter::once(of_tracks).chain(of_lanes).chain(of_layers).find_map(fault)
    }

    /// Whether agents are told apart by their height.
    pub fn has_levels(&self) -> bool {
        !self.tracks.elevation_m.is_empty()
    }

    /// Length of the paths of all agents from one logged position to the next, metres.
    fn logged_m(&self) -> f64 {
        let (mut total, tracks) = (0.0, &self.tracks);
        for agent in 0..self.agents.len() {
            let mut last: Option<Point2> = None;
            for at in self.at(agent, 0)..self.at(agent + 1, 0) {
                if tracks.valid[at] {
                    let here = tracks.position[at];
                    total += last.map_or(0.0, |last| f64::from((here - last).norm()));
                    last = Some(here);
                }
            }
        }
        total
    }

    /// Number of agents A.
    pub fn num_agents(&self) -> usize {
        self.agents.len()
    }

    /// Index of an entry of [`Tracks`].
    #[inline]
    pub fn at(&self, agent_idx: usize, step_idx: usize) -> usize {
        agent_idx * self.num_steps + step_idx
    }

    /// Logged pose of an agent at a step; it means nothing where the agent is not logged.
    pub fn pose(&self, agent_idx: usize, step_idx: usize) -> Pose2 {
        let (tracks, at) = (&self.tracks, self.at(agent_idx, step_idx));
        Pose2::new(tracks.position[at].x, tracks.position[at].y, tracks.heading_rad[at])
    }

    /// Whether an agent is logged at a step; false past the end.
    #[inline]
    pub fn is_valid(&self, agent_idx: usize, step_idx: usize) -> bool {
        step_idx < self.num_steps && self.tracks.valid[self.at(agent_idx, step_idx)]
    }

    /// The scene with another agent as its ego; the former one is `"former ego"` then.
    pub fn with_ego(&self, agent_idx: usize) -> Self {
        let mut scene = self.clone();
        if let Some(before) = scene.agent_index(EGO_ID).filter(|a| *a != agent_idx) {
            let mut id = "former ego".to_owned();
            while scene.agent_index(&id).is_some() {
                id.push('+');
            }
            scene.agents[before].id = id;
        }
        scene.agents[agent_idx].id = EGO_ID.into();
        scene
    }

    /// Index of the agent with an id.
    pub fn agent_index(&self, id: &str) -> Option<usize> {
        self.agents.iter().position(|a| a.id == id)
    }
}
