//! Agents out of their logged place in training, with a future that leads back to the log.
//!
//! Ours, not the paper's: in closed loop the network meets states that no log holds; without such samples small errors
//! grow. [`Lateral`]: the current pose is moved sideways and turned, the history moves along rigidly, and the future joins the
//! log again on a cubic that starts in the turned direction. [`Longitudinal`]: a log holds few drivers that are too close or
//! too fast for what is ahead and brake for it, closed loop holds many. The agent is put ahead of or behind its place, its history
//! is replayed faster or slower, and the future, still on the logged path, falls back into the log's pace.

use crate::features::Window;
use crate::noise::Noise;
use ccdiff_sim::geom::{Point2, Pose2, Vector2};
use ccdiff_sim::scene::Scene;

/// Slower agents are left alone, metres per second.
const LEAST_SPEED_MPS: f32 = 2.0;
/// Shares of the agents that are pushed aside, and moved along.
const SHARES: (f64, f64) = (0.4, 0.35);
/// Standard deviation and bound of the sideways offset, metres.
const LATERAL_M: (f32, f32) = (0.4, 1.0);
/// Standard deviation and bound of the turn, radians.
const HEADING_RAD: (f32, f32) = (0.05, 0.12);
/// Seconds until an agent that was pushed aside joins the log again.
pub(crate) const ASIDE_S: f32 = 3.0;
/// Seconds until an agent that was moved along joins the log again.
const ALONG_S: f32 = 4.0;
/// Bound of the distance along the path, metres.
const ALONG_M: f32 = 4.0;
/// Bounds of the factor of the speed.
const SCALE: (f32, f32) = (0.85, 1.3);
/// Bound of the change of the speed, metres per second.
const CHANGE_MPS: f32 = 3.0;
/// First counter of the draws of agents that are moved along, past those of the others.
const FIRST_COUNTER: u64 = 1 << 48;

/// An offset and its rate per share of the way back, both gone at the share 1 of it.
fn way_back(offset: f32, rate: f32, s: f32) -> f32 {
    offset * (2.0 * s * s * s - 3.0 * s * s + 1.0) + rate * (s * s * s - 2.0 * s * s + s)
}

/// How far an agent is pushed off its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lateral {
    lateral_m: f32,
    heading_rad: f32,
}

