//! Plans of shipped networks have one set of bits: whatever the instructions, the batch, the threads.

#![allow(clippy::unwrap_used, reason = "tests")]

use ccdiff_nets::inputs::features::{Window, vehicles};
use ccdiff_nets::kernels::{Level, with_level};
use ccdiff_nets::networks::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_nets::sampling::sampler::SampleOptions;
use ccdiff_sim::geom::{Point2, Polygon, Vector2};
use ccdiff_sim::scene::{Agent, AgentKind, Map, Scene, Tracks};
use std::path::Path;
use std::sync::Arc;

/// Vehicles one behind the other in two lanes that bend, each a little faster than the next.
fn scene(num_vehicles: usize) -> Scene {
    let (num_steps, mut tracks) = (60, Tracks::default());
    for k in 0..num_vehicles {
        for step in 0..num_steps {
            let along = 9.0 * (k / 2) as f32 + (8.0 - 0.4 * k as f32) * 0.1 * step as f32;
            let heading = 0.004 * along;
            tracks.position.push(Point2::new(along, 3.5 * (k % 2) as f32 + 0.002 * along * along));
            tracks.heading_rad.push(heading);
            tracks.velocity.push(Vector2::new(8.0 * heading.cos(), 8.0 * heading.sin()));
            tracks.valid.push(true);
        }
    }
    let agent = |k: usize| Agent {
        id: if k == 0 { "ego".into() } else { format!("car-{k}") },
        kind: AgentKind::Vehicle,
        category: "vehicle.car".into(),
        length_m: 4.5,
        width_m: 2.0,
        height_m: 1.5,
    };
    let corner = |x, y| Point2::new(x, y);
    let exterior = vec![corner(-50.0, -4.0), corner(200.0, -4.0), corner(200.0, 90.0), corner(-50.0, 8.0)];
    let drivable_area = vec![Polygon { exterior, holes: Vec::new() }];
    let scene = Scene {
        name: "bend".into(),
        token: "bend".into(),
        location: "nowhere".into(),
        source: "test".into(),
        origin: [0.0; 2],
        dt_s: 0.1,
        num_steps,
        agents: (0..num_vehicles).map(agent).collect(),
        tracks,
        map: Arc::new(Map { drivable_area, ..Map::default() }),
    };
    scene.validated().unwrap()
}

/// Bits of the states of worlds of so many vehicles each, and of the attention in them.
fn bits(name: &str, sizes: &[usize]) -> Vec<Vec<u32>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = root.join("ccdiff_env/data").join(format!("{name}.safetensors"));
    let mut model = TrajectoryModel::load(&file).unwrap();
    let scenes: Vec<Scene> = sizes.iter().map(|size| scene(*size)).collect();
    let windows: Vec<Window> = scenes.iter().map(|s| Window::from_scene(s, 40, &vehicles(s), 31)).collect();
    let maps: Vec<_> = scenes.iter().map(|s| model.map(s)).collect();
    let worlds: Vec<PlanInput<'_>> = windows
        .iter()
        .zip(&maps)
        .map(|(window, map)| PlanInput { window, map: map.as_ref(), seed: 7, guide: None })
        .collect();
    let denoises = model.network().denoises;
    let solver_steps = Some(if model.plans_in_one_step() { 1 } else { 3 }).filter(|_| denoises);
    let solver_steps = solver_steps.or(SampleOptions::default().solver_steps);
    let sampling =
        SampleOptions { solver_steps, num_samples: 2, guidance_weight: 1.0, ..SampleOptions::default() };
    let options = PlanOptions { attention: true, ..sampling.into() };
    let of_plan = |p: &Plan| {
        let attention = p.attention_matrix().unwrap_or_default();
        p.states.iter().chain(&attention).map(|v| v.to_bits()).collect()
    };
    model.plan(&worlds, &options).unwrap().iter().map(of_plan).collect()
}

#[test]
fn every_level_gives_the_same_plans() {
    for name in ["ccdiff_one_step", "ccdiff_fast", "ccdiff_routes"] {
        let widest = bits(name, &[7]);
        assert!(widest[0].iter().any(|b| f32::from_bits(*b) > 5.0), "nobody moves");
        for level in Level::available() {
            assert_eq!(with_level(level, || bits(name, &[7])), widest, "{name} {level:?}");
        }
    }
}
