//! The networks: sizes, causality of G, training, resume, sampling, weight files, guidance.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::batch::Batch;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::{Dataset, vehicles};
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::guidance::{GuidanceConfig, WorldGuidance};
use ccdiff_models::kinds::build;
use ccdiff_models::noise::Noise;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch::Torch;
use ccdiff_models::train::{TrainConfig, Trainer, settings_of};
use ccdiff_models::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_models::{ModelError, segments::MapLines};
use ccdiff_nets::networks::NETWORKS;
use ccdiff_nets::networks::kinds::named;
use ccdiff_nets::networks::planner::Denoises;
use ccdiff_sim::geom::Point2;
use ccdiff_sim::scene::{Map, Scene};
use common::runs::{exported, loaded, quick, run_on, temporary};
use std::sync::Arc;
use tch::{Device, Tensor, nn};

type Network = ccdiff_nets::networks::ccdiff::Network<Torch>;

const STEPS: usize = 52;

fn kinds() -> impl Iterator<Item = &'static str> {
    NETWORKS.iter().map(|network| network.kind.name)
}

fn config(kind: &str) -> ModelConfig {
    ModelConfig::of(kind, "fast").unwrap()
}

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

fn trainer(kind: &str) -> Trainer {
    let training = TrainConfig { ema_start: 2, ..quick(kind, 2) };
    run_on(vec![common::closing_pair()], 20, &config(kind), training)
}

/// A model trained for some steps.
fn trained(kind: &str, steps: usize) -> TrajectoryModel {
    let mut run = trainer(kind);
    run.run(steps).unwrap();
    loaded(&exported(&run, &format!("{kind}-{steps}")))
}

/// Plans of worlds at steps of a scene, by seed; `guided` vehicles of each are guided.
fn plans(
    model: &mut TrajectoryModel,
    worlds: &[(&Arc<Scene>, usize, u64)],
    options: &PlanOptions,
    guided: Option<&[bool]>,
) -> Result<Vec<Plan>, ModelError> {
    let inputs: Vec<_> = worlds
        .iter()
        .map(|(scene, step, _)| {
            (
                Window::from_scene(scene, *step, &vehicles(scene), model.config().history_steps),
                model.map(scene),
            )
        })
        .collect();
    let views: Vec<PlanInput<'_>> = inputs
        .iter()
        .zip(worlds)
        .map(|((window, map), (_, _, seed))| PlanInput {
            window,
            map: map.as_ref(),
            seed: *seed,
            guide: guided.map(WorldGuidance::new),
        })
        .collect();
    model.plan(&views, options)
}

fn samples(num_samples: usize) -> PlanOptions {
    SampleOptions { num_samples, ..SampleOptions::default() }.into()
}

fn close(a: &[f32], b: &[f32], within: f32) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= within)
}

#[test]
fn every_network_has_the_tabulated_number_of_parameters() {
    // reference.md#token-stream: 1,024 + 896 + 131,712 + 22,336 + 661,504 + 1,222,400 + 258
    let paper = 2_040_130;
    let fast = |kind, count| (kind, config(kind), count);
    for (name, config, want) in [
        ("paper without a map", blind(ModelConfig::paper()), paper),
        // the encoder of lines (20 x 256, 256 x 256, 512 x 256, biases, norm) and the attention to its tokens (98,816)
        ("paper", ModelConfig::paper(), paper + 203_008 + 98_816),
        fast("ccdiff", 351_842),
        fast("simnet", 187_002),
        fast("trafficsim", 315_514),
        fast("strive", 262_330),
        fast("bits", 299_204),
        fast("ctg", 332_466),
        fast("ctgpp", 351_842),
    ] {
        let store = nn::VarStore::new(Device::Cpu);
        common::seeded(|| build(&store.root(), &config).unwrap());
        let got: usize = store.trainable_variables().iter().map(Tensor::numel).sum();
        assert_eq!(got, want, "{name}");
    }
}

