//! A city of straight two-way roads on a square grid, for tests and benchmarks: any number of agents, any size.

use super::{Agent, AgentKind, EGO_ID, Lane, Map, Scene, Tracks};
use crate::geom::{Point2, Polygon, Real, Vector2, math};
use std::sync::Arc;

/// What the city is like.
#[derive(Debug, Clone, Copy)]
pub struct GridCity {
    /// Agents, the ego included.
    pub num_agents: usize,
    /// Logged steps.
    pub num_steps: usize,
    /// Roads in each direction.
    pub num_roads: usize,
    /// Distance between roads, metres.
    pub block_m: Real,
    /// Gap between agents of one lane at the start, metres.
    pub gap_m: Real,
}

impl Default for GridCity {
    fn default() -> Self {
        Self { num_agents: 16, num_steps: 196, num_roads: 3, block_m: 80.0, gap_m: 18.0 }
    }
}

const LANE_M: Real = 3.5;
const DT_S: Real = 0.1;

impl GridCity {
    /// The scene: agents drive straight on at constant speeds between 4 and 8 m/s, one lane after the other filled.
    pub fn scene(&self) -> Scene {
        let half = 0.5 * self.block_m * self.num_roads as Real;
        let mut map = Map::default();
        for road in 0..self.num_roads {
            let at = (road as Real - 0.5 * (self.num_roads as Real - 1.0)) * self.block_m;
            for vertical in [false, true] {
                let point = |along: Real, across: Real| {
                    if vertical { Point2::new(across, along) } else { Point2::new(along, across) }
                };
                let rectangle = |low: Real, high: Real| {
                    let ends = [(-half, low), (half, low), (half, high), (-half, high)];
                    Polygon::from_exterior(ends.map(|(along, across)| point(along, across)).to_vec())
                };
                map.drivable_area.push(rectangle(at - LANE_M, at + LANE_M));
                map.road_dividers.push(vec![point(-half, at), point(half, at)]);
                for side in [-1.0, 1.0] {
                    // right-hand traffic: the direction follows from the side of the road
                    let forward = (side < 0.0) != vertical;
                    let across = at + side * 0.5 * LANE_M;
                    let n = (2.0 * half) as usize;
                    let sign = if forward { 1.0 } else { -1.0 };
                    let centreline = (0..=n).map(|i| point(sign * (i as Real - half), across)).collect();
                    map.lanes.push(Lane {
                        id: format!("lane-{}", map.lanes.len()),
                        centreline,
                        polygon: rectangle(across - 0.5 * LANE_M, across + 0.5 * LANE_M),
                        ..Lane::default()
                    });
                }
            }
        }
        let (agents, tracks) = self.traffic(&map);
        Scene {
            name: format!("grid-{}", self.num_agents),
            token: String::new(),
            location: "grid".into(),
            source: "synthetic".into(),
            origin: [0.0, 0.0],
            dt_s: DT_S,
            num_steps: self.num_steps,
            agents,
            tracks,
            map: Arc::new(map),
        }
    }

    fn traffic(&self, map: &Map) -> (Vec<Agent>, Tracks) {
        let mut agents = Vec::with_capacity(self.num_agents);
        let mut tracks = Tracks::default();
        let num_lanes = map.lanes.len();
        for i in 0..self.num_agents {
            let lane = &map.lanes[i % num_lanes].centreline;
            let (first, second) = (lane[0], lane[1]);
            let (cos, sin) = (second.x - first.x, second.y - first.y);
            let heading = math::atan2(sin, cos);
            let speed = 4.0 + (i * 7 % 5) as Real;
            // lanes start at different places, so that crossing traffic is not all in the middle at once
            let start = 10.0 + (i % num_lanes * 5) as Real + (i / num_lanes) as Real * self.gap_m;
            for t in 0..self.num_steps {
                let s = start + speed * t as Real * DT_S;
                tracks.position.push(Point2::new(first.x + cos * s, first.y + sin * s));
                tracks.heading_rad.push(heading);
                tracks.velocity.push(Vector2::new(cos * speed, sin * speed));
                tracks.valid.push(true);
            }
            agents.push(Agent {
                id: if i == 0 { EGO_ID.into() } else { format!("car-{i}") },
                kind: AgentKind::Vehicle,
                category: "vehicle.car".into(),
                length_m: 4.6,
                width_m: 1.9,
                height_m: 1.6,
            });
        }
        (agents, tracks)
    }
}
