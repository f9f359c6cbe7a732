//! The tape's losses and gradients beside torch's.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::Dataset;
use ccdiff_models::kinds::build;
use ccdiff_models::noise::Noise;
use ccdiff_models::plan_model::TrainingStep;
use ccdiff_models::tape::{Parameters, Tape};
use ccdiff_models::train::TrainConfig;
use std::collections::BTreeMap;
use tch::{Device, Tensor, nn};

#[test]
fn losses_and_gradients_are_those_of_torch() {
    for (kind, mapped, routed) in [
        ("ccdiff", true, true),
        ("ccdiff", false, false),
        ("ctgpp", true, false),
        ("simnet", true, false),
        ("bits", true, false),
        ("tokens", true, true),
    ] {
        let fast = ModelConfig::of(kind, "fast").unwrap();
        let config = ModelConfig { map: fast.map.clone().filter(|_| mapped), ..fast };
        let route_points_m = if routed { vec![5.0, 20.0] } else { vec![] };
        let config = ModelConfig { route_points_m, ..config };
        assert!(Tape::fits(&config));
        let data = Dataset::new(vec![common::closing_pair()], &config, 1).unwrap();
        let (batch, targets) = data.batch(&[0, 3, 11], Some(Noise::new(5, 5)), Device::Cpu).unwrap();

        let store = nn::VarStore::new(Device::Cpu);
        let network = common::seeded(|| build(&store.root(), &config)).unwrap();
        let variables: BTreeMap<String, Tensor> = store.variables().into_iter().collect();
        let (mut numbers, mut places) = (Vec::new(), BTreeMap::new());
        for (name, variable) in &variables {
            places.insert(name.clone(), numbers.len());
            // no weight is zero, so that all have gradients
            let moved = Noise::new(places.len() as u64, 1).normals(variable.numel());
            let moved = Tensor::from_slice(&moved).view_as(variable) * 0.05;
            let _ = tch::no_grad(|| variable.shallow_clone().g_add_(&moved));
            numbers.extend(Vec::<f32>::try_from(variable.flatten(0, -1)).unwrap());
        }
        let training = TrainConfig::of(kind, "fast").unwrap();
        let step =
            TrainingStep { batch: &batch, targets: &targets, config: &training, step: 7, taught: None };
        let loss = network.loss(&step);
        loss.backward();
        let parameters = Parameters::new(numbers, places.clone());
        let learnt = network.learn(&step, &parameters).unwrap();
        assert!(
            (learnt - loss.double_value(&[])).abs() < 1e-5 * learnt.abs(),
            "{kind}: {learnt} and {loss:?}"
        );
        let (found, size) =
            (parameters.gradient(), |v: &[f32]| v.iter().map(|x| f64::from(x * x)).sum::<f64>().sqrt());
        let all = size(&found);
        for (name, variable) in &variables {
            let want = Vec::<f32>::try_from(variable.grad().flatten(0, -1)).unwrap();
            let got = &found[places[name]..][..want.len()];
            let apart: Vec<f32> = got.iter().zip(&want).map(|(a, b)| a - b).collect();
            // biases of keys have none but for rounding
            let (apart, want) = (size(&apart), size(&want));
            assert!(apart < 2e-4 * want + 1e-5 * all, "{kind} {name}: {apart} of {want} of {all}");
        }
    }
}
