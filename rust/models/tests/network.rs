//! The network as a whole: sizes, causality of G, training, resume, sampling, weight files.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::batch::Batch;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::{Dataset, vehicles};
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::noise::Noise;
use ccdiff_models::sampler::{self, SampleOptions};
use ccdiff_models::schedule::Schedule;
use ccdiff_models::torch::Torch;
use ccdiff_models::torch_model;
use ccdiff_models::train::{TrainConfig, Trainer, settings_of};
use ccdiff_models::trajectory_model::{PlanInput, PlanOptions};
use ccdiff_models::{ModelError, segments::MapLines};
use ccdiff_nets::networks::planner::{Denoises, Weighted};
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::scene::{Map, Scene};
use std::path::PathBuf;
use std::sync::Arc;
use tch::{Device, Kind, Tensor, nn};

type Network = ccdiff_nets::networks::ccdiff::Network<Torch>;

fn blind(config: ModelConfig) -> ModelConfig {
    ModelConfig { map: None, ..config }
}

fn features_of(scene: &Scene, step: usize, config: &ModelConfig) -> SceneFeatures {
    let window = Window::from_scene(scene, step, &vehicles(scene), config.history_steps);
    features::build(&window, Some(&MapLines::from_scene(scene)), config).unwrap()
}

fn network(config: &ModelConfig) -> (nn::VarStore, Network) {
    let store = nn::VarStore::new(Device::Cpu);
    let network = common::seeded(|| Network::new(&store.root(), config));
    (store, network)
}

fn count(store: &nn::VarStore) -> usize {
    store.trainable_variables().iter().map(Tensor::numel).sum()
}

