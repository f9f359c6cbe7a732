//! Observation rows: bounds, frames, masks, order.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use ccdiff_sim::events::leader;
use ccdiff_sim::geom::{Point2, Pose2, Vector2};
use ccdiff_sim::observe::{Layout, MapSegments, ObservationConfig};
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::scene::{Map, Scene};
use ccdiff_sim::stage::Route;
use ccdiff_sim::state::Footprint;
use ccdiff_sim::world::{Autoreset, WorldConfig};
use common::{Batch, actions, city};
use proptest::prelude::*;
use std::sync::Arc;

fn config() -> WorldConfig {
    WorldConfig { autoreset: Autoreset::SameStep, traffic: "idm".into(), ..WorldConfig::default() }
}

#[test]
fn the_leader_of_the_observation_is_that_of_the_events() {
    let scene = city(40);
    let route = Route::new(&scene, 0, None);
    let footprints: Vec<_> = scene.agents.iter().map(|a| Footprint::new(a.length_m, a.width_m)).collect();
    let mut batch = Batch::new(vec![scene], config(), 1, 1);
    batch.reset_all(1);
    let ego = batch.world.layout().entry("ego").unwrap().clone();
    let column = |name: &str| ego.columns.iter().position(|c| c.name == name).unwrap();
    let [gap, closing, near, braking] =
        ["leader_gap", "leader_closing", "leader_near", "leader_braking"].map(column);
    let mut seen = [0, 0];
    for t in 0..60 {
        batch.step(&actions(t, 2)).unwrap();
        let status = batch.world.status(0).unwrap();
        let found = leader(status.states, &footprints, &route.path, status.route_s_m[0], 0, 1.0);
        let (expected_gap, expected_closing) =
            found.map_or((60.0, 0.0), |l| (l.gap_m, status.states.speed_mps[0] - l.speed_mps));
        assert!((batch.obs[gap] * 60.0 - expected_gap.clamp(0.0, 60.0)).abs() < 1e-3);
        assert!((batch.obs[closing] * 20.0 - expected_closing).abs() < 1e-3);
        assert!((batch.obs[near] * 10.0 - expected_gap.clamp(0.0, 10.0)).abs() < 1e-3);
        let v = expected_closing.max(0.0);
        let expected = v * v / (2.0 * (expected_gap - 2.0).max(0.1));
        assert!((batch.obs[braking] * 10.0 - expected.min(10.0)).abs() < 1e-2);
        seen[usize::from(found.is_some())] += 1;
    }
    assert!(seen.iter().all(|n| *n > 0), "{seen:?}");
}

#[test]
fn places_of_agents_along_the_route_agree_with_a_search_along_it() {
    let scene = city(30);
    let route = Route::new(&scene, 0, None);
    let mut batch = Batch::new(vec![scene], config(), 1, 1);
    batch.reset_all(1);
    let agents = batch.world.layout().entry("agents").unwrap().clone();
    let column = |name: &str| agents.columns.iter().position(|c| c.name == name).unwrap();
    let names = ["x", "y", "route_position", "route_distance", "route_speed"].map(column);
    let mut compared = 0;
    for t in 0..60 {
        batch.step(&actions(t, 2)).unwrap();
        let status = batch.world.status(0).unwrap();
        let (s, ego, ego_s) = (status.states, status.states.pose(0), status.route_s_m[0]);
        for row in batch.obs[agents.offset..].chunks_exact(agents.shape[1]).take(agents.shape[0]) {
            let [x, y, position, distance, speed] = names.map(|i| row[i] * agents.columns[i].scale);
            let p = ego.to_outer(Point2::new(x, y));
            let Some(j) = (1..s.len()).find(|j| s.active[*j] && (s.position(*j) - p).norm() < 0.05) else {
                continue;
            };
            // a centimetre from place to place, sixty metres to both sides
            let places = (-6000..=6000).map(|k| ego_s + 0.01 * k as f32);
            let places = places.filter(|at| *at >= 0.0 && *at <= route.path.length_m());
            let away = |at: f32| (s.position(j) - route.path.at(at).position).norm();
            let nearest = places.min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
            let at = route.path.at(nearest);
            let aside = at.to_local(s.position(j));
            assert!(
                (position - (nearest - ego_s).clamp(-60.0, 60.0)).abs() < 0.05,
                "{position} {nearest} {ego_s}"
            );
            assert!((distance - aside.y.clamp(-10.0, 10.0)).abs() < 0.05, "{distance} {aside}");
            let along = s.velocity_x_mps[j] * at.cos + s.velocity_y_mps[j] * at.sin;
            assert!((speed - along.clamp(-20.0, 20.0)).abs() < 0.05);
            compared += 1;
        }
    }
    assert!(compared > 200, "{compared}");
}

