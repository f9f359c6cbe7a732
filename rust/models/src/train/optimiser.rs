//! Adam with moments that can be saved, and the moving average of the weights.

use crate::checkpoint::variables;
use crate::error::Result;
use crate::plan_model::PlanModel;
use std::collections::BTreeMap;
use tch::{Kind, Tensor, nn};

/// Adam (Kingma and Ba) without weight decay.
#[derive(Debug)]
pub(crate) struct Adam {
    parameters: BTreeMap<String, Tensor>,
    /// First moments.
    pub(crate) first: BTreeMap<String, Tensor>,
    /// Second moments.
    pub(crate) second: BTreeMap<String, Tensor>,
}

const BETA: (f64, f64) = (0.9, 0.999);

impl Adam {
    pub(crate) fn new(store: &nn::VarStore) -> Self {
        let parameters: BTreeMap<String, Tensor> =
            variables(store).into_iter().filter(|(_, t)| t.requires_grad()).collect();
        let zeros = || parameters.iter().map(|(n, t)| (n.clone(), t.zeros_like().detach())).collect();
        Self { first: zeros(), second: zeros(), parameters }
    }

    /// Clips the gradients to a global norm, takes step number `step` (from 1) and clears them; returns the norm.
    pub(crate) fn step(&mut self, step: u64, learning_rate: f64, clip_norm: f64) -> f64 {
        let grads: BTreeMap<&String, Tensor> =
            self.parameters.iter().map(|(n, p)| (n, p.grad())).filter(|(_, g)| g.defined()).collect();
        let squares: Vec<Tensor> = grads.values().map(|g| g.square().sum(Kind::Float)).collect();
        let norm = if squares.is_empty() {
            0.0
        } else {
            Tensor::stack(&squares, 0).sum(Kind::Float).double_value(&[]).sqrt()
        };
        let scale = (clip_norm / norm.max(1e-12)).min(1.0);
        let t = step as f64;
        let (c1, c2) = (1.0 - BETA.0.powf(t), 1.0 - BETA.1.powf(t));
        for (name, grad) in &grads {
            let (Some(m), Some(v)) = (self.first.get_mut(*name), self.second.get_mut(*name)) else {
                continue;
            };
            let grad = grad * scale;
            let _ = m.lerp_(&grad, 1.0 - BETA.0);
            let _ = v.lerp_(&grad.square(), 1.0 - BETA.1);
            let change = &*m / ((&*v * (1.0 / c2)).sqrt() + 1e-8) * (learning_rate / c1);
            let mut parameter = self.parameters[*name].shallow_clone();
            let _ = parameter.g_sub_(&change);
        }
        for parameter in self.parameters.values_mut() {
            parameter.zero_grad();
        }
        norm
    }
}

/// A second network whose weights follow those of the first.
#[derive(Debug)]
pub(crate) struct MovingAverage {
    pub(crate) store: nn::VarStore,
    pub(crate) model: Box<dyn PlanModel>,
    pairs: Vec<(Tensor, Tensor)>,
}

impl MovingAverage {
    /// The average of the network that `build` makes, in a store of its own.
    pub(crate) fn new(
        source: &nn::VarStore,
        build: impl FnOnce(&nn::Path) -> Result<Box<dyn PlanModel>>,
    ) -> Result<Self> {
        let mut store = nn::VarStore::new(source.device());
        let model = build(&store.root())?;
        store.freeze();
        let pairs: Vec<(Tensor, Tensor)> =
            variables(&store).into_values().zip(variables(source).into_values()).collect();
        let mut average = Self { store, model, pairs };
        average.follow(0.0);
        Ok(average)
    }

    /// average ← decay · average + (1 - decay) · source.
    pub(crate) fn follow(&mut self, decay: f64) {
        for (average, source) in &mut self.pairs {
            let _ = average.lerp_(&source.detach(), 1.0 - decay);
        }
    }
}
