//! Networks of every form have the same plans on own kernels and on torch, but for rounding.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::{MapConfig, ModelConfig};
use ccdiff_models::dataset::vehicles;
use ccdiff_models::features::Window;
use ccdiff_models::sampler::SampleOptions;
use ccdiff_models::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_nets::compute::weights;
use ccdiff_sim::geom::Point2;
use ccdiff_sim::scene::{Map, Scene};
use common::runs::{exported, loaded, quick, run_on};
use std::sync::Arc;

/// What rounding may do to places (m) and shares of attention.
const ROUNDING: f32 = 2e-4;

/// Two lanes with lines on the map, and a vehicle far off.
fn town() -> Scene {
    let row = |k: usize| [11.0 * (k / 2) as f32, 3.5 * (k % 2) as f32 - 2.0, 0.05, 7.0 - 0.5 * k as f32, 0.2];
    let mut rows: Vec<[f32; 5]> = (0..7).map(row).collect();
    rows.push([250.0, 0.0, 3.1, 6.0, 0.0]);
    let scene = common::scene(&rows, 110);
    let mut map = Map::clone(&scene.map);
    map.lane_dividers.push(vec![Point2::new(-90.0, 0.0), Point2::new(290.0, 0.0)]);
    map.road_dividers.push(vec![Point2::new(-90.0, 4.0), Point2::new(100.0, 9.0)]);
    Scene { map: Arc::new(map), ..Scene::clone(&scene) }
}

fn plan(model: &mut TrajectoryModel, scene: &Scene, sampling: SampleOptions) -> Plan {
    let mut window = Window::from_scene(scene, 40, &vehicles(scene), model.config().history_steps);
    if !model.config().route_points_m.is_empty() {
        let places = model.config().route_points_m.len();
        let place = |k: usize, at: usize| Point2::new(20.0 * (at + 1) as f32, 3.0 - (at * k) as f32);
        let told = |k: usize| (0..places).map(|at| place(k, at)).collect();
        // one is not told
        window.routes = (0..8).map(|k| if k == 3 { Vec::new() } else { told(k) }).collect();
    }
    let map = model.map(scene);
    let view = PlanInput { window: &window, map: map.as_ref(), seed: 5, guide: None };
    let options = PlanOptions { attention: true, ..sampling.into() };
    model.plan(&[view], &options).unwrap().remove(0)
}

#[test]
fn every_form_has_the_same_plans_on_both() {
    let fast = ModelConfig::fast;
    let wide = MapConfig { feature_width: 128, rounds: vec![1] };
    let forms = [
        ("fast", fast()),
        ("blind", ModelConfig { map: None, ..fast() }),
        ("wide", ModelConfig { map: Some(wide), ..fast() }),
        ("routes", ModelConfig { route_points_m: vec![5.0, 10.0], ..fast() }),
        ("odd", ModelConfig { width: 50, heads: 5, edge_width: 21, feed_forward: 33, ..fast() }),
        ("deep", ModelConfig { temporal_layers: 2, edge_layers: 3, knot_stride: 2, ..fast() }),
        ("ctgpp", ModelConfig::of("ctgpp", "fast").unwrap()),
    ];
    let of = |name| (name, ModelConfig::of(name, "fast").unwrap());
    let others = ["simnet", "trafficsim", "strive", "bits", "ctg", "tokens"].map(of);
    let scene = town();
    for (name, model) in forms.into_iter().chain(others) {
        let mut run = run_on(vec![common::closing_pair()], 10, &model, quick(model.kind.as_str(), 2));
        // routes begin silent
        run.run(2).unwrap();
        let path = exported(&run, name);
        let mut own = TrajectoryModel::new(&path, weights::read(&path).unwrap()).unwrap();
        let mut torch = loaded(&path);
        let network = model.network().unwrap();
        let guidance_weight = if network.causal { 1.4 } else { 1.0 };
        let first = if network.denoises { Some(1) } else { Some(5) };
        let later = if network.denoises { Some(4) } else { Some(5) };
        for (solver_steps, num_samples) in [(first, 1), (later, 3)] {
            let sampling =
                SampleOptions { solver_steps, num_samples, guidance_weight, ..SampleOptions::default() };
            let (a, b) = (plan(&mut own, &scene, sampling), plan(&mut torch, &scene, sampling));
            let attention = |plan: &Plan| plan.attention_matrix().unwrap_or_default();
            assert_eq!(attention(&a).is_empty(), !network.attends);
            for (a, b) in [(&a.states, &b.states), (&attention(&a), &attention(&b))] {
                assert_eq!(a.len(), b.len());
                let far = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(far < ROUNDING, "{name}: {far}");
            }
            assert!(a.features.is_edge.iter().filter(|e| **e).count() > 7, "{name}: nobody sees anybody");
        }
    }
}
