//! The space that every planning network plans in: normalised action knots, and what they say of actions and states.

use crate::config::ModelConfig;
use crate::layers::inputs::standardise;
use crate::unicycle::{self, Knots};
use tch::{Device, Kind, Tensor};

/// Maps between normalised knots [R, knots, 2], physical actions [R, T, 2] and states [R, T, 6].
#[derive(Debug)]
pub struct PlanSpace {
    config: ModelConfig,
    knots: Knots,
}

impl PlanSpace {
    /// The space of a configuration, on a device.
    pub fn new(config: &ModelConfig, device: Device) -> Self {
        Self { knots: Knots::new(config, device), config: config.clone() }
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// Normalised knots [R, knots, 2] of these numbers.
    pub fn knots(&self, numbers: &[f32]) -> Tensor {
        self.knots.placed(numbers)
    }

    /// Physical actions [R, T, 2] of normalised knots [R, knots, 2].
    pub fn actions(&self, knots: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        let row = |v: &[f64]| Tensor::from_slice(v).to_kind(Kind::Float).to_device(knots.device());
        self.knots.spread(&(knots * row(&n.action_std) + row(&n.action_mean)))
    }

    /// Normalised actions [R, 2] of physical ones.
    pub fn normalised(&self, actions: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        standardise(actions, &n.action_mean, &n.action_std)
    }

    /// Normalised knots [R, knots, 2] that fit physical actions [R, T, 2] best.
    pub fn knots_of(&self, actions: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        standardise(&self.knots.fit(actions), &n.action_mean, &n.action_std)
    }

    /// States [R, T, 6] of normalised knots, rolled out through the unicycle.
    pub fn states(&self, knots: &Tensor, speed_mps: &Tensor) -> Tensor {
        unicycle::rollout(&self.actions(knots), speed_mps, self.config.dt_s)
    }

    /// Trajectories in the units of the loss and of the networks' inputs.
    pub fn standardised_states(&self, states: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        standardise(states, &n.trajectory_mean, &n.trajectory_std)
    }
}
