//! A network that learns to plan in one step what its teacher plans in several.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::ModelError;
use ccdiff_models::checkpoint;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::{Dataset, vehicles};
use ccdiff_models::features::Window;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch_model;
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_models::trajectory_model::{PlanInput, PlanOptions};
use std::path::{Path, PathBuf};
use tch::{Device, Kind};

fn temporary(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ccdiff-distil-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

fn network() -> ModelConfig {
    ModelConfig { map: None, ..ModelConfig::fast() }
}

fn training(teacher_steps: usize) -> TrainConfig {
    let preset = TrainConfig::of("ccdiff", "fast").unwrap();
    TrainConfig {
        batch_scenes: 4,
        warmup_steps: 0,
        ema_start: 1000,
        learning_rate: 3e-4,
        perturb: false,
        teacher_steps,
        ..preset
    }
}

fn run(model: ModelConfig, training: TrainConfig) -> Trainer {
    let data = Dataset::new(vec![common::closing_pair()], &model, 5).unwrap();
    common::seeded(|| Trainer::new(model, training, data, Device::Cpu).unwrap())
}

/// Mean distance, metres, of plans made in one step from those that the teacher makes in five of the same seeds.
fn distance_m(student: &Path, teacher: &Path) -> f32 {
    let scene = common::closing_pair();
    let window = Window::from_scene(&scene, 43, &vehicles(&scene), 31);
    let plans = |path: &Path, steps: usize| -> Vec<f32> {
        let options = SampleOptions { solver_steps: Some(steps), ..SampleOptions::default() };
        let mut model = torch_model::load(path, Device::Cpu).unwrap();
        let of_seed = |seed| {
            let view = PlanInput { window: &window, map: None, seed, guide: None };
            model.plan(&[view], &options.into()).unwrap().remove(0).states
        };
        (0..8).flat_map(of_seed).collect()
    };
    let (one, many) = (plans(student, 1), plans(teacher, 5));
    let apart = one.chunks_exact(6).zip(many.chunks_exact(6)).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    apart.sum::<f32>() / (one.len() / 6) as f32
}

#[test]
fn one_step_of_the_student_comes_near_to_five_of_its_teacher() {
    let teacher = temporary("teacher.safetensors");
    let mut first = run(network(), training(0));
    first.run(150).unwrap();
    first.export(&teacher, &serde_json::json!({})).unwrap();

    let mut student = run(network(), training(5)).taught_by(&teacher).unwrap();
    let path = temporary("student.safetensors");
    student.export(&path, &serde_json::json!({})).unwrap();
    let before = distance_m(&path, &teacher);
    student.run(120).unwrap();
    student.export(&path, &serde_json::json!({})).unwrap();
    let after = distance_m(&path, &teacher);
    assert!(after < 0.6 * before, "{before} m before, {after} m after");
    assert!(torch_model::load(&path, Device::Cpu).unwrap().plans_in_one_step());
    assert!(!torch_model::load(&teacher, Device::Cpu).unwrap().plans_in_one_step());
    let more = torch_model::load(&path, Device::Cpu).unwrap().plan(&[], &PlanOptions::default()).unwrap_err();
    assert!(more.to_string().contains("one step"), "{more}");
}

#[test]
fn a_taught_run_resumes_bit_for_bit() {
    let teacher = temporary("whole-teacher.safetensors");
    run(network(), training(0)).export(&teacher, &serde_json::json!({})).unwrap();
    let taught = || run(network(), training(3)).taught_by(&teacher).unwrap();
    let mut whole = taught();
    whole.run(2).unwrap();
    let state = temporary("taught.safetensors");
    whole.save(&state).unwrap();
    let mut again = taught();
    again.resume(&state).unwrap();
    assert_eq!(again.run(2).unwrap(), whole.run(2).unwrap());
}

#[test]
fn teachers_that_do_not_fit_are_refused() {
    let refused = |found: Result<Trainer, ModelError>, words: &str| {
        let text = found.unwrap_err().to_string();
        assert!(text.contains("teacher") && text.contains(words), "{text}");
    };
    let teacher = temporary("other-teacher.safetensors");
    run(network(), training(0)).export(&teacher, &serde_json::json!({})).unwrap();
    let wider = ModelConfig { width: 128, ..network() };
    refused(run(wider, training(5)).taught_by(&teacher), "another network");
    refused(run(network(), training(0)).taught_by(&teacher), "teacher_steps is 0");
    let simnet = ModelConfig::of("simnet", "fast").unwrap();
    let regressor = temporary("simnet.safetensors");
    run(simnet.clone(), training(0)).export(&regressor, &serde_json::json!({})).unwrap();
    refused(run(simnet, training(5)).taught_by(&regressor), "denoises");
    let alone = run(network(), training(5)).run(1).unwrap_err().to_string();
    assert!(alone.contains("without a teacher"), "{alone}");
}

#[test]
fn a_student_is_told_as_many_routes_as_its_settings_say() {
    let model = ModelConfig { route_points_m: vec![5.0, 10.0], ..network() };
    let routes = |path: &Path| -> Vec<f64> {
        let (_, tensors) = checkpoint::read(path).unwrap();
        let own = tensors.iter().filter(|(name, _)| name.starts_with("route."));
        own.map(|(_, numbers)| numbers.abs().sum(Kind::Double).double_value(&[])).collect()
    };
    let (teacher, student) = (temporary("told-teacher.safetensors"), temporary("told.safetensors"));
    let mut first = run(model.clone(), training(0));
    first.run(3).unwrap();
    first.export(&teacher, &serde_json::json!({})).unwrap();
    for (drop_route, learned) in [(1.0, false), (0.5, true)] {
        let settings = TrainConfig { drop_route, ..training(5) };
        let mut second = run(model.clone(), settings).taught_by(&teacher).unwrap();
        second.run(2).unwrap();
        second.export(&student, &serde_json::json!({})).unwrap();
        assert_eq!(routes(&student) != routes(&teacher), learned, "{drop_route}");
    }
}