impl Lateral {
    /// Draws whether and how the agent of a row is pushed. `slot` numbers the row among all of this draw's.
    pub(crate) fn draw(noise: &Noise, slot: u64, speed_mps: f32) -> Option<Self> {
        if noise.uniform(slot) >= SHARES.0 || speed_mps < LEAST_SPEED_MPS {
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
            let old = window.poses[at];
            let new = target.to_outer(now.to_local(old.position));
            window.poses[at] = Pose2::new(new.x, new.y, old.heading_rad + self.heading_rad);
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
        let slope =
            (self.lateral_m * (6.0 * s * s - 6.0 * s) + rate * (3.0 * s * s - 4.0 * s + 1.0)) / recovery_s;
        let moved = pose.to_outer(Vector2::new(0.0, way_back(self.lateral_m, rate, s)).into());
        Pose2::new(moved.x, moved.y, pose.heading_rad + libm::atan2f(slope, speed))
    }
}

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
            .map(|s| scene.pose(agent, s))
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
pub(crate) struct Longitudinal {
    along_m: f32,
    scale: f32,
    speed_mps: f32,
}

impl Longitudinal {
    /// Draws whether and how the agent of a row is moved. `slot` numbers the row among all of this draw's.
    pub(crate) fn draw(noise: &Noise, slot: u64, speed_mps: f32) -> Option<Self> {
        let counter = FIRST_COUNTER + slot;
        if noise.uniform(counter) >= SHARES.1 || speed_mps < LEAST_SPEED_MPS {
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
        let joined = trail.now + (ALONG_S / dt_s).round() as usize;
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
            window.poses[at] = Pose2::new(pose.position.x, pose.position.y, pose.heading_rad);
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
                let s = (step as f32 * dt_s / ALONG_S).min(1.0);
                driven_m = driven_m.max(logged_m + way_back(self.along_m, change_mps * ALONG_S, s));
                trail.at(driven_m)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A history without a vehicle's moves.
    fn window(steps: usize, speed_mps: f32) -> Window {
        Window {
            num_steps: steps,
            poses: vec![Pose2::new(0.0, 0.0, 0.0); steps],
            speed_mps: vec![speed_mps; steps],
            valid: vec![true; steps],
            length_m: vec![4.0],
            width_m: vec![2.0],
            ..Window::default()
        }
    }

    #[test]
    fn the_way_back_starts_at_the_pushed_pose_and_ends_on_the_log() {
        let push = Lateral { lateral_m: 0.7, heading_rad: -0.1 };
        let speed = 8.0;
        let log = |t: f32| Pose2::new(speed * t, 3.0, 0.0);
        let start = push.recover(log(0.0), 0.0, speed, ASIDE_S);
        assert!((start.position.y - 3.7).abs() < 1e-5 && (start.heading_rad + 0.1).abs() < 1e-5);
        assert_eq!(push.recover(log(3.1), 3.1, speed, ASIDE_S), log(3.1));
        // the heading is that of the path itself
        for i in 0..29 {
            let (a, b) = (0.1 * i as f32, 0.1 * (i + 1) as f32);
            let (p, q) = (push.recover(log(a), a, speed, ASIDE_S), push.recover(log(b), b, speed, ASIDE_S));
            let along = q.position - p.position;
            let middle = push.recover(log(0.5 * (a + b)), 0.5 * (a + b), speed, ASIDE_S);
            assert!((libm::atan2f(along.y, along.x) - middle.heading_rad).abs() < 2e-3);
        }
    }

    #[test]
    fn a_moved_history_keeps_its_shape() {
        let poses = [0.0, 1.0, 2.0].map(|x| Pose2::new(x, 0.0, 0.0)).to_vec();
        let mut window = Window { poses, ..window(3, 10.0) };
        Lateral { lateral_m: 0.5, heading_rad: 0.1 }.move_history(&mut window, 0);
        assert!((window.poses[2].position - Point2::new(2.0, 0.5)).norm() < 1e-6);
        let back = window.pose(0, 2).to_local(window.pose(0, 0).position);
        assert!((back.x + 2.0).abs() < 1e-5 && back.y.abs() < 1e-5);
    }

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
        let pace = Longitudinal { along_m: 3.0, scale: 1.3, speed_mps: 8.3 }.within(&trail, 0.1);
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
        let pace = Longitudinal { along_m: 4.0, scale: 1.2, speed_mps: 1.7 };
        assert!(pace.within(&trail, 0.1).along_m <= 0.5 * trail.driven_m[70] + 1e-5);
        let future = pace.future(&trail, 0.1);
        let driven: Vec<f32> = future.iter().map(|p| 40.0 * p.heading_rad).collect();
        assert!(driven.windows(2).all(|p| p[1] >= p[0] - 1e-3));
    }

    #[test]
    fn a_moved_history_is_the_logged_path_at_another_pace() {
        let trail = trail();
        let mut window = window(15, 8.0);
        Longitudinal { along_m: -2.0, scale: 0.9, speed_mps: 8.0 }.move_history(&mut window, 0, &trail);
        assert_eq!(window.valid.iter().filter(|v| **v).count(), 11);
        let last = (0..15).map(|s| window.pose(0, s)).collect::<Vec<_>>();
        assert!((last[14].position - trail.at(-2.0).position).norm() < 1e-4);
        assert!((last[4].position - trail.at(-2.0 + 0.9 * trail.driven_m[0]).position).norm() < 1e-4);
        assert!((window.speed_mps[14] - 7.2).abs() < 1e-5);
    }
}
