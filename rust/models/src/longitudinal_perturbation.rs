//! Agents moved along their logged path in training, with a future that falls back into the log's pace.
//!
//! Ours, not the paper's, like [`crate::lateral_perturbation`]: a log holds few drivers who are too close or too fast for what is
//! ahead and brake for it, closed loop holds many. The agent is put ahead of or behind its place, its history is replayed
//! faster or slower, and the future, still on the logged path, joins the log again after [`RECOVERY_S`].

use crate::features::Window;
use crate::noise::Noise;
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::scene::Scene;

/// Share of the agents that are moved.
const SHARE: f64 = 0.35;
/// Bound of the distance along the path, metres.
const ALONG_M: f32 = 4.0;
/// Bounds of the factor of the speed.
const SCALE: (f32, f32) = (0.85, 1.3);
/// Bound of the change of the speed, metres per second.
const CHANGE_MPS: f32 = 3.0;
/// Slower agents are left alone, metres per second.
const LEAST_SPEED_MPS: f32 = 2.0;
/// Seconds until the log is joined again.
const RECOVERY_S: f32 = 4.0;
/// First counter of the draws, past those of [`crate::lateral_perturbation`].
const FIRST_COUNTER: u64 = 1 << 48;

/// Logged poses of an agent by the distance driven since now.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trail {
    /// Index of the pose of now.
    now: usize,
    /// Distance since now, metres, never falling.
    driven_m: Vec<f32>,
    poses: Vec<Pose2>,
}

impl Trail {
    /// The unbroken logged run round a step at which the agent is logged, at most `back` steps before and `ahead` after.
    pub(crate) fn new(scene: &Scene, agent: usize, step: usize, back: usize, ahead: usize) -> Self {
        let first_step =
            (step.saturating_sub(back)..step).rev().take_while(|s| scene.is_valid(agent, *s)).last();
        let first_step = first_step.unwrap_or(step);
        let poses: Vec<Pose2> = (first_step..=step + ahead)
            .take_while(|s| *s <= step || scene.is_valid(agent, *s))
            .map(|s| {
                let entry = scene.at(agent, s);
                let at = scene.tracks.position[entry];
                Pose2::new(at.x, at.y, scene.tracks.heading_rad[entry])
            })
            .collect();
        let mut driven_m = vec![0.0f32; poses.len()];
        for i in 1..poses.len() {
            driven_m[i] = driven_m[i - 1] + (poses[i].position - poses[i - 1].position).norm();
        }
        let now = step - first_step;
        let start = driven_m[now];
        driven_m.iter_mut().for_each(|s| *s -= start);
        Self { now, driven_m, poses }
    }

    /// The pose after a distance; straight on beyond either end.
    fn at(&self, driven_m: f32) -> Pose2 {
        let last = self.poses.len() - 1;
        let high = self.driven_m.partition_point(|s| *s < driven_m);
        if high == 0 || high > last {
            let end = if high == 0 { 0 } else { last };
            let (pose, beyond) = (self.poses[end], driven_m - self.driven_m[end]);
            let moved = pose.to_outer(Point2::new(beyond, 0.0));
            return Pose2::new(moved.x, moved.y, pose.heading_rad);
        }
        let (a, b) = (self.poses[high - 1], self.poses[high]);
        let share = (driven_m - self.driven_m[high - 1]) / (self.driven_m[high] - self.driven_m[high - 1]);
        let at = a.position + (b.position - a.position) * share;
        let turn = ccdiff_sim::geom::math::wrap_angle(b.heading_rad - a.heading_rad);
        Pose2::new(at.x, at.y, a.heading_rad + share * turn)
    }
}

/// How far an agent is out of its place and pace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LongitudinalPerturbation {
    along_m: f32,
    scale: f32,
    speed_mps: f32,
}

impl LongitudinalPerturbation {
    /// Draws whether and how the agent of a row is moved. `slot` numbers the row among all of this draw's.
    pub(crate) fn draw(noise: &Noise, slot: u64, speed_mps: f32) -> Option<Self> {
        let counter = FIRST_COUNTER + slot;
        if noise.uniform(counter) >= SHARE || speed_mps < LEAST_SPEED_MPS {
            return None;
        }
        let words = noise.block(counter);
        let uniform = |word: u32, low: f32, high: f32| low + (high - low) * (word as f32 / u32::MAX as f32);
        let change = (uniform(words[2], SCALE.0, SCALE.1) - 1.0) * speed_mps;
        Some(Self {
            along_m: uniform(words[1], -ALONG_M, ALONG_M),
            scale: 1.0 + change.clamp(-CHANGE_MPS, CHANGE_MPS) / speed_mps,
            speed_mps,
        })
    }

    /// The same, but no farther ahead than half of what the log drives until it is joined again.
    pub(crate) fn within(self, trail: &Trail, dt_s: f32) -> Self {
        let joined = trail.now + (RECOVERY_S / dt_s).round() as usize;
        let ahead = trail.driven_m[joined.min(trail.driven_m.len() - 1)];
        Self { along_m: self.along_m.min(0.5 * ahead), ..self }
    }

