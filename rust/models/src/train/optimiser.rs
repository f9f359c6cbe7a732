//! Adam with moments that can be saved, and the moving average of the weights.

use crate::checkpoint::variables;
use crate::error::Result;
use crate::plan_model::PlanModel;
use std::collections::BTreeMap;
use tch::{Kind, Tensor, nn};

/// The numbers of a network, one tensor after the other in the order of their names, which share their memory.
#[derive(Debug)]
pub(crate) struct Flat {
    parameters: BTreeMap<String, Tensor>,
    pub(crate) numbers: Tensor,
}

impl Flat {
    /// Moves the tensors of a store into one.
    fn new(store: &nn::VarStore) -> Self {
        let parameters = variables(store);
        tch::no_grad(|| {
            let numbers = Tensor::cat(&parameters.values().map(|p| p.flatten(0, -1)).collect::<Vec<_>>(), 0);
            let mut flat = Self { parameters, numbers };
            let views = flat.views(&flat.numbers).into_values();
            flat.parameters.values_mut().zip(views).for_each(|(parameter, view)| parameter.set_data(&view));
            flat
        })
    }

    /// Where the tensors begin.
    pub(crate) fn places(&self) -> BTreeMap<String, usize> {
        let mut next = 0;
        let mut place = |p: &Tensor| {
            next += p.numel();
            next - p.numel()
        };
        self.parameters.iter().map(|(name, p)| (name.clone(), place(p))).collect()
    }

    /// As many numbers, as tensors of these names.
    pub(crate) fn views(&self, numbers: &Tensor) -> BTreeMap<String, Tensor> {
        let places = self.places();
        let view = |(name, p): (&String, &Tensor)| {
            let part = numbers.narrow(0, places[name] as i64, p.numel() as i64);
            (name.clone(), part.view(p.size().as_slice()))
        };
        self.parameters.iter().map(view).collect()
    }

    /// The gradients that torch has summed up, which are cleared.
    pub(crate) fn gradient(&self) -> Tensor {
        let grads: Vec<Tensor> = self
            .parameters
            .values()
            .map(|p| Some(p.grad()).filter(Tensor::defined).unwrap_or_else(|| p.zeros_like()).flatten(0, -1))
            .collect();
        let all = Tensor::cat(&grads, 0);
        self.parameters.values().for_each(|p| p.shallow_clone().zero_grad());
        all
    }
}

/// Adam (Kingma and Ba) without weight decay.
#[derive(Debug)]
pub(crate) struct Adam {
    pub(crate) parameters: Flat,
    /// First moments.
    pub(crate) first: Tensor,
    /// Second moments.
    pub(crate) second: Tensor,
}

const BETA: (f64, f64) = (0.9, 0.999);

impl Adam {
    pub(crate) fn new(store: &nn::VarStore) -> Self {
        let parameters = Flat::new(store);
        let zeros = || parameters.numbers.zeros_like();
        Self { first: zeros(), second: zeros(), parameters }
    }

    /// Clips a gradient to a norm and takes step number `step` (from 1).
    pub(crate) fn step(&mut self, gradient: &Tensor, step: u64, learning_rate: f64, clip_norm: f64) {
        let norm = gradient.square().sum(Kind::Float).double_value(&[]).sqrt();
        let gradient = gradient * (clip_norm / norm.max(1e-12)).min(1.0);
        let (c1, c2) = (1.0 - BETA.0.powf(step as f64), 1.0 - BETA.1.powf(step as f64));
        let _ = self.first.lerp_(&gradient, 1.0 - BETA.0);
        let _ = self.second.lerp_(&gradient.square(), 1.0 - BETA.1);
        let mut spread = &self.second * (1.0 / c2);
        let _ = spread.sqrt_().g_add_scalar_(1e-8);
        let change = (&self.first / spread).g_mul_scalar_(learning_rate / c1);
        let _ = self.parameters.numbers.g_sub_(&change);
    }
}

/// A second network whose weights follow those of the first.
#[derive(Debug)]
pub(crate) struct MovingAverage {
    pub(crate) store: nn::VarStore,
    pub(crate) model: Box<dyn PlanModel>,
    /// Its numbers, and those that they follow.
    pair: [Tensor; 2],
}

impl MovingAverage {
    /// The average of the network that `build` makes, in a store of its own.
    pub(crate) fn new(
        trained: &Flat,
        build: impl FnOnce(&nn::Path) -> Result<Box<dyn PlanModel>>,
    ) -> Result<Self> {
        let mut store = nn::VarStore::new(trained.numbers.device());
        let model = build(&store.root())?;
        store.freeze();
        let pair = [Flat::new(&store).numbers, trained.numbers.shallow_clone()];
        let mut average = Self { store, model, pair };
        average.follow(0.0);
        Ok(average)
    }

    /// average ← decay · average + (1 - decay) · source.
    pub(crate) fn follow(&mut self, decay: f64) {
        let [average, source] = &mut self.pair;
        let _ = average.lerp_(source, 1.0 - decay);
    }
}