/// Plans from one noisy input.
fn denoised(network: &Network, batch: &Batch) -> Tensor {
    let knots = network.config().num_knots() as i64;
    let rows = batch.num_rows() as i64;
    let values = Noise::new(5, 5).normals((rows * knots * 2) as usize);
    let noisy = Tensor::from_slice(&values).view([rows, knots, 2]);
    tch::no_grad(|| network.predict(&network.encode(batch), &noisy, &[40]).0)
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
            let batch = Batch::new(vec![features], Device::Cpu).unwrap();
            let batch = if identity { batch.with_graph_dropped(|_| true) } else { batch };
            denoised(&network, &batch).get(0)
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
    let plan = |f: SceneFeatures| denoised(&network, &Batch::new(vec![f], Device::Cpu).unwrap());
    assert!(!plan(with_map).allclose(&plan(without), 1e-4, 1e-4, false));
}

#[test]
fn every_network_learns_one_batch() {
    for kind in kinds() {
        let mut run = trainer(kind);
        let losses = run.run(70).unwrap();
        let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
        let (first, last) = (mean(&losses[..2]), mean(&losses[60..]));
        // a denoiser starts from a plan that shows the answer where the noise is small
        let share = if named(kind).unwrap().denoises { 0.6 } else { 0.35 };
        assert!(last < share * first, "{kind}: {first} {last}");
    }
}

#[test]
fn the_paper_preset_learns_one_batch_and_samples() {
    let training = TrainConfig { learning_rate: 1e-3, collision_weight: 0.0, ..quick("ccdiff", 1) };
    let mut run = run_on(vec![common::closing_pair()], 10, &ModelConfig::paper(), training);
    let losses = run.run(8).unwrap();
    assert!(losses[7] < 0.7 * losses[0], "{losses:?}");
    let mut model = loaded(&exported(&run, "paper"));
    let options = SampleOptions { solver_steps: Some(2), guidance_weight: 1.1, ..samples(2).sampling };
    let scene = common::closing_pair();
    let plan = plans(&mut model, &[(&scene, 40, 1)], &options.into(), None).unwrap().remove(0);
    assert_eq!((plan.actions.len(), plan.states.len()), (2 * 3 * STEPS * 2, 2 * 3 * STEPS * 6));
    assert!(plan.states.iter().all(|v| v.is_finite()));
}

#[test]
fn a_resumed_run_continues_bit_for_bit_and_its_weights_plan() {
    for kind in kinds() {
        let [mut whole, mut again] = [kind; 2].map(|kind| {
            let training = TrainConfig { ema_start: 2, perturb: kind == "ccdiff", ..quick(kind, 2) };
            run_on(vec![common::closing_pair()], 20, &config(kind), training)
        });
        whole.run(2).unwrap();
        whole.cool_down(10);
        let state = temporary(&format!("{kind}-state.safetensors"));
        whole.save(&state).unwrap();
        assert_eq!(settings_of(&state).unwrap().0, config(kind));
        again.resume(&state).unwrap();
        assert_eq!((again.step(), again.cooldown()), (2, whole.cooldown()));
        assert_eq!(whole.run(2).unwrap(), again.run(2).unwrap(), "{kind}");
        let files = [(&whole, "whole"), (&again, "again")].map(|(r, n)| exported(r, &format!("{kind}-{n}")));
        assert_eq!(std::fs::read(&files[0]).unwrap(), std::fs::read(&files[1]).unwrap(), "{kind}");
        let mut model = loaded(&files[0]);
        assert_eq!(model.header()["kind"], kind);
        let plan =
            plans(&mut model, &[(&common::closing_pair(), 40, 1)], &samples(2), None).unwrap().remove(0);
        let steps = model.config().horizon_steps;
        assert_eq!((plan.actions.len(), plan.states.len()), (2 * 3 * steps * 2, 2 * 3 * steps * 6));
        let mut other = run_on(vec![common::closing_pair()], 20, &config(kind), quick(kind, 3));
        assert!(matches!(other.resume(&state), Err(ModelError::Checkpoint { .. })));
    }
}

