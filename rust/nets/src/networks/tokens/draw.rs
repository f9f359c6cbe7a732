//! Tokens drawn from logits, and the actions that they stand for.

use super::grid::{BINS, NUM_TOKENS, SPEED, TOKEN_STEPS, YAW_RATE};
use crate::config::ModelConfig;
use crate::guidance::Guide;
use crate::inputs::features::row_offsets;
use crate::networks::planner::Asked;
use crate::sampling::noise::Noise;

/// Slower than this a vehicle stands, m/s: none reverses.
const STANDING_MPS: f32 = 0.08;
/// Greatest curvature of a token, 1/m, and the bound of the yaw rate of slow vehicles, rad/s.
const CURVATURE_1PM: f32 = 0.35;
const LEAST_BOUND_RADPS: f32 = 0.05;
/// Share of its yaw rate that a vehicle is taken to keep after the token.
const KEPT: f32 = 0.5;

/// Draws of a careful vehicle.
pub(crate) const CAREFUL_DRAWS: usize = 8;
/// Draws of a guided vehicle at criticality 1.
pub(crate) const GUIDED_DRAWS: usize = 16;
/// Steps ahead in which a careful vehicle looks out.
pub(crate) const CAREFUL_STEPS: usize = 15;

/// Motion of rows now.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Now<'a> {
    /// Speeds, m/s, [R].
    pub(crate) speed_mps: &'a [f32],
    /// Yaw rates, rad/s, [R].
    pub(crate) yaw_rate_radps: &'a [f32],
}

/// Normalised knots [N · R, T, 2] of tokens drawn from logits [R, [`NUM_TOKENS`]], each world's by its own seed. Speed and yaw rate go
/// evenly to the token's; then the speed is kept. A guide has each agent choose among its own draws, while all others keep their
/// speeds.
pub(crate) fn drawn(
    logits: &[f32],
    now: Now<'_>,
    asked: &Asked<'_>,
    config: &ModelConfig,
    guide: Guide<'_, '_>,
) -> Vec<f32> {
    let Asked { rows, seeds, options, .. } = *asked;
    let (count, n) = (rows.count(), options.num_samples);
    let width = 2 * config.horizon_steps;
    let mut knots = vec![0.0; n * count * width];
    for ((size, offset), seed) in rows.scene_sizes.iter().zip(row_offsets(rows.scene_sizes)).zip(seeds) {
        for agent in 0..*size {
            let row = offset + agent;
            let cumulative = cumulative(&logits[row * NUM_TOKENS..][..NUM_TOKENS], options.temperature);
            let (speed, yaw_rate) = (now.speed_mps[row], now.yaw_rate_radps[row]);
            for sample in 0..n {
                let (noise, at) = match rows.noise_seeds.get(row).copied().flatten() {
                    Some(own) => (Noise::new(own, 0), sample),
                    None => (Noise::new(*seed, 0), sample * size + agent),
                };
                let words = noise.block(at as u64).map(|w| f64::from(w) / 4_294_967_296.0);
                let wanted = words[0] * cumulative[NUM_TOKENS - 1];
                let token = cumulative.partition_point(|c| *c <= wanted).min(NUM_TOKENS - 1);
                let speed_change = SPEED.value(token / BINS, words[1] as f32);
                let end = bounded(speed, speed_change, YAW_RATE.value(token % BINS, words[2] as f32));
                let out = &mut knots[(sample * count + row) * width..][..width];
                ramp([speed, yaw_rate], end, config, out);
            }
        }
    }
    if let Some(guide) = guide {
        let mut kept = vec![0.0; count * width];
        for (row, out) in kept.chunks_exact_mut(width).enumerate() {
            let (speed, yaw_rate) = (now.speed_mps[row], now.yaw_rate_radps[row]);
            ramp([speed, yaw_rate], bounded(speed, 0.0, yaw_rate), config, out);
        }
        guide.choose_against(kept, Some(GUIDED_DRAWS));
    }
    knots
}

/// Running sums of the unnormalised probabilities.
fn cumulative(logits: &[f32], temperature: f64) -> Vec<f64> {
    let greatest = logits.iter().fold(f32::NEG_INFINITY, |m, v| m.max(*v));
    let mut sum = 0.0;
    let add = |logit: &f32| {
        sum += libm::exp(f64::from(logit - greatest) / temperature);
        sum
    };
    logits.iter().map(add).collect()
}

/// Speed and yaw rate at the end of a token.
pub(crate) fn bounded(speed: f32, speed_change: f32, yaw_rate: f32) -> [f32; 2] {
    let end = speed + speed_change;
    let end = if end < STANDING_MPS { 0.0 } else { end };
    let bound = (CURVATURE_1PM * end.max(speed)).max(LEAST_BOUND_RADPS);
    [end, if end == 0.0 { 0.0 } else { yaw_rate.clamp(-bound, bound) }]
}

/// Normalised knots of a plan that goes evenly from one speed and yaw rate to others.
fn ramp(start: [f32; 2], end: [f32; 2], config: &ModelConfig, knots: &mut [f32]) {
    let n = &config.normalisation;
    let normal = |value: f32, c: usize| (value - n.action_mean[c] as f32) / n.action_std[c] as f32;
    let steps = TOKEN_STEPS as f32;
    let acceleration = (end[0] - start[0]) / (steps * config.dt_s as f32);
    for (step, knot) in knots.chunks_exact_mut(2).enumerate() {
        let [a, w] = if step < TOKEN_STEPS {
            [acceleration, start[1] + (end[1] - start[1]) * (step + 1) as f32 / steps]
        } else {
            [0.0, KEPT * end[1]]
        };
        (knot[0], knot[1]) = (normal(a, 0), normal(w, 1));
    }
}