    /// Moves an agent's history, which ends at the trail's now. Steps before an interruption of the log are dropped.
    pub(crate) fn move_history(&self, window: &mut Window, agent: usize, trail: &Trail) {
        let steps = window.num_steps;
        for step in 0..steps {
            let at = agent * steps + step;
            let Some(index) = (trail.now + step + 1).checked_sub(steps) else {
                window.valid[at] = false;
                continue;
            };
            let pose = trail.at(self.along_m + self.scale * trail.driven_m[index]);
            (window.x_m[at], window.y_m[at]) = (pose.position.x, pose.position.y);
            window.heading_rad[at] = pose.heading_rad;
            window.speed_mps[at] *= self.scale;
        }
    }

    /// Poses at the logged steps after now; never backwards.
    pub(crate) fn future(&self, trail: &Trail, dt_s: f32) -> Vec<Pose2> {
        let change_mps = (self.scale - 1.0) * self.speed_mps;
        let mut driven_m = self.along_m;
        (1usize..)
            .zip(&trail.driven_m[trail.now + 1..])
            .map(|(step, logged_m)| {
                let s = (step as f32 * dt_s / RECOVERY_S).min(1.0);
                let offset = self.along_m * (2.0 * s * s * s - 3.0 * s * s + 1.0)
                    + change_mps * RECOVERY_S * (s * s * s - 2.0 * s * s + s);
                driven_m = driven_m.max(logged_m + offset);
                trail.at(driven_m)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive along a quarter circle that slows down from 10 m/s to a stop at 6 s.
    fn trail() -> Trail {
        let driven = |t: f32| if t < 6.0 { 10.0 * t - 10.0 / 12.0 * t * t } else { 30.0 };
        let pose = |s: f32| Pose2::new(40.0 * (s / 40.0).sin(), 40.0 * (1.0 - (s / 40.0).cos()), s / 40.0);
        let times: Vec<f32> = (0..=70).map(|i| 0.1 * i as f32).collect();
        let start = driven(1.0);
        Trail {
            now: 10,
            driven_m: times.iter().map(|t| driven(*t) - start).collect(),
            poses: times.iter().map(|t| pose(driven(*t))).collect(),
        }
    }

    #[test]
    fn the_future_starts_at_the_moved_state_and_joins_the_log_on_its_path() {
        let trail = trail();
        let pace = LongitudinalPerturbation { along_m: 3.0, scale: 1.3, speed_mps: 8.3 }.within(&trail, 0.1);
        let future = pace.future(&trail, 0.1);
        assert_eq!(future.len(), 60);
        let start = trail.at(pace.along_m);
        let first_mps = (future[0].position - start.position).norm() / 0.1;
        assert!((first_mps - 1.3 * 8.3).abs() < 0.6, "{first_mps}");
        for pose in &future {
            // all on the circle, in its direction
            let radius = libm::hypotf(pose.position.x, pose.position.y - 40.0);
            assert!((radius - 40.0).abs() < 0.05, "{radius}");
            assert!((libm::atan2f(pose.position.x, 40.0 - pose.position.y) - pose.heading_rad).abs() < 0.01);
        }
        for (a, b) in future.iter().zip(&trail.poses[11..]).skip(39) {
            assert!((a.position - b.position).norm() < 0.02);
        }
        let speeds: Vec<f32> =
            future.windows(2).map(|p| (p[1].position - p[0].position).norm() / 0.1).collect();
        assert!(speeds.windows(2).all(|v| (v[1] - v[0]).abs() / 0.1 < 6.0), "{speeds:?}");
    }

    #[test]
    fn who_is_ahead_of_a_stop_waits_and_does_not_reverse() {
        let mut trail = trail();
        trail.now = 50;
        let now = trail.driven_m[50];
        trail.driven_m.iter_mut().for_each(|s| *s -= now);
        let pace = LongitudinalPerturbation { along_m: 4.0, scale: 1.2, speed_mps: 1.7 };
        assert!(pace.within(&trail, 0.1).along_m <= 0.5 * trail.driven_m[70] + 1e-5);
        let future = pace.future(&trail, 0.1);
        let driven: Vec<f32> = future.iter().map(|p| 40.0 * p.heading_rad).collect();
        assert!(driven.windows(2).all(|p| p[1] >= p[0] - 1e-3));
    }

    #[test]
    fn a_moved_history_is_the_logged_path_at_another_pace() {
        let trail = trail();
        let mut window = Window {
            num_steps: 15,
            x_m: vec![0.0; 15],
            y_m: vec![0.0; 15],
            heading_rad: vec![0.0; 15],
            speed_mps: vec![8.0; 15],
            valid: vec![true; 15],
            length_m: vec![4.0],
            width_m: vec![2.0],
            ..Window::default()
        };
        LongitudinalPerturbation { along_m: -2.0, scale: 0.9, speed_mps: 8.0 }.move_history(
            &mut window,
            0,
            &trail,
        );
        assert_eq!(window.valid.iter().filter(|v| **v).count(), 11);
        let last = (0..15).map(|s| window.pose(0, s)).collect::<Vec<_>>();
        assert!((last[14].position - trail.at(-2.0).position).norm() < 1e-4);
        assert!((last[4].position - trail.at(-2.0 + 0.9 * trail.driven_m[0]).position).norm() < 1e-4);
        assert!((window.speed_mps[14] - 7.2).abs() < 1e-5);
    }
}
