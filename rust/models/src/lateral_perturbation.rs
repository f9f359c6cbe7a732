//! Agents pushed off their logged path in training (and along it: [`crate::longitudinal_perturbation`]), with a future that leads back.
//!
//! Ours, not the paper's: in closed loop the network meets states that no log holds; without such samples small errors
//! grow. The current pose is moved sideways and turned, the history moves along rigidly, and the future joins the log
//! again after [`RECOVERY_S`] (tokens: after 2 s) on a cubic that starts in the turned direction.

use crate::features::Window;
use crate::noise::Noise;
use ccdiff_sim::geom::{Pose2, Vector2};

/// Share of the agents that are pushed.
const SHARE: f64 = 0.4;
/// Standard deviation and bound of the sideways offset, metres.
const LATERAL_M: (f32, f32) = (0.4, 1.0);
/// Standard deviation and bound of the turn, radians.
const HEADING_RAD: (f32, f32) = (0.05, 0.12);
/// Slower agents are left alone, metres per second.
const LEAST_SPEED_MPS: f32 = 2.0;
/// Seconds until the log is joined again.
pub(crate) const RECOVERY_S: f32 = 3.0;

/// How far an agent is pushed off its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LateralPerturbation {
    lateral_m: f32,
    heading_rad: f32,
}

impl LateralPerturbation {
    /// Draws whether and how the agent of a row is pushed. `slot` numbers the row among all of this draw's.
    pub(crate) fn draw(noise: &Noise, slot: u64, speed_mps: f32) -> Option<Self> {
        if noise.uniform(slot) >= SHARE || speed_mps < LEAST_SPEED_MPS {
            return None;
        }
        let normals = Noise::new(noise.block(slot)[1].into(), u64::from(noise.block(slot)[2])).normals(2);
        let bounded = |v: f32, (std, bound): (f32, f32)| (v * std).clamp(-bound, bound);
        Some(Self {
            lateral_m: bounded(normals[0], LATERAL_M),
            heading_rad: bounded(normals[1], HEADING_RAD),
        })
    }

    /// Moves an agent's whole history rigidly, so that its current pose is pushed.
    pub(crate) fn move_history(&self, window: &mut Window, agent: usize) {
        let steps = window.num_steps;
        let now = window.pose(agent, steps - 1);
        let moved = now.to_outer(Vector2::new(0.0, self.lateral_m).into());
        let target = Pose2::new(moved.x, moved.y, now.heading_rad + self.heading_rad);
        for at in agent * steps..(agent + 1) * steps {
            let old = ccdiff_sim::geom::Point2::new(window.x_m[at], window.y_m[at]);
            let new = target.to_outer(now.to_local(old));
            (window.x_m[at], window.y_m[at]) = (new.x, new.y);
            window.heading_rad[at] += self.heading_rad;
        }
    }

    /// Moves a logged future pose, `seconds` after now, to the path that leads back in `recovery_s`.
    pub(crate) fn recover(&self, pose: Pose2, seconds: f32, speed_mps: f32, recovery_s: f32) -> Pose2 {
        if seconds >= recovery_s {
            return pose;
        }
        let speed = speed_mps.max(LEAST_SPEED_MPS);
        let s = seconds / recovery_s;
        let rate = recovery_s * speed * libm::tanf(self.heading_rad);
        let offset =
            self.lateral_m * (2.0 * s * s * s - 3.0 * s * s + 1.0) + rate * (s * s * s - 2.0 * s * s + s);
        let slope =
            (self.lateral_m * (6.0 * s * s - 6.0 * s) + rate * (3.0 * s * s - 4.0 * s + 1.0)) / recovery_s;
        let moved = pose.to_outer(Vector2::new(0.0, offset).into());
        Pose2::new(moved.x, moved.y, pose.heading_rad + libm::atan2f(slope, speed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_back_starts_at_the_pushed_pose_and_ends_on_the_log() {
        let push = LateralPerturbation { lateral_m: 0.7, heading_rad: -0.1 };
        let speed = 8.0;
        let log = |t: f32| Pose2::new(speed * t, 3.0, 0.0);
        let start = push.recover(log(0.0), 0.0, speed, RECOVERY_S);
        assert!((start.position.y - 3.7).abs() < 1e-5 && (start.heading_rad + 0.1).abs() < 1e-5);
        assert_eq!(push.recover(log(3.1), 3.1, speed, RECOVERY_S), log(3.1));
        // the heading is that of the path itself
        for i in 0..29 {
            let (a, b) = (0.1 * i as f32, 0.1 * (i + 1) as f32);
            let (p, q) =
                (push.recover(log(a), a, speed, RECOVERY_S), push.recover(log(b), b, speed, RECOVERY_S));
            let along = q.position - p.position;
            let middle = push.recover(log(0.5 * (a + b)), 0.5 * (a + b), speed, RECOVERY_S);
            assert!((libm::atan2f(along.y, along.x) - middle.heading_rad).abs() < 2e-3);
        }
    }

    #[test]
    fn a_moved_history_keeps_its_shape() {
        let mut window = Window {
            num_steps: 3,
            x_m: vec![0.0, 1.0, 2.0],
            y_m: vec![0.0; 3],
            heading_rad: vec![0.0; 3],
            speed_mps: vec![10.0; 3],
            valid: vec![true; 3],
            length_m: vec![4.0],
            width_m: vec![2.0],
            ..Window::default()
        };
        LateralPerturbation { lateral_m: 0.5, heading_rad: 0.1 }.move_history(&mut window, 0);
        assert!((window.x_m[2] - 2.0).abs() < 1e-6 && (window.y_m[2] - 0.5).abs() < 1e-6);
        let back = window.pose(0, 2).to_local(window.pose(0, 0).position);
        assert!((back.x + 2.0).abs() < 1e-5 && back.y.abs() < 1e-5);
    }
}
