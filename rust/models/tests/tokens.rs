//! What tokens are learned from: mirrored rows are rows of a mirrored world, and untold routes are hidden everywhere.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::batch::Batch;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::Dataset;
use ccdiff_models::features::{SceneFeatures, Window};
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::segments::MapLines;
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_nets::inputs::segments::SEGMENT_ODD;
use ccdiff_nets::inputs::tokens::{self, near_columns, own_columns};
use ccdiff_sim::geom::Point2;
use ccdiff_sim::scene::{Map, Scene};
use common::runs::run_on;
use std::sync::Arc;
use tch::Device;

fn config() -> ModelConfig {
    ModelConfig::of("tokens", "fast").unwrap()
}

/// Three vehicles that drive and turn, on lanes with a divider; `side` -1 mirrors all of it.
fn town(side: f32) -> Scene {
    let rows = [[0.0, 1.0, 0.02, 7.0, 0.3], [14.0, -2.5, -0.05, 5.0, -0.1], [30.0, 4.0, 3.0, 6.0, 0.2]];
    let rows = rows.map(|[x, y, yaw, speed, acceleration]| [x, side * y, side * yaw, speed, acceleration]);
    let mut scene = Scene::clone(&common::scene(&rows, 110));
    for (at, heading) in scene.tracks.heading_rad.iter_mut().enumerate() {
        // they turn, too
        *heading += side * 1e-5 * ((at % 110) as f32).powi(2);
    }
    let line = |y: f32, end: f32| vec![Point2::new(-90.0, side * y), Point2::new(90.0, side * end)];
    let map = Map {
        lane_dividers: vec![line(0.0, 4.0)],
        road_dividers: vec![line(5.0, 9.0), line(-4.0, -4.0)],
        ..Map::default()
    };
    Scene { map: Arc::new(map), ..scene }
}

fn seen(side: f32) -> SceneFeatures {
    let (scene, config) = (town(side), config());
    let mut window = Window::from_scene(&scene, 70, &[0, 1, 2], config.history_steps);
    let place = |k: f32| Point2::new(10.0 + 5.0 * k, side * (1.0 + 0.2 * k * k));
    window.routes = vec![(0..16u8).map(|k| place(f32::from(k))).collect(), Vec::new(), Vec::new()];
    tokens::build(&window, Some(&MapLines::from_scene(&scene)), &config).unwrap()
}

#[test]
fn mirrored_rows_are_those_of_the_mirrored_world() {
    let (a, b) = (seen(1.0), seen(-1.0));
    let own: Vec<bool> = own_columns(16).map(|c| c.0).collect();
    let near: Vec<bool> = near_columns().map(|c| c.0).collect();
    let parts = [
        (&a.tokens.own, &b.tokens.own, own),
        (&a.tokens.near, &b.tokens.near, near),
        (&a.segments, &b.segments, SEGMENT_ODD.to_vec()),
    ];
    for (k, (a, b, odd)) in parts.into_iter().enumerate() {
        for (at, (x, y)) in a.iter().zip(b).enumerate() {
            let sign = if odd[at % odd.len()] { -1.0 } else { 1.0 };
            assert!((x - sign * y).abs() < 1e-4, "part {k}, number {}: {x} and {y}", at % odd.len());
        }
        // each column that may change sign is told apart by some row
        let told = |column: usize| a.chunks(odd.len()).any(|row| row[column] != 0.0);
        assert!((0..odd.len()).filter(|c| odd[*c]).all(told), "part {k}");
    }
}

#[test]
fn rows_whose_route_is_dropped_are_those_that_were_never_told() {
    let config = config();
    let told = seen(1.0);
    let mut untold = seen(1.0);
    let mut window = Window::from_scene(&town(1.0), 70, &[0, 1, 2], config.history_steps);
    window.routes = Vec::new();
    let map = MapLines::from_scene(&town(1.0));
    untold.clone_from(&tokens::build(&window, Some(&map), &config).unwrap());
    let batch = |f: &SceneFeatures| Batch::new(vec![f.clone()], Device::Cpu).unwrap();
    let dropped = batch(&told).with_routes_dropped(|_| true).scenes.remove(0);
    assert_eq!((dropped.tokens, dropped.route), (untold.tokens.clone(), untold.route));
    assert_ne!(told.tokens.near, untold.tokens.near);
}

#[test]
fn a_run_learns_the_tokens_of_its_log() {
    let data = Dataset::new(vec![common::closing_pair()], &config(), 3).unwrap();
    let training = TrainConfig { batch_scenes: 8, ..TrainConfig::of("tokens", "fast").unwrap() };
    let mut run = run_on(vec![common::closing_pair()], 3, &config(), training);
    let nats = |run: &Trainer| run.validate(&data, 2, SampleOptions::default()).unwrap().nats.unwrap()[0];
    let before = nats(&run);
    let losses = run.run(30).unwrap();
    assert!(losses[29] < losses[0] - 1.0, "{losses:?}");
    assert!(nats(&run) < before - 1.0, "{before}");
}
