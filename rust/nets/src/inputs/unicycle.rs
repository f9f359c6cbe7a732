//! The unicycle of plans in plain numbers: its limits, actions from logged poses (reference.md#logged-actions), joints of knots.

use crate::config::ModelConfig;
use ccdiff_sim::dynamics::UnicycleLimits;
use ccdiff_sim::geom::math::wrap_angle;

/// Limits of a plan: those of the simulator's unicycle, but that plans may reverse, as those of the released models may.
pub fn plan_limits() -> UnicycleLimits {
    UnicycleLimits { speed_mps: [-10.0, 30.0], ..UnicycleLimits::default() }
}

/// States x, y, v, yaw, acceleration, yaw rate [T, 6] of poses in the agent frame, from finite differences.
///
/// `poses` are (x, y, yaw) at steps 1..=T; step 0 is the origin, heading +x, with `speed_mps`. Not exactly reproduced by
/// rolling the actions out through the clipped unicycle.
pub fn states_of_poses(poses: &[[f32; 3]], speed_mps: f32, dt_s: f32) -> Vec<[f32; 6]> {
    let (mut last, mut last_speed) = ([0.0f32; 3], speed_mps);
    poses
        .iter()
        .map(|&[x, y, yaw]| {
            let (sin, cos) = yaw.sin_cos();
            let speed = ((x - last[0]) * cos + (y - last[1]) * sin) / dt_s;
            let state = [x, y, speed, yaw, (speed - last_speed) / dt_s, wrap_angle(yaw - last[2]) / dt_s];
            (last, last_speed) = ([x, y, yaw], speed);
            state
        })
        .collect()
}

/// The matrix [T, knots] that joins knots linearly; the identity for a stride of one.
pub fn knot_weights(config: &ModelConfig) -> Vec<f32> {
    let (steps, knots) = (config.horizon_steps, config.num_knots());
    let mut weights = vec![0.0f32; steps * knots];
    for step in 0..steps {
        let at = ((step as f64 + 0.5) / config.knot_stride as f64 - 0.5).clamp(0.0, (knots - 1) as f64);
        let low = (at.floor() as usize).min(knots - 1);
        let share = (at - low as f64) as f32;
        weights[step * knots + low] += 1.0 - share;
        if share > 0.0 {
            weights[step * knots + low + 1] += share;
        }
    }
    weights
}
