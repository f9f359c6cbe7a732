//! The baselines: sizes, learning, files, whose numbers plans depend on, guidance.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::ModelError;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::{Dataset, vehicles};
use ccdiff_models::features::Window;
use ccdiff_models::guidance::{
    AgentCollision, Approach, GuidanceConfig, MapCollision, Objective, WorldGuidance,
};
use ccdiff_models::kinds::build;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch_model;
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_models::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_nets::networks::NETWORKS;
use ccdiff_nets::networks::kinds::named;
use ccdiff_sim::scene::Scene;
use std::path::PathBuf;
use std::sync::Arc;
use tch::{Device, Tensor, nn};

const STEPS: usize = 52;

fn rivals() -> impl Iterator<Item = &'static str> {
    NETWORKS.iter().map(|network| network.kind.name).filter(|kind| *kind != "ccdiff")
}

fn temporary(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ccdiff-baselines-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

fn trainer(kind: &'static str) -> Trainer {
    let config = ModelConfig::of(kind, "fast").unwrap();
    let data = Dataset::new(vec![common::closing_pair()], &config, 20).unwrap();
    let preset = TrainConfig::of(kind, "fast").unwrap();
    let training = TrainConfig { batch_scenes: 2, warmup_steps: 0, perturb: false, ema_start: 2, ..preset };
    common::seeded(|| Trainer::new(config, training, data, Device::Cpu).unwrap())
}

/// A model trained for some steps.
fn trained(kind: &'static str, steps: usize) -> TrajectoryModel {
    let mut run = trainer(kind);
    run.run(steps).unwrap();
    let path = temporary(&format!("{}-{steps}.safetensors", kind));
    run.export(&path, &serde_json::json!({})).unwrap();
    torch_model::load(&path, Device::Cpu).unwrap()
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
    for (kind, want) in [
        ("ccdiff", 351_842),
        ("simnet", 187_002),
        ("trafficsim", 315_514),
        ("strive", 262_330),
        ("bits", 299_204),
        ("ctg", 332_466),
        ("ctgpp", 351_842),
    ] {
        let store = nn::VarStore::new(Device::Cpu);
        common::seeded(|| build(&store.root(), &ModelConfig::of(kind, "fast").unwrap()).unwrap());
        let got: usize = store.trainable_variables().iter().map(Tensor::numel).sum();
        assert_eq!(got, want, "{kind:?}");
    }
}

#[test]
fn every_network_learns_one_batch() {
    for kind in rivals() {
        let mut run = trainer(kind);
        let losses = run.run(70).unwrap();
        let mean = |l: &[f64]| l.iter().sum::<f64>() / l.len() as f64;
        let (first, last) = (mean(&losses[..2]), mean(&losses[60..]));
        // a denoiser starts from a plan that shows the answer where the noise is small
        let share = if named(kind).unwrap().denoises { 0.6 } else { 0.35 };
        assert!(last < share * first, "{kind:?}: {first} {last}");
    }
}

#[test]
fn a_resumed_run_continues_bit_for_bit_and_its_weights_plan() {
    for kind in rivals() {
        let (mut whole, mut again) = (trainer(kind), trainer(kind));
        whole.run(2).unwrap();
        let state = temporary(&format!("{}-state.safetensors", kind));
        whole.save(&state).unwrap();
        again.resume(&state).unwrap();
        assert_eq!(whole.run(2).unwrap(), again.run(2).unwrap(), "{kind:?}");
        let files = ["whole", "again"].map(|n| temporary(&format!("{}-{n}.safetensors", kind)));
        whole.export(&files[0], &serde_json::json!({})).unwrap();
        again.export(&files[1], &serde_json::json!({})).unwrap();
        assert_eq!(std::fs::read(&files[0]).unwrap(), std::fs::read(&files[1]).unwrap(), "{kind:?}");
        let mut model = torch_model::load(&files[0], Device::Cpu).unwrap();
        assert_eq!(model.header()["kind"], kind);
        let plan =
            plans(&mut model, &[(&common::closing_pair(), 40, 1)], &samples(2), None).unwrap().remove(0);
        let steps = model.config().horizon_steps;
        assert_eq!((plan.actions.len(), plan.states.len()), (2 * 3 * steps * 2, 2 * 3 * steps * 6));
    }
}

#[test]
fn a_worlds_plans_depend_on_its_own_seed_and_samples_differ_where_they_are_drawn() {
    let scene = common::closing_pair();
    for kind in rivals() {
        let mut model = trained(kind, 4);
        let (a, b) = ((&scene, 40, 7), (&scene, 60, 3));
        let both = plans(&mut model, &[a, b], &samples(5), None).unwrap();
        let turned = plans(&mut model, &[b, a], &samples(5), None).unwrap();
        let alone = plans(&mut model, &[a], &samples(5), None).unwrap();
        for other in [&turned[1], &alone[0]] {
            assert!(close(&both[0].actions, &other.actions, 2e-3), "{kind:?}");
        }
        assert!(close(&both[1].actions, &turned[0].actions, 2e-3), "{kind:?}");
        let one = 3 * model.config().horizon_steps * 2;
        let differ = !close(&both[0].actions[..one], &both[0].actions[one..2 * one], 1e-4);
        assert_eq!(differ, kind != "simnet", "{kind:?}");
        let other_seed = plans(&mut model, &[(&scene, 40, 8)], &samples(5), None).unwrap();
        let differ = !close(&both[0].actions, &other_seed[0].actions, 1e-4);
        assert_eq!(differ, kind != "simnet", "{kind:?}");
    }
}

/// Seeks contact with a negative weight, avoids it with a positive one.
fn sought(weight: f32) -> GuidanceConfig {
    GuidanceConfig {
        objectives: vec![
            Objective::AgentCollision(AgentCollision { weight, ..AgentCollision::default() }),
            Objective::Approach(Approach { weight: weight / 5.0, ..Approach::default() }),
            Objective::MapCollision(MapCollision::default()),
        ],
        discount: 1.0,
        ..GuidanceConfig::rl()
    }
}

#[test]
fn guidance_closes_in_or_keeps_away_as_the_sign_says_and_moves_nobody_else() {
    let scene = common::following_pair();
    let worlds: Vec<_> = (0..3).map(|seed| (&scene, 40, seed)).collect();
    let guided = [true, false, false];
    // a denoiser trained on one future alone finds back to it whatever guidance did; tokens are drawn, not moved
    let moved = |kind: &&str| named(kind).is_ok_and(|network| !network.denoises && !network.samples_tokens);
    for kind in rivals().filter(moved) {
        let mut model = trained(kind, 40);
        let mut closeness = |weight: f32, steps: usize| -> (f32, Vec<Plan>) {
            let guidance = Some(GuidanceConfig { gradient_steps: steps, ..sought(weight) });
            let options = PlanOptions { guidance, ..samples(1) };
            let found = plans(&mut model, &worlds, &options, Some(&guided)).unwrap();
            (found.iter().map(|p| p.guidance.as_ref().unwrap().losses[3]).sum(), found)
        };
        let ((near, plan), (free, unmoved), (far, _)) =
            (closeness(-50.0, 2), closeness(-50.0, 0), closeness(50.0, 2));
        assert!(near > free && free >= far, "{kind:?}: {near} {free} {far}");
        for (plan, free) in plan.iter().zip(&unmoved) {
            // the third vehicle is out of everybody's reach
            assert_eq!(plan.actions[2 * STEPS * 2..], free.actions[2 * STEPS * 2..], "{kind:?}");
            let report = plan.guidance.as_ref().unwrap();
            assert!(report.realism_cost.iter().all(|c| c.is_nan()), "{kind:?}");
        }
    }
}

#[test]
fn a_standing_vehicle_alone_in_the_void_gets_a_finite_plan() {
    let scene = common::scene(&[[0.0, 0.0, 0.0, 0.0, 0.0]], 110);
    for kind in rivals() {
        let options = PlanOptions { guidance: Some(sought(-50.0)), ..samples(2) };
        let mut model = trained(kind, 1);
        // step 0: hardly any history; the map is left out: no lines anywhere
        let window = Window::from_scene(&scene, 0, &[0], model.config().history_steps);
        let guide = Some(WorldGuidance::new(&[true]));
        let view = PlanInput { window: &window, map: None, seed: 0, guide };
        let plan = model.plan(&[view], &options).unwrap().remove(0);
        assert!(plan.states.iter().all(|v| v.is_finite()), "{kind:?}");
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
    for kind in rivals() {
        let config = ModelConfig::of(kind, "fast").unwrap();
        let data = Dataset::new(vec![Arc::clone(&scene)], &config, 12).unwrap();
        let training = TrainConfig { batch_scenes: 3, ..TrainConfig::of(kind, "fast").unwrap() };
        let mut run = common::seeded(|| Trainer::new(config, training, data, Device::Cpu).unwrap());
        assert!(run.run(3).unwrap().iter().all(|l| l.is_finite()), "{kind:?}");
    }
}

#[test]
fn what_means_nothing_to_a_network_is_refused_by_name() {
    let scene = common::closing_pair();
    let refused = |kind: &'static str, sampling: SampleOptions| {
        let mut model = trained(kind, 1);
        plans(&mut model, &[(&scene, 40, 0)], &sampling.into(), None).unwrap_err().to_string()
    };
    let default = SampleOptions::default();
    let weighted = SampleOptions { guidance_weight: 1.5, ..default };
    let many = SampleOptions { solver_steps: None, ..default };
    assert!(refused("ctg", weighted).contains("guidance_weight"));
    assert!(refused("simnet", many).contains("solver"));
    assert!(ModelConfig::of("ctg", "paper").unwrap_err().to_string().contains("history"));
    assert!(named("gtc").unwrap_err().to_string().contains("ctgpp"));
    let blind = ModelConfig { map: None, ..ModelConfig::of("bits", "fast").unwrap() };
    let store = nn::VarStore::new(Device::Cpu);
    assert!(build(&store.root(), &blind).unwrap_err().to_string().contains("map"));
}
