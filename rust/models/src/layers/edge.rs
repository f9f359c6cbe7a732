//! Encoder of pairwise features (reference.md#pairwise-features): four groups of two, summed.

use crate::config::ModelConfig;
use tch::Tensor;
use tch::nn;

const GROUPS: i64 = 4;

/// Edge features [.., 8] → [.., edge width].
#[derive(Debug)]
pub(crate) struct EdgeEncoder {
    groups: Vec<(nn::Linear, nn::LayerNorm, nn::Linear)>,
    norm: nn::LayerNorm,
    out: nn::Linear,
    out_norm: nn::LayerNorm,
}

impl EdgeEncoder {
    pub(crate) fn new(p: &nn::Path, width: i64) -> Self {
        let norm = |p: nn::Path| nn::layer_norm(p, vec![width], Default::default());
        Self {
            groups: (0..GROUPS)
                .map(|g| {
                    let q = p / "group" / g;
                    (
                        nn::linear(&q / "in", 2, width, Default::default()),
                        norm(&q / "norm"),
                        nn::linear(&q / "out", width, width, Default::default()),
                    )
                })
                .collect(),
            norm: norm(p / "norm"),
            out: nn::linear(p / "out", width, width, Default::default()),
            out_norm: norm(p / "out_norm"),
        }
    }

    pub(crate) fn forward(&self, edges: &Tensor) -> Tensor {
        let parts = self.groups.iter().zip(0..).map(|((first, norm, second), g)| {
            edges.narrow(-1, 2 * g, 2).apply(first).apply(norm).relu().apply(second)
        });
        let sum = parts.reduce(|a, b| a + b).unwrap_or_else(|| edges.zeros_like());
        sum.apply(&self.norm).relu().apply(&self.out).apply(&self.out_norm)
    }
}

/// Edges at every token, normalised, [R, K, T, 8], and their availability [R, K, T].
///
/// History tokens have the edge of their step; future tokens that of now, moved on at constant relative velocity.
pub(crate) fn at_tokens(edges: &Tensor, config: &ModelConfig) -> (Tensor, Tensor) {
    let n = &config.normalisation;
    let (pos, vel) = (&n.edge_position_std, n.edge_velocity_std);
    let history = edges.size()[2];
    let now = edges.narrow(2, history - 1, 1);
    let times: Vec<f32> = config.future_token_times_s().iter().map(|t| *t as f32).collect();
    let tokens = times.len() as i64;
    let times = Tensor::from_slice(&times).view([1, 1, tokens, 1]).to_device(edges.device());
    let moved = now.narrow(3, 0, 2) + now.narrow(3, 4, 2) * times;
    let rest = now.narrow(3, 2, 7).expand([-1, -1, tokens, -1], false);
    let all = Tensor::cat(&[edges.shallow_clone(), Tensor::cat(&[moved, rest], 3)], 2);
    let scale = [pos[0], pos[1], 1.0, 1.0, vel, vel, 1.0, 1.0];
    let scale: Vec<f32> = scale.iter().map(|s| (1.0 / s) as f32).collect();
    let scaled = all.narrow(3, 0, 8) * Tensor::from_slice(&scale).to_device(edges.device());
    (scaled, all.select(3, 8).gt(0.5))
}
