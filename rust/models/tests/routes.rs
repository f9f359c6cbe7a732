//! A network that is told where its vehicles go.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::ModelConfig;
use ccdiff_models::features::{self, Window, route_ahead};
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_models::trajectory_model::{PlanInput, PlanOptions};
use ccdiff_sim::geom::{Point2, Pose2, Vector2};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::stage::Route;
use common::runs::{exported, loaded, quick, run_on};
use std::path::Path;
use std::sync::Arc;

const NOW: usize = 40;
const POINTS_M: [f32; 3] = [5.0, 10.0, 20.0];

fn network(points_m: &[f32]) -> ModelConfig {
    ModelConfig { map: None, route_points_m: points_m.to_vec(), ..ModelConfig::fast() }
}

/// 6 m/s along x; from now on with a yaw rate, rad/s.
fn bend(yaw_rate_radps: f32) -> Arc<Scene> {
    let straight = common::scene(&[[0.0, 0.0, 0.0, 6.0, 0.0]], 110);
    let mut scene = Scene::clone(&straight);
    let (mut at, mut heading) = (scene.tracks.position[NOW], 0.0f32);
    for step in NOW + 1..scene.num_steps {
        heading += 0.1 * yaw_rate_radps;
        let velocity = Vector2::new(6.0 * heading.cos(), 6.0 * heading.sin());
        at += velocity * 0.1;
        scene.tracks.position[step] = at;
        scene.tracks.heading_rad[step] = heading;
        scene.tracks.velocity[step] = velocity;
    }
    Arc::new(scene)
}

fn run(scenes: Vec<Arc<Scene>>, model: &ModelConfig) -> Trainer {
    // the moment before the fork, and some after it
    run_on(scenes, 5, model, TrainConfig { drop_route: 0.3, ..quick("ccdiff", 4) })
}

/// The window at the fork, with the route of the scene told or not.
fn window(scene: &Scene, points_m: Option<&[f32]>) -> Window {
    let mut window = Window::from_scene(scene, NOW, &[0], 31);
    let at = scene.tracks.position[NOW];
    if let Some(points_m) = points_m {
        let route = Route::new(scene, 0, None);
        window.routes = vec![route_ahead(&route, route.path.project(at).s_m, points_m)];
    }
    window
}

/// Planned states of 16 seeds.
fn planned(weights: &Path, window: &Window) -> Vec<f32> {
    let mut model = loaded(weights);
    let plan = |seed| {
        let view = PlanInput { window, map: None, seed, guide: None };
        model.plan(&[view], &PlanOptions::default()).unwrap().remove(0).states
    };
    (0..16).flat_map(plan).collect()
}

#[test]
fn places_ahead_are_those_of_the_route_in_the_agents_frame() {
    let scene = bend(0.0);
    let mut window = window(&scene, None);
    // seen from (24, 0), heading north in place of east
    let here = window.poses[30].position;
    window.poses[30] = Pose2::new(here.x, here.y, std::f32::consts::FRAC_PI_2);
    window.routes = vec![vec![Point2::new(29.0, 0.0), Point2::new(34.0, 1.0)]];
    let built = features::build(&window, None, &network(&POINTS_M[..2])).unwrap();
    let expected = [1.0, 0.0, -5.0, 1.0, -10.0];
    assert!(built.route.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", built.route);
    window.routes = vec![Vec::new()];
    let untold = features::build(&window, None, &network(&POINTS_M[..2])).unwrap();
    assert_eq!(untold.route, [0.0; 5]);
}

#[test]
fn a_network_that_begins_with_weights_plans_as_they_do_until_it_has_learned_routes() {
    let scene = bend(0.2);
    let mut first = run(vec![scene.clone()], &network(&[]));
    first.run(3).unwrap();
    let base = exported(&first, "base");
    let mut second = run(vec![scene.clone()], &network(&POINTS_M)).begun_with(&base).unwrap();
    let grown = exported(&second, "grown");
    let plain = planned(&base, &window(&scene, None));
    for points_m in [None, Some(&POINTS_M[..])] {
        assert_eq!(planned(&grown, &window(&scene, points_m)), plain, "{points_m:?}");
    }
    second.run(3).unwrap();
    let grown = exported(&second, "grown");
    assert_ne!(
        planned(&grown, &window(&scene, Some(&POINTS_M))),
        planned(&grown, &window(&scene, None)),
        "a route that is told changes nothing"
    );
    let narrow = ModelConfig { width: 32, ..network(&POINTS_M) };
    assert!(run(vec![scene.clone()], &narrow).begun_with(&base).is_err());
    assert!(run(vec![scene], &network(&[])).begun_with(&grown).is_err(), "parts that are left over");
}
