//! Time of guidance beside that of the network: 32 worlds of 10 vehicles, 52 steps, `fast` preset.
//!
//! `cargo bench -p ccdiff-models --bench guidance` prints milliseconds, the least of some runs.

#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs, reason = "a benchmark")]

use ccdiff_models::batch::Batch;
use ccdiff_models::config::ModelConfig;
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::guidance::{
    Guidance, GuidanceConfig, GuidanceContext, GuidanceStep, KnotMap, Objective, WorldGuidance,
};
use ccdiff_models::noise::Noise;
use ccdiff_models::torch::Torch;
use ccdiff_nets::networks::ccdiff::Network;
use ccdiff_nets::networks::planner::{Denoises, Weighted};
use ccdiff_sim::geom::{Point2, Polygon, Region};
use std::time::Instant;
use tch::{Device, Kind, Tensor, nn};

const WORLDS: usize = 32;
const VEHICLES: usize = 10;

/// Two lanes with five vehicles each way, the outer ones close to the edge of the road.
fn window(model: &ModelConfig) -> Window {
    let mut window = Window { num_steps: model.history_steps, ..Window::default() };
    for k in 0..VEHICLES {
        let (way, place) = (if k % 2 == 0 { 1.0 } else { -1.0 }, (k / 2) as f32);
        let speed = 5.0 + place;
        for step in 0..model.history_steps {
            let back_s = 0.1 * (model.history_steps - 1 - step) as f32;
            window.x_m.push(way * (15.0 * place - speed * back_s));
            window.y_m.push(-2.2 * way - 0.1 * place);
            window.heading_rad.push(if way > 0.0 { 0.0 } else { std::f32::consts::PI });
            window.speed_mps.push(speed);
            window.valid.push(true);
        }
        window.length_m.push(4.5);
        window.width_m.push(2.0);
    }
    window
}

fn least_ms(mut run: impl FnMut()) -> f64 {
    let time = |_| {
        let begin = Instant::now();
        run();
        begin.elapsed().as_secs_f64() * 1e3
    };
    (0..12).map(time).fold(f64::MAX, f64::min)
}

fn main() {
    let model = ModelConfig { map: None, ..ModelConfig::fast() };
    let window = window(&model);
    let features: Vec<SceneFeatures> =
        (0..WORLDS).map(|_| features::build(&window, None, &model).unwrap()).collect();
    let corner = |x, y| Point2::new(x, y);
    let exterior = vec![corner(-99.0, -3.7), corner(99.0, -3.7), corner(99.0, 3.7), corner(-99.0, 3.7)];
    let road = Region::new(&[Polygon { exterior, holes: Vec::new() }]).unwrap();
    let store = nn::VarStore::new(Device::Cpu);
    let network = Network::<Torch>::new(&store.root(), &model);
    let scenes: Vec<&SceneFeatures> = features.iter().collect();
    let batch = Batch::new(&scenes, &model, Device::Cpu).unwrap();
    let rows = batch.num_rows();
    let knots = Noise::new(1, 1).normals(rows as usize * KnotMap::new(&model).width());
    let noisy = Tensor::from_slice(&knots).view([rows, model.num_knots() as i64, 2]);
    let steps = Tensor::full([rows], 50, (Kind::Int64, Device::Cpu));
    let context = tch::no_grad(|| network.encode(&batch));
    let pass = least_ms(|| drop(tch::no_grad(|| network.predict(&context, &noisy, &steps))));
    println!("{WORLDS} worlds x {VEHICLES} vehicles, {} torch threads", tch::get_num_threads());
    println!("network pass, no map: {pass:.2} ms");
    for guided in [3, VEHICLES] {
        let who: Vec<bool> = (0..VEHICLES).map(|k| k < guided).collect();
        let rl = GuidanceConfig::rl();
        let mut sets: Vec<Vec<Objective>> = rl.objectives.iter().map(|o| vec![*o]).collect();
        sets.push(rl.objectives.clone());
        sets.push(Vec::new());
        for objectives in sets {
            let name = objectives.iter().map(Objective::name).collect::<Vec<_>>().join(" + ");
            let config = GuidanceConfig { objectives, gradient_steps: 10, ..rl.clone() };
            let guide = WorldGuidance { road: Some(&road), ..WorldGuidance::new(&who) };
            let worlds: Vec<_> = features
                .iter()
                .map(|f| {
                    Some(
                        GuidanceContext::new(&guide, &window, f, &model, config.discount, config.seen_steps)
                            .unwrap(),
                    )
                })
                .collect();
            let mut guide = Guidance::new(&config, &model, worlds, &[VEHICLES; WORLDS], 1, false).unwrap();
            let ms = least_ms(|| {
                let mut moved: Vec<f32> = knots.iter().map(|k| 0.2 * k).collect();
                guide.adjust(&mut moved, GuidanceStep { sigma: 0.5, gain: 1.0, score: None }).unwrap();
            });
            println!("{guided} guided, gradient evaluation, {name:45}: {:.3} ms", ms / 10.0);
        }
    }
}