fn temporary(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ccdiff-models-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

#[test]
fn the_paper_preset_has_the_released_number_of_parameters_in_use() {
    // reference.md#token-stream: 1,024 + 896 + 131,712 + 22,336 + 661,504 + 1,222,400 + 258
    assert_eq!(count(&network(&blind(ModelConfig::paper())).0), 2_040_130);
    // plus the encoder of lines (20 x 256, 256 x 256, 512 x 256, biases, norm) and the attention to its tokens (98,816)
    assert_eq!(count(&network(&ModelConfig::paper()).0), 2_040_130 + 203_008 + 98_816);
}

#[test]
fn the_shipped_preset_stays_small() {
    assert!(count(&network(&ModelConfig::fast()).0) < 500_000);
}

/// Plans from one noisy input.
fn denoised(network: &Network, batch: &Batch) -> Tensor {
    let knots = network.config().num_knots() as i64;
    let rows = batch.num_rows();
    let values = Noise::new(5, 5).normals((rows * knots * 2) as usize);
    let noisy = Tensor::from_slice(&values).view([rows, knots, 2]);
    let steps = Tensor::full([rows], 40, (Kind::Int64, Device::Cpu));
    tch::no_grad(|| network.predict(&network.encode(batch), &noisy, &steps).0)
}

#[test]
fn with_the_identity_graph_an_agents_plan_does_not_depend_on_the_others() {
    for config in [ModelConfig::fast(), ModelConfig::paper()] {
        let (_store, network) = network(&config);
        let near = common::closing_pair();
        let far = common::scene(
            &[[0.0, 0.0, 0.0, 12.0, -0.5], [28.0, 1.5, 0.1, 2.0, 0.0], [150.0, -4.0, 3.1, 6.0, 0.0]],
            110,
        );
        let plans = |scene: &Scene, identity: bool| {
            let features = features_of(scene, 20, &config);
            assert!(features.is_edge[1], "the pair is joined in G");
            let batch = Batch::new(&[&features], &config, Device::Cpu).unwrap();
            let all = Tensor::ones([batch.num_rows()], (Kind::Bool, Device::Cpu));
            let dropped = batch.with_graph_dropped(&all);
            let alone = batch.with_identity_graph();
            if identity {
                let (a, b) = (denoised(&network, &dropped), denoised(&network, &alone));
                assert!(a.allclose(&b, 1e-4, 1e-5, false), "dropping equals the identity graph");
                a.get(0)
            } else {
                denoised(&network, &batch).get(0)
            }
        };
        assert!(plans(&near, true).allclose(&plans(&far, true), 1e-5, 1e-6, false));
        assert!(!plans(&near, false).allclose(&plans(&far, false), 1e-3, 1e-3, false));
        assert!(!plans(&near, false).allclose(&plans(&near, true), 1e-4, 1e-4, false));
    }
}

/// A road in a map that goes on all round: where the map was cut out there are no lines.
fn road_in_town() -> Scene {
    let scene = common::scene(&[[0.0, 1.3, 0.0, 12.0, -0.5], [30.0, 0.5, 0.0, 4.0, 0.3]], 110);
    let mut map = Map::clone(&scene.map);
    map.road_dividers.push(vec![Point2::new(-400.0, -400.0), Point2::new(400.0, 400.0)]);
    Scene { map: Arc::new(map), ..Scene::clone(&scene) }
}

#[test]
fn the_map_changes_the_plan() {
    let config = ModelConfig::fast();
    let (_store, network) = network(&config);
    let scene = road_in_town();
    let with_map = features_of(&scene, 40, &config);
    let window = Window::from_scene(&scene, 40, &vehicles(&scene), config.history_steps);
    let without = features::build(&window, None, &config).unwrap();
    let plan = |f: &SceneFeatures| denoised(&network, &Batch::new(&[f], &config, Device::Cpu).unwrap());
    assert!(!plan(&with_map).allclose(&plan(&without), 1e-4, 1e-4, false));
}

#[test]
fn a_scene_that_is_turned_and_moved_shows_the_same_lines() {
    let (config, scene) = (ModelConfig::fast(), road_in_town());
    let turn = Pose2::new(500.0, -300.0, 0.9);
    let shift = |p: &mut Point2| *p = turn.to_outer(*p);
    let (mut moved, mut map) = (scene.clone(), Map::clone(&scene.map));
    moved.tracks.position.iter_mut().for_each(shift);
    moved.tracks.heading_rad.iter_mut().for_each(|h| *h += 0.9);
    moved.tracks.velocity.iter_mut().for_each(|v| *v = turn.rotate(*v));
    map.drivable_area.iter_mut().flat_map(|a| &mut a.exterior).for_each(shift);
    map.road_dividers.iter_mut().flatten().for_each(shift);
    moved.map = Arc::new(map);
    let (here, there) = (features_of(&scene, 40, &config), features_of(&moved, 40, &config));
    assert_eq!(here.agents.len(), 2);
    // lines as far from the way as others may change places with them
    let of_agents =
        |f: &SceneFeatures| f.segments.chunks(f.segments.len() / 2).map(<[f32]>::to_vec).collect();
    let (here, there): (Vec<Vec<f32>>, Vec<Vec<f32>>) = (of_agents(&here), of_agents(&there));
    for (here, there) in here.iter().zip(&there) {
        for line in here.chunks(20) {
            let far = |other: &[f32]| line.iter().zip(other).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            let least = there.chunks(20).map(far).fold(f32::MAX, f32::min);
            assert!(line[11] == 1.0 && least < 1e-3, "{line:?} {least}");
        }
    }
}

fn trainer(config: &ModelConfig, training: TrainConfig) -> Trainer {
    let data = Dataset::new(vec![common::closing_pair()], config, 10).unwrap();
    common::seeded(|| Trainer::new(config.clone(), training, data, Device::Cpu).unwrap())
}

fn quick(batch_scenes: usize) -> TrainConfig {
    TrainConfig {
        batch_scenes,
        warmup_steps: 0,
        perturb: false,
        ..TrainConfig::of("ccdiff", "fast").unwrap()
    }
}

#[test]
fn the_fast_preset_learns_one_batch() {
    let losses = trainer(&ModelConfig::fast(), quick(4)).run(80).unwrap();
    let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
    assert!(mean(&losses[70..]) < 0.3 * mean(&losses[..5]), "{losses:?}");
}

#[test]
fn the_paper_preset_learns_one_batch_and_samples() {
    let config = ModelConfig::paper();
    let training = TrainConfig { learning_rate: 1e-3, collision_weight: 0.0, ..quick(1) };
    let mut run = trainer(&config, training);
    let losses = run.run(8).unwrap();
    assert!(losses[7] < 0.7 * losses[0], "{losses:?}");
    let path = temporary("paper.safetensors");
    run.export(&path, &serde_json::json!({})).unwrap();
    let mut model = torch_model::load(&path, Device::Cpu).unwrap();
    let scene = common::closing_pair();
    let map = model.map(&scene);
    let window = Window::from_scene(&scene, 40, &vehicles(&scene), 31);
    let view = PlanInput { window: &window, map: map.as_ref(), seed: 1, guide: None };
    let options = SampleOptions {
        solver_steps: Some(2),
        num_samples: 2,
        guidance_weight: 1.1,
        ..SampleOptions::default()
    };
    let plan = model.plan(&[view], &options.into()).unwrap().remove(0);
    assert_eq!((plan.actions.len(), plan.states.len()), (2 * 3 * 52 * 2, 2 * 3 * 52 * 6));
    assert!(plan.states.iter().all(|v| v.is_finite()));
}

#[test]
fn a_resumed_run_continues_bit_for_bit() {
    let config = blind(ModelConfig::fast());
    let training = TrainConfig { perturb: true, ema_start: 2, ..quick(3) };
    let path = temporary("resume.safetensors");
    let mut whole = trainer(&config, training.clone());
    let mut expected = whole.run(4).unwrap();
    whole.cool_down(10);
    whole.save(&path).unwrap();
    expected = [expected, whole.run(4).unwrap()].concat();
    let mut again = trainer(&config, training);
    assert_eq!(settings_of(&path).unwrap().0, config);
    again.resume(&path).unwrap();
    assert_eq!(again.step(), 4);
    assert_eq!(again.run(4).unwrap(), expected[4..]);
    let files = [temporary("whole.safetensors"), temporary("again.safetensors")];
    whole.export(&files[0], &serde_json::json!({})).unwrap();
    again.export(&files[1], &serde_json::json!({})).unwrap();
    assert_eq!(std::fs::read(&files[0]).unwrap(), std::fs::read(&files[1]).unwrap());
    let mut other = trainer(&config, quick(2));
    assert!(matches!(other.resume(&path), Err(ModelError::Checkpoint { .. })));
}

#[test]
fn a_worlds_samples_depend_on_its_own_seed_and_not_on_its_neighbours() {
    let config = ModelConfig::fast();
    let (_store, network) = network(&config);
    let schedule = Schedule::cosine(100).unwrap();
    let scene = common::closing_pair();
    let (a, b) = (features_of(&scene, 40, &config), features_of(&scene, 60, &config));
    let draw = |scenes: &[&SceneFeatures], seeds: &[u64], solver_steps, weight| {
        let batch = Batch::new(scenes, &config, Device::Cpu).unwrap();
        let options = SampleOptions {
            solver_steps,
            num_samples: 2,
            guidance_weight: weight,
            ..SampleOptions::default()
        };
        tch::no_grad(|| sampler::sample(&network, &schedule, &batch, seeds, options, None).unwrap().knots)
    };
    let few = Some(4);
    let alone = draw(&[&a], &[7], few, 1.0).view([2, 3, 13, 2]);
    let beside = draw(&[&b, &a], &[3, 7], few, 1.0).view([2, 6, 13, 2]).narrow(1, 3, 3);
    assert!(alone.allclose(&beside, 1e-3, 1e-4, false));
    assert!(!alone.get(0).allclose(&alone.get(1), 1e-2, 1e-2, false), "samples differ");
    let other_seed = draw(&[&a], &[8], few, 1.0).view([2, 3, 13, 2]);
    assert!(!alone.allclose(&other_seed, 1e-2, 1e-2, false));
    // guidance pushes the joined pair, and leaves the lone third car as it is
    let guided = draw(&[&a], &[7], few, 1.5).view([2, 3, 13, 2]);
    assert!(!alone.narrow(1, 0, 1).allclose(&guided.narrow(1, 0, 1), 1e-4, 1e-4, false));
    assert!(alone.narrow(1, 2, 1).allclose(&guided.narrow(1, 2, 1), 1e-3, 1e-4, false));
    assert!(draw(&[&a], &[7], None, 1.0).isfinite().all().int64_value(&[]) == 1);
}

#[test]
fn bad_options_and_damaged_files_are_refused_with_the_facts() {
    let config = blind(ModelConfig::fast());
    let run = trainer(&config, quick(1));
    let path = temporary("weights.safetensors");
    run.export(&path, &serde_json::json!({"licence": "test"})).unwrap();
    let mut model = torch_model::load(&path, Device::Cpu).unwrap();
    assert_eq!(model.header()["notes"]["licence"], "test");
    let window = Window::from_scene(&common::closing_pair(), 40, &[0, 1], 30);
    let view = PlanInput { window: &window, map: None, seed: 0, guide: None };
    let short = model.plan(&[view], &PlanOptions::default()).unwrap_err();
    assert!(short.to_string().contains("expected 31"), "{short}");
    let bad = SampleOptions { guidance_weight: 0.4, ..SampleOptions::default() };
    assert!(
        bad.validated()
            .unwrap_err()
            .to_string()
            .contains("guidance_weight is 0.4, expected a number in [1, 2)")
    );
    let empty = Window { num_steps: 31, ..Window::default() };
    let nobody = PlanInput { window: &empty, map: None, seed: 0, guide: None };
    assert!(model.plan(&[nobody], &PlanOptions::default()).unwrap()[0].agents.is_empty());

    let mut bytes = std::fs::read(&path).unwrap();
    bytes.truncate(bytes.len() - 40);
    std::fs::write(&path, bytes).unwrap();
    assert!(matches!(torch_model::load(&path, Device::Cpu), Err(ModelError::Checkpoint { .. })));
    let state = temporary("state.safetensors");
    run.save(&state).unwrap();
    let text = torch_model::load(&state, Device::Cpu).unwrap_err().to_string();
    assert!(text.contains("ccdiff-training"), "{text}");
    let missing = temporary("missing.safetensors");
    assert!(matches!(torch_model::load(&missing, Device::Cpu), Err(ModelError::Io { .. })));
}

#[test]
fn futures_of_a_straight_drive_are_straight_and_masked_where_the_log_ends() {
    let config = blind(ModelConfig::fast());
    let data = Dataset::new(vec![common::closing_pair()], &config, 1).unwrap();
    let (features, futures) = data.sample(0, None).unwrap();
    assert_eq!(features.agents.len(), 2, "the third car is out of range");
    for t in 0..52 {
        let state = &futures.states[t * 6..t * 6 + 6];
        assert!(state[1].abs() < 1e-3 && state[3].abs() < 1e-3 && futures.valid[t]);
        assert!(
            (state[2] - (11.75 - 0.5 * 0.1 * (t as f32 + 0.5))).abs() < 0.02,
            "speed at {t}: {}",
            state[2]
        );
    }
    // a car that closes in at 8 m/s from 25 m is 3 s away
    assert!(features.is_edge[1] && features.ttc_s[1] < 3.0);
    let pushed = data.sample(0, Some(Noise::new(3, 1))).unwrap();
    assert_eq!(data.sample(0, Some(Noise::new(3, 1))).unwrap(), pushed);
    assert!(matches!(data.sample(10_000, None), Err(ModelError::Shape { .. })));
    assert!(matches!(
        Dataset::new(vec![common::scene(&[[0.0; 5]], 40)], &config, 1),
        Err(ModelError::NoSamples { .. })
    ));
}