/// The scene turned by an angle and moved.
fn moved(scene: &Scene, by: Pose2) -> Scene {
    let mut out = scene.clone();
    let point = |p: &Point2| by.to_outer(*p);
    for p in &mut out.tracks.position {
        *p = point(p);
    }
    for h in &mut out.tracks.heading_rad {
        *h += by.heading_rad;
    }
    for v in &mut out.tracks.velocity {
        *v = by.rotate(Vector2::new(v.x, v.y));
    }
    let mut map = Map::clone(&out.map);
    for lane in &mut map.lanes {
        lane.centreline.iter_mut().chain(&mut lane.polygon.exterior).for_each(|p| *p = point(p));
    }
    map.drivable_area.iter_mut().flat_map(|p| &mut p.exterior).for_each(|p| *p = point(p));
    map.road_dividers.iter_mut().flatten().for_each(|p| *p = point(p));
    out.map = Arc::new(map);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn moving_the_whole_scene_changes_nothing(
        x in -300f32..300., y in -300f32..300., turn in -3f32..3.,
    ) {
        let scene = GridCity { num_agents: 20, ..GridCity::default() }.scene();
        let there = moved(&scene, Pose2::new(x, y, turn));
        let run = |scene: Scene| {
            let scene = Arc::new(scene.validated().unwrap());
            let mut batch = Batch::new(vec![scene], config(), 1, 1);
            batch.reset_all(4);
            for t in 0..10 {
                batch.step(&actions(t, 2)).unwrap();
            }
            (batch.obs.clone(), batch.reward[0])
        };
        let ((a, ra), (b, rb)) = (run(scene), run(there));
        for (i, (u, v)) in a.iter().zip(&b).enumerate() {
            prop_assert!((u - v).abs() < 5e-3, "float {} is {} and {}", i, u, v);
        }
        prop_assert!((ra - rb).abs() < 5e-3);
    }
}

#[test]
fn map_segments_cover_their_lines_and_the_cut_is_left_out() {
    let scene = GridCity { num_roads: 1, ..GridCity::default() }.scene();
    let segments = MapSegments::new(&scene.map);
    let total: f32 = segments.segments().map(|p| 2.0 * p.half_length_m).sum();
    // two roads of 80 m: two lanes and a divider each; the edges of the crossing roads but for the ends, which lie on
    // the rectangle of the crop
    let expected = 2.0 * 80.0 * 3.0 + 2.0 * 2.0 * 80.0;
    assert!((total - expected).abs() < 1.0, "{total} against {expected}");
    assert!(segments.segments().all(|p| p.half_length_m <= 2.51));
    let near = segments.nearest(Point2::new(3.0, -2.0));
    let all: Vec<_> = segments.segments().collect();
    let distance = |k: u32| {
        let segment = all[k as usize];
        (segment.x - 3.0).hypot(segment.y + 2.0)
    };
    assert!(near.windows(2).all(|w| distance(w[0]) <= distance(w[1]) + 5.7));
    let best = (0..segments.len() as u32).map(distance).fold(f32::MAX, f32::min);
    assert!(distance(near[0]) <= best + 5.7);
}

/// Observations of all agents of a city after a few steps.
fn observed(observation: ObservationConfig, num_agents: usize) -> (Layout, Vec<f32>) {
    let config = WorldConfig {
        controlled: ccdiff_sim::world::Controlled::Vehicles,
        num_slots: num_agents,
        on_collision: ccdiff_sim::world::Consequence::Ignore,
        on_off_road: ccdiff_sim::world::Consequence::Ignore,
        observation,
        ..config()
    };
    let mut batch = Batch::new(vec![city(num_agents)], config, 1, 1);
    batch.reset_all(7);
    for t in 0..5 {
        batch.step(&actions(t, 2 * num_agents)).unwrap();
    }
    (batch.world.layout().clone(), batch.obs)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Some rows are written by loops of their own, those of the comparison and the whole rows of the map among them.
    #[test]
    fn chosen_columns_are_the_columns_of_whole_rows(
        num_agents in 2usize..90, rows in 0usize..70, segments in 0usize..250, columns in 0usize..3,
    ) {
        let names = |n: &[&str]| Some(n.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>());
        let agent_columns = ["x", "y", "cos", "sin", "speed", "length", "width"];
        let map_columns = match columns {
            0 => vec!["x", "y", "cos", "sin", "half_length", "is_road_edge", "is_lane"],
            1 => vec!["is_lane", "y", "x"],
            _ => vec!["x", "y", "cos", "sin", "half_length"],
        };
        let whole = ObservationConfig { num_neighbors: rows, num_map_segments: segments, ..ObservationConfig::default() };
        let chosen = ObservationConfig {
            agent_columns: names(&agent_columns), map_columns: names(&map_columns), ..whole.clone()
        };
        let (of_whole, of_chosen) = (observed(whole, num_agents), observed(chosen, num_agents));
        for (entry, names) in [("agents", &agent_columns[..]), ("map", &map_columns[..])] {
            let Some(e) = of_whole.0.entry(entry) else { continue };
            let f = of_chosen.0.entry(entry).unwrap();
            for a in 0..num_agents {
                for row in 0..e.shape[0] {
                    for (k, name) in names.iter().enumerate() {
                        let column = e.columns.iter().position(|c| c.name == *name).unwrap();
                        let expected = of_whole.1[a * of_whole.0.size + e.offset + row * e.shape[1] + column];
                        let got = of_chosen.1[a * of_chosen.0.size + f.offset + row * f.shape[1] + k];
                        prop_assert_eq!(got, expected, "{} of row {} of {}", name, row, entry);
                    }
                }
            }
        }
    }
}
