//! A network that learns to plan in one step what its teacher plans in several.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::ModelError;
use ccdiff_models::checkpoint;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::vehicles;
use ccdiff_models::features::Window;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_models::trajectory_model::{PlanInput, PlanOptions};
use common::runs::{exported, loaded, quick, run_on, temporary};
use std::path::Path;
use tch::Kind;

fn network() -> ModelConfig {
    ModelConfig { map: None, ..ModelConfig::fast() }
}

fn training(teacher_steps: usize) -> TrainConfig {
    TrainConfig { ema_start: 1000, learning_rate: 3e-4, teacher_steps, ..quick("ccdiff", 4) }
}

fn run(model: &ModelConfig, training: TrainConfig) -> Trainer {
    run_on(vec![common::closing_pair()], 5, model, training)
}

/// Mean distance, metres, of plans made in one step from those that the teacher makes in five of the same seeds.
fn distance_m(student: &Path, teacher: &Path) -> f32 {
    let scene = common::closing_pair();
    let window = Window::from_scene(&scene, 43, &vehicles(&scene), 31);
    let plans = |path: &Path, steps: usize| -> Vec<f32> {
        let options = SampleOptions { solver_steps: Some(steps), ..SampleOptions::default() };
        let mut model = loaded(path);
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
    let mut first = run(&network(), training(0));
    first.run(150).unwrap();
    let teacher = exported(&first, "teacher");
    let mut student = run(&network(), training(5)).taught_by(&teacher).unwrap();
    let before = distance_m(&exported(&student, "untaught"), &teacher);
    student.run(120).unwrap();
    let path = exported(&student, "student");
    let after = distance_m(&path, &teacher);
    assert!(after < 0.6 * before, "{before} m before, {after} m after");
    assert!(loaded(&path).plans_in_one_step());
    assert!(!loaded(&teacher).plans_in_one_step());
    let more = loaded(&path).plan(&[], &PlanOptions::default()).unwrap_err();
    assert!(more.to_string().contains("one step"), "{more}");
}

#[test]
fn a_taught_run_resumes_bit_for_bit() {
    let teacher = exported(&run(&network(), training(0)), "whole-teacher");
    let taught = || run(&network(), training(3)).taught_by(&teacher).unwrap();
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
    let teacher = exported(&run(&network(), training(0)), "other-teacher");
    let wider = ModelConfig { width: 128, ..network() };
    refused(run(&wider, training(5)).taught_by(&teacher), "another network");
    refused(run(&network(), training(0)).taught_by(&teacher), "teacher_steps is 0");
    let simnet = ModelConfig::of("simnet", "fast").unwrap();
    let regressor = exported(&run(&simnet, training(0)), "simnet");
    refused(run(&simnet, training(5)).taught_by(&regressor), "denoises");
    let alone = run(&network(), training(5)).run(1).unwrap_err().to_string();
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
    let mut first = run(&model, training(0));
    first.run(3).unwrap();
    let teacher = exported(&first, "told-teacher");
    for (drop_route, learned) in [(1.0, false), (0.5, true)] {
        let settings = TrainConfig { drop_route, ..training(5) };
        let mut second = run(&model, settings).taught_by(&teacher).unwrap();
        second.run(2).unwrap();
        let student = exported(&second, "told");
        assert_eq!(routes(&student) != routes(&teacher), learned, "{drop_route}");
    }
}
