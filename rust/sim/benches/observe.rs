//! What a row of observations costs beside filling the same floats: `cargo bench -p ccdiff-sim --bench observe`.
//!
//! All agents of a synthetic city are observed in turn into one buffer [A, D]; the figure is the time of one row.
//! One thread, best of several rounds; `fill` writes a constant to the same buffer.

#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use ccdiff_sim::Result;
use ccdiff_sim::geom::{Polyline, Pose2};
use ccdiff_sim::observe::{EgoFacts, Layout, MapSegments, ObservationConfig, Observer, View};
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::scene::{AgentKind, Scene};
use ccdiff_sim::state::{AgentStates, Footprint};
use std::hint::black_box;
use std::time::Instant;

/// Steps of the log that are observed one after the other, so that agents move as they do in a world.
const STEPS: std::ops::Range<usize> = 30..130;
const ROUNDS: usize = 40;

struct City {
    scene: Scene,
    /// States at each of [`STEPS`].
    states: Vec<AgentStates>,
    footprints: Vec<Footprint>,
    kinds: Vec<AgentKind>,
    segments: MapSegments,
    routes: Vec<Polyline>,
}

impl City {
    fn new(num_agents: usize) -> Self {
        let scene = GridCity { num_agents, ..GridCity::default() }.scene();
        let states: Vec<AgentStates> = STEPS.map(|t| states_at(&scene, t)).collect();
        let routes = (0..num_agents).map(|a| Polyline::straight(&states[0].pose(a), 200.0)).collect();
        Self {
            footprints: scene.agents.iter().map(|a| Footprint::new(a.length_m, a.width_m)).collect(),
            kinds: scene.agents.iter().map(|a| a.kind).collect(),
            segments: MapSegments::new(&scene.map),
            scene,
            states,
            routes,
        }
    }

    fn view(&self, tick: usize, agent_idx: usize) -> View<'_> {
        View {
            states: &self.states[tick % self.states.len()],
            footprints: &self.footprints,
            kinds: &self.kinds,
            segments: &self.segments,
            route: &self.routes[agent_idx],
            route_s_m: 0.0,
            agent_idx,
            facts: EgoFacts {
                last_action: [0.1, -0.2],
                speed_limit_mps: 15.0,
                lane_distance_m: Some(0.3),
                lateral_m: 0.2,
                heading_error_rad: 0.05,
                off_road: false,
                collided: false,
                route_remaining_m: 80.0,
                time_remaining: 0.7,
            },
        }
    }
}

fn states_at(scene: &Scene, step_idx: usize) -> AgentStates {
    let mut states = AgentStates::new(scene.num_agents());
    for a in 0..scene.num_agents() {
        let at = scene.at(a, step_idx);
        let p = scene.tracks.position[at];
        states.set_pose(a, Pose2::new(p.x, p.y, scene.tracks.heading_rad[at]), scene.tracks.velocity[at]);
        states.active[a] = true;
    }
    states
}

/// 7 + 63 x 7 + 200 x 7 floats, less the groups that are left out.
fn comparison_row(num_neighbors: usize, num_map_segments: usize) -> ObservationConfig {
    let names = |n: &[&str]| Some(n.iter().map(|s| (*s).to_owned()).collect());
    ObservationConfig {
        num_neighbors,
        num_route_points: 0,
        num_map_segments,
        radius_m: 200.0,
        masks: false,
        ego_columns: names(&["speed", "acceleration", "yaw_rate", "length", "width", "off_road", "collided"]),
        agent_columns: names(&["x", "y", "cos", "sin", "speed", "length", "width"]),
        map_columns: names(&["x", "y", "cos", "sin", "half_length", "is_lane", "is_road_edge"]),
        ..ObservationConfig::default()
    }
}

/// Nanoseconds of one of `rows` rows, best round.
fn best_ns(rows: usize, mut write: impl FnMut()) -> f64 {
    let mut best = f64::MAX;
    for _ in 0..ROUNDS {
        let (start, mut calls) = (Instant::now(), 0);
        while start.elapsed().as_micros() < 4000 {
            write();
            calls += 1;
        }
        best = best.min(start.elapsed().as_nanos() as f64 / f64::from(calls) / rows as f64);
    }
    best
}

fn report(name: &str, city: &City, config: &ObservationConfig) -> Result<()> {
    let layout = Layout::new(config)?;
    let (num_agents, size) = (city.scene.num_agents(), layout.size);
    let mut observer = Observer::new(layout);
    observer.enter(&city.footprints, &city.kinds, &city.segments);
    let mut out = vec![0.0_f32; num_agents * size];
    let mut tick = 0;
    let write_ns = best_ns(num_agents, || {
        tick += 1;
        observer.prepare(&city.states[tick % city.states.len()], usize::MAX);
        for (a, row) in out.chunks_exact_mut(size).enumerate() {
            observer.write(&city.view(tick, a), row);
        }
        black_box(&out);
    });
    let fill_ns = best_ns(num_agents, || {
        out.fill(black_box(0.5));
        black_box(&out);
    });
    println!(
        "{name:28} A={num_agents:<3} D={size:<5} {write_ns:>7.0} ns/row  fill {fill_ns:>5.0} ns/row  {:>5.1} x fill",
        write_ns / fill_ns
    );
    Ok(())
}

fn main() -> Result<()> {
    for num_agents in [16, 64] {
        let city = City::new(num_agents);
        report("default", &city, &ObservationConfig::default())?;
        report("comparison", &city, &comparison_row(63, 200))?;
        report("comparison, agents alone", &city, &comparison_row(63, 0))?;
        report("comparison, map alone", &city, &comparison_row(0, 200))?;
    }
    Ok(())
}
