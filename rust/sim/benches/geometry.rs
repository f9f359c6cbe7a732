//! Nanoseconds per call of the geometry kernels, dynamics and events: `cargo bench -p ccdiff-sim --bench geometry`.
//!
//! The scene is made up: a grid of two-way streets on 240 m x 240 m with kerbs broken every metre, lanes of one-metre
//! points, and agents that drive in the lanes.

#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use ccdiff_sim::dynamics::{BicycleLimits, Dynamics};
use ccdiff_sim::events::{Collisions, lane_facts, off_road};
use ccdiff_sim::geom::{OrientedBox, Point2, Polygon, Polyline, Pose2, Real, Region, Vector2, math};
use ccdiff_sim::scene::{AgentKind, Lane, LaneIndex, LaneKind, Map};
use ccdiff_sim::state::{AgentStates, Footprint};
use std::hint::black_box;
use std::time::Instant;

const SIDE_M: Real = 240.0;
const NUM_ROADS: usize = 4;
const HALF_ROAD_M: Real = 5.0;

/// Numbers in [0, 1) (Numerical Recipes' linear congruential generator).
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> Real {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as Real / (1 << 24) as Real
    }
}

/// Best of a few runs, nanoseconds per call.
fn time<T>(name: &str, calls: usize, mut call: impl FnMut(usize) -> T) -> f64 {
    let mut best = f64::INFINITY;
    for _ in 0..7 {
        let start = Instant::now();
        for i in 0..calls {
            black_box(call(i));
        }
        best = best.min(start.elapsed().as_secs_f64() / calls as f64);
    }
    println!("{name:<52} {:>10.1} ns", best * 1e9);
    best * 1e9
}

fn line(from: Point2, to: Point2) -> Vec<Point2> {
    let count = (to - from).norm().ceil() as usize;
    (0..=count).map(|i| from + (to - from) * (i as Real / count as Real)).collect()
}

fn lane(centreline: Vec<Point2>) -> Lane {
    Lane {
        id: String::new(),
        kind: LaneKind::Lane,
        centreline,
        polygon: Polygon::default(),
        successors: vec![],
        predecessors: vec![],
        speed_limit_mps: None,
    }
}

fn city() -> Map {
    let mut numbers = Numbers(1);
    let mut map = Map::default();
    for road in 0..NUM_ROADS {
        let at = (road as Real + 0.5) * SIDE_M / NUM_ROADS as Real;
        for along_x in [true, false] {
            let place = |s: Real, offset: Real| match along_x {
                true => Point2::new(s, at + offset),
                false => Point2::new(at + offset, s),
            };
            let right = if along_x { -1.75 } else { 1.75 };
            map.lanes.push(lane(line(place(0.0, right), place(SIDE_M, right))));
            map.lanes.push(lane(line(place(SIDE_M, -right), place(0.0, -right))));
            let mut kerb = |offset: Real| -> Vec<Point2> {
                (0..=SIDE_M as usize).map(|i| place(i as Real, offset + 0.3 * numbers.next())).collect()
            };
            let mut exterior = kerb(HALF_ROAD_M);
            exterior.extend(kerb(-HALF_ROAD_M).into_iter().rev());
            map.drivable_area.push(Polygon::from_exterior(exterior));
        }
    }
    // right turns, curved
    for (i, j) in (0..NUM_ROADS).flat_map(|i| (0..NUM_ROADS).map(move |j| (i, j))) {
        let at = |k: usize| (k as Real + 0.5) * SIDE_M / NUM_ROADS as Real;
        let centre = Point2::new(at(i) - 10.0, at(j) - 10.0);
        let arc = (0..=12).map(|k| {
            let angle = std::f32::consts::FRAC_PI_2 * (1.0 - k as Real / 12.0);
            centre + Vector2::new(angle.cos(), angle.sin()) * 8.25
        });
        map.lanes.push(lane(arc.collect()));
    }
    map
}

/// Agents on the lanes, headings along them, a little beside and askew; at most one pair in a hundred agents overlaps
/// where `apart` is asked for.
fn traffic(map: &Map, num_agents: usize, apart: bool) -> (AgentStates, Vec<Footprint>, Vec<AgentKind>) {
    let mut numbers = Numbers(7);
    let mut states = AgentStates::new(num_agents);
    let lines: Vec<Polyline> = map.lanes.iter().filter_map(|l| Polyline::new(l.centreline.clone())).collect();
    let footprint = Footprint::new(4.6, 1.9);
    let mut agent = 0;
    while agent < num_agents {
        let line = &lines[(numbers.next() * lines.len() as Real) as usize];
        let at = line.at(numbers.next() * line.length_m());
        let (aside, askew) = (numbers.next() - 0.5, 0.2 * (numbers.next() - 0.5));
        let pose = Pose2::new(
            at.position.x - aside * at.sin,
            at.position.y + aside * at.cos,
            at.heading_rad + askew,
        );
        states.set_pose(agent, pose, pose.rotate(Vector2::new(10.0 * numbers.next(), 0.0)));
        states.active[agent] = true;
        let own = states.oriented_box(agent, &footprint);
        let hits = |other: usize| own.overlaps(&states.oriented_box(other, &footprint));
        if !apart || agent % 100 == 99 || !(0..agent).any(hits) {
            agent += 1;
        }
    }
    (states, vec![footprint; num_agents], vec![AgentKind::Vehicle; num_agents])
}

