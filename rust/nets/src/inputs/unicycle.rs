//! The unicycle of plans in plain numbers: its limits, actions from logged poses (reference.md#logged-actions), joints of knots.

use crate::config::ModelConfig;
use ccdiff_sim::dynamics::UnicycleLimits;
use ccdiff_sim::geom::Pose2;
use ccdiff_sim::geom::math::{self, wrap_angle};

/// Limits of a plan: those of the simulator's unicycle, but that plans may reverse, as those of the released models may.
pub fn plan_limits() -> UnicycleLimits {
    UnicycleLimits { speed_mps: [-10.0, 30.0], ..UnicycleLimits::default() }
}

/// A moment of a plan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Moment {
    pub(crate) x_m: f32,
    pub(crate) y_m: f32,
    pub(crate) speed_mps: f32,
    /// Since the start, radians.
    pub(crate) turned_rad: f32,
    pub(crate) cos: f32,
    pub(crate) sin: f32,
    /// Whether the clips of acceleration, speed and yaw rate did not act.
    pub(crate) free: [bool; 3],
}

/// Rolls actions [T, 2] (m/s², rad/s) out from a pose at a speed. The sum of accelerations is clipped ("parallel" mode), which
/// differs from integrating step by step once a bound is hit.
pub(crate) fn rolled(
    pose: Pose2,
    start_mps: f32,
    dt_s: f32,
    actions: &[f32],
) -> impl Iterator<Item = Moment> {
    let limits = plan_limits();
    let ([hardest, strongest], [slowest, fastest]) = (limits.acceleration_mps2, limits.speed_mps);
    let (mut x, mut y, mut sin, mut cos) = (pose.position.x, pose.position.y, pose.sin, pose.cos);
    let (mut before, mut gained, mut turned) = (start_mps, 0.0f32, 0.0f32);
    actions.chunks_exact(2).map(move |action| {
        let acceleration = action[0].clamp(hardest, strongest);
        gained += acceleration * dt_s;
        let wanted = gained + start_mps;
        let after = wanted.clamp(slowest, fastest);
        let bound = limits.yaw_rate_bound(before);
        let yaw_rate = action[1].clamp(-bound, bound);
        let step_m = (before + after) * (0.5 * dt_s);
        x += step_m * cos;
        y += step_m * sin;
        turned += yaw_rate * dt_s;
        (sin, cos) = math::sin_cos(pose.heading_rad + turned);
        before = after;
        let free = [acceleration == action[0], after == wanted, yaw_rate == action[1]];
        Moment { x_m: x, y_m: y, speed_mps: after, turned_rad: turned, cos, sin, free }
    })
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

/// How knots are joined linearly: of each step [T] the first of its two knots, and the share of the next one.
pub fn knot_joints(config: &ModelConfig) -> impl Iterator<Item = (usize, f32)> {
    let (stride, last) = (config.knot_stride as f64, (config.num_knots() - 1) as f64);
    (0..config.horizon_steps).map(move |step| {
        let at = ((step as f64 + 0.5) / stride - 0.5).clamp(0.0, last);
        (at.floor() as usize, (at - at.floor()) as f32)
    })
}
