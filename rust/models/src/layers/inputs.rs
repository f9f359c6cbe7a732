//! What batches hold, as layers take it.

use crate::config::ModelConfig;
use tch::{Kind, Tensor};

/// Histories [R, H, 8] with standardised places, speeds and sizes, zero where not available.
pub(crate) fn standardised_history(raw: &Tensor, config: &ModelConfig) -> Tensor {
    let n = &config.normalisation;
    let available = raw.narrow(2, 7, 1);
    let place = standardise(&raw.narrow(2, 0, 2), &n.history_mean[..2], &n.history_std[..2]);
    let body = standardise(&raw.narrow(2, 4, 3), &n.history_mean[2..], &n.history_std[2..]);
    Tensor::cat(&[&place, &raw.narrow(2, 2, 2), &body, &available], 2) * &available
}

/// (x - mean) / std over the last dimension.
pub(crate) fn standardise(x: &Tensor, mean: &[f64], std: &[f64]) -> Tensor {
    let row = |v: &[f64]| Tensor::from_slice(v).to_kind(Kind::Float).to_device(x.device());
    (x - row(mean)) / row(std)
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