fn main() {
    let map = city();
    let edges: usize = map.drivable_area.iter().flat_map(Polygon::rings).map(<[_]>::len).sum();
    println!("{} polygons, {edges} edges, {} lanes", map.drivable_area.len(), map.lanes.len());
    let (Some(region), Some(lanes)) = (Region::new(&map.drivable_area), LaneIndex::new(&map)) else { return };
    println!("region {} KiB, lane index {} KiB", region.num_bytes() / 1024, lanes.num_bytes() / 1024);
    time("build region", 3, |_| Region::new(&map.drivable_area));
    time("build lane index", 3, |_| LaneIndex::new(&map));

    const CALLS: usize = 1 << 16;
    let mut numbers = Numbers(3);
    let mut anywhere = || Point2::new(SIDE_M * numbers.next(), SIDE_M * numbers.next());
    let points: Vec<Point2> = (0..CALLS).map(|_| anywhere()).collect();
    let (states, footprints, _) = traffic(&map, CALLS, false);
    let boxes: Vec<OrientedBox> = (0..CALLS).map(|i| states.oriented_box(i, &footprints[i])).collect();
    let mut near = |b: &OrientedBox| {
        let by = Vector2::new(12.0 * numbers.next() - 6.0, 12.0 * numbers.next() - 6.0);
        OrientedBox { centre: b.centre + by, ..*b }
    };
    let others: Vec<OrientedBox> = boxes.iter().map(&mut near).collect();

    time("box overlap", CALLS, |i| boxes[i].overlaps(&others[i]));
    time("box time to contact", CALLS, |i| {
        boxes[i].time_to_contact(states.velocity(i), &others[i], states.velocity(CALLS - 1 - i), 5.0)
    });
    time("box time to contact, far apart", CALLS, |i| {
        let other = (7 * i + 1) % CALLS;
        boxes[i].time_to_contact(states.velocity(i), &boxes[other], states.velocity(other), 5.0)
    });
    time("atan2", CALLS, |i| math::atan2(states.sin[i], states.cos[i]));
    time("sin and cos", CALLS, |i| math::sin_cos(states.heading_rad[i]));
    time("region contains, anywhere", CALLS, |i| region.contains(points[i]));
    time("region contains, box corners of agents on lanes", CALLS, |i| {
        boxes[i].corners().map(|c| region.contains(c))
    });
    let polygon = &map.drivable_area[0];
    time("polygon contains, 482 edges (no index)", 1024, |i| polygon.contains(points[i]));
    time("nearest lane, agents on lanes", CALLS, |i| {
        lanes.nearest(states.position(i), states.cos[i], states.sin[i], 10.0)
    });
    time("off road, agents on lanes", CALLS, |i| off_road(&states, i, &footprints[i], &region));
    time("lane facts, agents on lanes", CALLS, |i| lane_facts(&states, i, &lanes, 10.0));
    if let Some(route) = Polyline::new(map.lanes[0].centreline.clone()) {
        time("line at", CALLS, |i| route.at(points[i].x));
        time("line project near, window 5 m", CALLS, |i| route.project_near(points[i], points[i].x, 5.0));
        time("line project, 240 segments", 4096, |i| route.project(points[i]));
    }
    let mut moving = states.clone();
    for dynamics in [Dynamics::default(), Dynamics::Bicycle(BicycleLimits::default())] {
        let name = format!("{} step of an agent", dynamics.name());
        time(&name, CALLS, |i| dynamics.step_agent(&mut moving, i, [0.1, 0.02, 0.0], 0.1, &footprints[i]));
    }

    for num_agents in [8, 32, 64, 96, 128, 256, 512] {
        let (states, footprints, kinds) = traffic(&map, num_agents, true);
        let mut collisions = Collisions::new();
        let calls = 200_000 / num_agents;
        println!("A = {num_agents}");
        let per_agent = |name: &str, call: &mut dyn FnMut()| {
            let per_call = time(name, calls, |_| call());
            println!("{:<52} {:>10.1} ns", "    per agent", per_call / num_agents as f64);
        };
        per_agent("  detect", &mut || collisions.detect(&states, &footprints, &kinds));
        per_agent("  detect, circles", &mut || collisions.detect_by_circles(&states, &footprints, &kinds));
        per_agent("  detect, sweep", &mut || collisions.detect_by_sweep(&states, &footprints, &kinds));
        println!("    {} pairs", collisions.pairs().len());
    }
}