#[test]
fn a_worlds_plans_depend_on_its_own_seed_and_samples_differ_where_they_are_drawn() {
    let scene = common::closing_pair();
    for kind in kinds() {
        let mut model = trained(kind, 4);
        let (a, b) = ((&scene, 40, 7), (&scene, 60, 3));
        let both = plans(&mut model, &[a, b], &samples(5), None).unwrap();
        let turned = plans(&mut model, &[b, a], &samples(5), None).unwrap();
        let alone = plans(&mut model, &[a], &samples(5), None).unwrap();
        for other in [&turned[1], &alone[0]] {
            assert!(close(&both[0].actions, &other.actions, 2e-3), "{kind}");
        }
        assert!(close(&both[1].actions, &turned[0].actions, 2e-3), "{kind}");
        let one = 3 * model.config().horizon_steps * 2;
        let differ = !close(&both[0].actions[..one], &both[0].actions[one..2 * one], 1e-4);
        assert_eq!(differ, kind != "simnet", "{kind}");
        let other_seed = plans(&mut model, &[(&scene, 40, 8)], &samples(5), None).unwrap();
        let differ = !close(&both[0].actions, &other_seed[0].actions, 1e-4);
        assert_eq!(differ, kind != "simnet", "{kind}");
    }
}

#[test]
fn guidance_by_a_weight_moves_the_joined_pair_and_leaves_the_lone_vehicle() {
    let scene = common::closing_pair();
    let mut model = trained("ccdiff", 4);
    let mut drawn = |solver_steps, guidance_weight| {
        let options = SampleOptions { solver_steps, guidance_weight, ..SampleOptions::default() };
        plans(&mut model, &[(&scene, 40, 7)], &options.into(), None).unwrap().remove(0)
    };
    let of = |plan: &Plan, agent: usize| plan.actions[agent * STEPS * 2..(agent + 1) * STEPS * 2].to_vec();
    let (plain, guided) = (drawn(Some(4), 1.0), drawn(Some(4), 1.5));
    assert!(!close(&of(&plain, 0), &of(&guided, 0), 1e-4));
    assert!(close(&of(&plain, 2), &of(&guided, 2), 1e-3));
    assert!(drawn(None, 1.0).states.iter().all(|v| v.is_finite()), "all steps");
}

#[test]
fn a_standing_vehicle_alone_in_the_void_gets_a_finite_plan() {
    let scene = common::scene(&[[0.0, 0.0, 0.0, 0.0, 0.0]], 110);
    for kind in kinds() {
        let options = PlanOptions { guidance: Some(GuidanceConfig::default()), ..samples(2) };
        let mut model = trained(kind, 1);
        // step 0: hardly any history; the map is left out: no lines anywhere
        let window = Window::from_scene(&scene, 0, &[0], model.config().history_steps);
        let guide = Some(WorldGuidance::new(&[true]));
        let view = PlanInput { window: &window, map: None, seed: 0, guide };
        let plan = model.plan(&[view], &options).unwrap().remove(0);
        assert!(plan.states.iter().all(|v| v.is_finite()), "{kind}");
    }
}

#[test]
fn a_future_without_a_log_trains_to_finite_losses() {
    // the second car's log ends early, so some rows have no whole future
    let mut scene = (*common::closing_pair()).clone();
    for step in 30..scene.num_steps {
        let at = scene.at(1, step);
        scene.tracks.valid[at] = false;
    }
    let scene = Arc::new(scene);
    for kind in kinds() {
        let training = TrainConfig { batch_scenes: 3, ..TrainConfig::of(kind, "fast").unwrap() };
        let mut run = run_on(vec![Arc::clone(&scene)], 12, &config(kind), training);
        assert!(run.run(3).unwrap().iter().all(|l| l.is_finite()), "{kind}");
    }
}

#[test]
fn what_means_nothing_to_a_network_is_refused_by_name() {
    assert!(ModelConfig::of("ctg", "paper").unwrap_err().to_string().contains("history"));
    assert!(named("gtc").unwrap_err().to_string().contains("ctgpp"));
    let blind = self::blind(config("bits"));
    let store = nn::VarStore::new(Device::Cpu);
    assert!(build(&store.root(), &blind).unwrap_err().to_string().contains("map"));
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
