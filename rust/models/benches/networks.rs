//! Time of plans on own kernels beside those on torch, one thread, in turns: the shipped networks, without guidance.
//!
//! `cargo bench -p ccdiff-models --bench networks` prints microseconds per vehicle and plan, the least of some runs: all
//! that a plan takes (`plan`), and without features (`network`).

#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs, reason = "a benchmark")]

#[path = "../tests/common/mod.rs"]
mod common;

use ccdiff_models::dataset::vehicles;
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::torch_model;
use ccdiff_models::trajectory_model::{PlanInput, PlanOptions, TrajectoryModel};
use std::path::Path;
use std::time::Instant;
use tch::Device;

const TURNS: usize = 5;

/// Two lanes of vehicles 12 m apart, a braking one now and then.
fn window(num_vehicles: usize) -> (Window, std::sync::Arc<ccdiff_sim::scene::Scene>) {
    let rows: Vec<[f32; 5]> = (0..num_vehicles)
        .map(|k| [12.0 * (k / 2) as f32, 3.5 * (k % 2) as f32 - 2.0, 0.0, 6.0 + (k % 3) as f32, 0.0])
        .collect();
    let scene = common::scene(&rows, 110);
    (Window::from_scene(&scene, 40, &vehicles(&scene), 31), scene)
}

/// The least microseconds of a run over half a second.
fn least_us(mut run: impl FnMut()) -> f64 {
    run();
    let (begin, mut least) = (Instant::now(), f64::MAX);
    while begin.elapsed().as_secs_f64() < 0.5 {
        let start = Instant::now();
        run();
        least = least.min(start.elapsed().as_secs_f64() * 1e6);
    }
    least
}

fn main() {
    tch::set_num_threads(1);
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../ccdiff_env/data");
    for (name, solver_steps) in [("ccdiff_one_step", 1), ("ccdiff_fast", 5)] {
        let path = data.join(format!("{name}.safetensors"));
        let mut own = TrajectoryModel::load(&path).unwrap();
        let mut torch = torch_model::load(&path, Device::Cpu).unwrap();
        let options: PlanOptions =
            SampleOptions { solver_steps: Some(solver_steps), ..SampleOptions::default() }.into();
        // one world below the number from which features take more threads
        for (worlds, num_vehicles) in [(1, 1), (1, 4), (3, 10), (3, 46)] {
            let (window, scene) = window(num_vehicles);
            let map = own.map(&scene);
            let view = PlanInput { window: &window, map: map.as_ref(), seed: 3, guide: None };
            let views = vec![view; worlds];
            let built = features::build(&window, map.as_ref(), own.config()).unwrap();
            let scenes: Vec<&SceneFeatures> = vec![&built; worlds];
            let seeds = vec![3; worlds];
            let mut least = [[f64::MAX; 2]; 2];
            for _ in 0..TURNS {
                for (model, least) in [&mut own, &mut torch].into_iter().zip(&mut least) {
                    let plan = least_us(|| drop(model.plan(&views, &options).unwrap()));
                    let draw =
                        least_us(|| drop(model.planner().draw(&scenes, &seeds, &options, None).unwrap()));
                    *least = [least[0].min(plan), least[1].min(draw)];
                }
            }
            let rows = (worlds * num_vehicles) as f64;
            let [[own_plan, own_draw], [torch_plan, torch_draw]] = least.map(|l| l.map(|us| us / rows));
            println!(
                "{name} {solver_steps} steps, {rows:3} vehicles: network own {own_draw:6.0} torch {torch_draw:6.0}, \
                 plan own {own_plan:6.0} torch {torch_plan:6.0}"
            );
        }
    }
}
