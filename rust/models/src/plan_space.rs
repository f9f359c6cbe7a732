//! The space that every planning network plans in, as tensors: normalised action knots, and what they say of actions and states.

use crate::config::ModelConfig;
use crate::unicycle;
use ccdiff_nets::inputs::unicycle::knot_joints;
use tch::{Device, Kind, Tensor};

/// Maps between normalised knots [R, knots, 2], physical actions [R, T, 2] and states [R, T, 6].
#[derive(Debug)]
pub struct PlanSpace {
    config: ModelConfig,
    /// From knots to actions, and to the knots that fit actions best in the least-squares sense.
    spread: Tensor,
    fit: Tensor,
}

impl PlanSpace {
    /// The space of a configuration, on a device.
    pub fn new(config: &ModelConfig, device: Device) -> Self {
        let size = [config.horizon_steps as i64, config.num_knots() as i64];
        let mut weights = vec![0f32; config.horizon_steps * config.num_knots()];
        for (row, (low, share)) in weights.chunks_exact_mut(config.num_knots()).zip(knot_joints(config)) {
            row[low] = 1.0 - share;
            row.iter_mut().skip(low + 1).take(1).for_each(|next| *next = share);
        }
        let spread = Tensor::from_slice(&weights).view(size);
        let fit = spread.to_kind(Kind::Double).linalg_pinv(1e-12, false).to_kind(Kind::Float);
        Self { config: config.clone(), spread: spread.to_device(device), fit: fit.to_device(device) }
    }

    /// The configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// Normalised knots [R, knots, 2] of these numbers.
    pub fn knots(&self, numbers: &[f32]) -> Tensor {
        Tensor::from_slice(numbers).view([-1, self.spread.size()[1], 2]).to_device(self.spread.device())
    }

    /// Physical actions [R, T, 2] of normalised knots [R, knots, 2].
    pub fn actions(&self, knots: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        self.spread.matmul(&(knots * row(&n.action_std, knots) + row(&n.action_mean, knots)))
    }

    /// Normalised knots [R, knots, 2] that fit physical actions [R, T, 2] best.
    pub fn knots_of(&self, actions: &Tensor) -> Tensor {
        let n = &self.config.normalisation;
        standardise(&self.fit.matmul(actions), &n.action_mean, &n.action_std)
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

fn row(numbers: &[f64], beside: &Tensor) -> Tensor {
    Tensor::from_slice(numbers).to_kind(Kind::Float).to_device(beside.device())
}

/// (x - mean) / std over the last dimension.
fn standardise(x: &Tensor, mean: &[f64], std: &[f64]) -> Tensor {
    (x - row(mean, x)) / row(std, x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knots_reproduce_what_is_linear_between_them_and_are_the_identity_at_stride_one() {
        let fast = ModelConfig::fast();
        let space = PlanSpace::new(&fast, Device::Cpu);
        let z = Tensor::from_slice(&crate::noise::Noise::new(1, 1).normals(26)).view([1, 13, 2]);
        assert!(space.knots_of(&space.actions(&z)).allclose(&z, 1e-4, 1e-4, false));
        assert!(knot_joints(&ModelConfig::paper()).eq((0..52).map(|step| (step, 0.0))));
    }
}
