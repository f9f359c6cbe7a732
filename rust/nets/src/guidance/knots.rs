//! Between normalised action knots and physical actions, in plain numbers.

use crate::config::ModelConfig;
use crate::inputs::unicycle::knot_joints;

/// The linear map from normalised knots [knots, 2] to physical actions [T, 2] of one agent, and its adjoint.
#[derive(Debug, Clone, PartialEq)]
pub struct KnotMap {
    /// As [`knot_joints`].
    joints: Vec<(usize, f32)>,
    num_knots: usize,
    mean: [f32; 2],
    std: [f32; 2],
    stride: usize,
}

impl KnotMap {
    /// The map of a network.
    pub fn new(config: &ModelConfig) -> Self {
        let n = &config.normalisation;
        Self {
            joints: knot_joints(config).collect(),
            num_knots: config.num_knots(),
            mean: n.action_mean.map(|v| v as f32),
            std: n.action_std.map(|v| v as f32),
            stride: config.knot_stride,
        }
    }

    /// Numbers per agent: two per knot.
    pub fn width(&self) -> usize {
        2 * self.num_knots
    }

    /// Actions [T, 2] of knots [knots, 2].
    pub fn actions(&self, knots: &[f32], out: &mut [f32]) {
        for (action, (low, share)) in out.chunks_exact_mut(2).zip(&self.joints) {
            for c in 0..2 {
                let next = knots.get(2 * (low + 1) + c).copied().unwrap_or(0.0);
                let joined = (1.0 - share) * knots[2 * low + c] + share * next;
                // the weights of a step add up to 1
                action[c] = joined * self.std[c] + self.mean[c];
            }
        }
    }

    /// Gradient with respect to the knots [knots, 2] of one with respect to the actions [T, 2].
    pub fn vjp(&self, of_actions: &[f32], out: &mut [f32]) {
        out.fill(0.0);
        for (action, (low, share)) in of_actions.chunks_exact(2).zip(&self.joints) {
            for c in 0..2 {
                let of_joined = action[c] * self.std[c];
                out[2 * low + c] += (1.0 - share) * of_joined;
                if let Some(next) = out.get_mut(2 * (low + 1) + c) {
                    *next += share * of_joined;
                }
            }
        }
    }

    /// Knots that the first `executed_steps` actions are nearest to: 1 for those, 0 for later ones, [knots].
    pub fn mask(&self, executed_steps: Option<usize>) -> Vec<f32> {
        let free = executed_steps.map_or(self.num_knots, |steps| steps.div_ceil(self.stride));
        (0..self.num_knots).map(|k| f32::from(u8::from(k < free))).collect()
    }
}
