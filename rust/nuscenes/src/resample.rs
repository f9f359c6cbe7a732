//! From key frames at 2 Hz to steps of constant length.

use crate::options::Interpolation;
use crate::spline::{Curve, SmoothingSpline};
use crate::tables::Key;
use ccdiff_sim::scene::LONGEST_GAP_S;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Smoothing of annotated tracks, s³: where a key frame that is left out is foretold best among the values that leave
/// 99 % of the annotations within 0.15 m (`tests/test_scenes_oracle.py`). Poses of the ego are not smoothed.
pub(crate) const ANNOTATION_SMOOTHING_S3: f64 = 0.003;

/// State at one step, global frame, f64.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct State {
    pub(crate) position_m: [f64; 2],
    pub(crate) heading_rad: f64,
    pub(crate) velocity_mps: [f64; 2],
}

/// A track at every step from its first key frame to its last.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Resampled {
    /// Step of `states[0]` in the scene.
    pub(crate) first_step: usize,
    pub(crate) states: Vec<State>,
    /// Steps of the scene inside the track at which the agent is away: gaps that are too long to be filled.
    pub(crate) absences: Vec<Range<usize>>,
    /// Gaps inside the track that were filled.
    pub(crate) filled_gaps: usize,
}

/// Steps of a scene: step s is s * `step_us` after its first key frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Steps {
    pub(crate) step_us: f64,
    pub(crate) count: usize,
}

impl Steps {
    /// From the first key frame to the step that is nearest to the last.
    pub(crate) fn until(last_us: i64, step_us: f64) -> Self {
        Self { step_us, count: (last_us as f64 / step_us).round() as usize + 1 }
    }

    /// Steps of a track: the nearest ones to its ends and those between them.
    fn within(&self, first_us: i64, last_us: i64) -> Range<usize> {
        self.nearest(first_us)..self.nearest(last_us) + 1
    }

    fn nearest(&self, us: i64) -> usize {
        ((us as f64 / self.step_us).round().max(0.0) as usize).min(self.count - 1)
    }
}

/// Resamples a track; `keys` in time order, `times_us` their times after the first key frame of the scene. Motion goes
/// straight on to a step that is nearest to an end of the track but lies beyond it.
pub(crate) fn resample(
    keys: &[Key],
    times_us: &[i64],
    steps: Steps,
    interpolation: Interpolation,
    smoothing_s3: f64,
) -> Resampled {
    let (Some(first), Some(last)) = (times_us.first(), times_us.last()) else { return Resampled::default() };
    let range = steps.within(*first, *last);
    let mut out = Resampled { first_step: range.start, ..Resampled::default() };
    for (pair, times) in keys.windows(2).zip(times_us.windows(2)) {
        let missing = pair[1].frame - pair[0].frame - 1;
        if missing > 0 && (times[1] - times[0]) as f64 * 1e-6 > f64::from(LONGEST_GAP_S) {
            out.absences.push(steps.nearest(times[0]) + 1..steps.nearest(times[1]));
        } else {
            out.filled_gaps += usize::from(missing > 0);
        }
    }
    let mut headings: Vec<f64> = Vec::with_capacity(keys.len());
    for key in keys {
        headings.push(headings.last().map_or(key.yaw_rad, |before| unwrapped(*before, key.yaw_rad)));
    }
    let track = match (interpolation, keys) {
        (_, [key]) => Track::Still(State {
            position_m: [key.x_m, key.y_m],
            heading_rad: key.yaw_rad,
            velocity_mps: [0.0; 2],
        }),
        (Interpolation::Linear, _) => Track::Linear(linear_states(keys, times_us, &headings)),
        (Interpolation::Smooth, _) => Track::smooth(keys, times_us, headings, smoothing_s3),
    };
    let mut interval = 0;
    out.states.reserve_exact(range.len());
    for step in range {
        let at_us = step as f64 * steps.step_us;
        while interval + 2 < times_us.len() && times_us[interval + 1] as f64 <= at_us {
            interval += 1;
        }
        out.states.push(track.at(interval, times_us, at_us));
    }
    out
}

/// The angle that differs from the one before by at most half a turn.
pub(crate) fn unwrapped(before: f64, angle: f64) -> f64 {
    before + (angle - before + PI).rem_euclid(TAU) - PI
}

/// States at key frames. Velocities are those of the devkit's `box_velocity`: central differences over the neighbours,
/// one-sided at the ends. Differs from the devkit: it answers NaN over long gaps, this the difference.
fn linear_states(keys: &[Key], times_us: &[i64], headings: &[f64]) -> Vec<State> {
    let state = |i: usize| {
        let (from, to) = (i.saturating_sub(1), (i + 1).min(keys.len() - 1));
        let seconds = (times_us[to] - times_us[from]) as f64 * 1e-6;
        let rate = |value: fn(&Key) -> f64| (value(&keys[to]) - value(&keys[from])) / seconds;
        State {
            position_m: [keys[i].x_m, keys[i].y_m],
            heading_rad: headings[i],
            velocity_mps: [rate(|k| k.x_m), rate(|k| k.y_m)],
        }
    };
    (0..keys.len()).map(state).collect()
}

/// A track as a function of time.
enum Track {
    /// Of one key frame.
    Still(State),
    /// States at key frames; straight lines between them in position, heading and velocity.
    Linear(Vec<State>),
    /// A curve of x, y and heading; velocity is the slope of the position.
    Smooth { spline: SmoothingSpline, curve: Curve<3> },
}

impl Track {
    fn smooth(keys: &[Key], times_us: &[i64], headings: Vec<f64>, smoothing_s3: f64) -> Self {
        let times_s = times_us.iter().map(|t| (t - times_us[0]) as f64 * 1e-6).collect();
        let spline = SmoothingSpline::new(times_s, smoothing_s3);
        let values = keys.iter().zip(headings).map(|(key, heading)| [key.x_m, key.y_m, heading]);
        let curve = spline.fit(values.collect());
        Self::Smooth { spline, curve }
    }

    /// State at a time in the interval after key frame `i`, or beyond the ends of the track.
    fn at(&self, i: usize, times_us: &[i64], at_us: f64) -> State {
        match self {
            Self::Still(state) => *state,
            Self::Linear(states) => {
                let (from, to) = (states[i], states[i + 1]);
                let fraction = (at_us - times_us[i] as f64) / (times_us[i + 1] - times_us[i]) as f64;
                let linear = |a: f64, b: f64| a + (b - a) * fraction;
                State {
                    position_m: [0, 1].map(|axis| linear(from.position_m[axis], to.position_m[axis])),
                    heading_rad: linear(from.heading_rad, to.heading_rad),
                    velocity_mps: [0, 1].map(|axis| linear(from.velocity_mps[axis], to.velocity_mps[axis])),
                }
            }
            Self::Smooth { spline, curve } => {
                let u_s = (at_us - times_us[i] as f64) * 1e-6;
                let [[x, vx], [y, vy], [heading_rad, _]] = spline.at(curve, i, u_s);
                State { position_m: [x, y], heading_rad, velocity_mps: [vx, vy] }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(frame: usize, x_m: f64, yaw_rad: f64) -> Key {
        Key { frame, timestamp_us: 0, x_m, y_m: -x_m, yaw_rad }
    }

    /// Resamples at 10 Hz with key frames every half second.
    fn at_10_hz(keys: &[Key], interpolation: Interpolation, smoothing_s3: f64) -> Resampled {
        let times_us: Vec<i64> = keys.iter().map(|k| 500_000 * k.frame as i64).collect();
        let steps = Steps::until(*times_us.last().unwrap_or(&0), 100_000.0);
        resample(keys, &times_us, steps, interpolation, smoothing_s3)
    }

    #[test]
    fn a_gap_is_filled_and_counted() {
        for way in [Interpolation::Linear, Interpolation::Smooth] {
            let track = at_10_hz(&[key(1, 0.0, 0.0), key(4, 3.0, 0.0)], way, 0.003);
            assert_eq!((track.first_step, track.states.len()), (5, 16));
            assert_eq!(track.filled_gaps, 1);
            assert!((track.states[5].position_m[0] - 1.0).abs() < 1e-12);
            assert!(track.states.iter().all(|s| (s.velocity_mps[0] - 2.0).abs() < 1e-12));
        }
    }

    #[test]
    fn a_single_key_frame_stands_still() {
        let track = at_10_hz(&[key(2, 7.0, 1.0)], Interpolation::Smooth, 0.003);
        assert_eq!((track.first_step, track.states.len()), (10, 1));
        assert_eq!(track.states[0].velocity_mps, [0.0, 0.0]);
    }

    #[test]
    fn heading_crosses_the_seam_the_short_way() {
        for way in [Interpolation::Linear, Interpolation::Smooth] {
            let track = at_10_hz(&[key(0, 0.0, 3.1), key(1, 1.0, -3.1), key(2, 2.0, -3.0)], way, 0.003);
            let headings: Vec<f64> = track.states.iter().map(|s| s.heading_rad).collect();
            assert!(headings.windows(2).all(|w| (0.0..0.04).contains(&(w[1] - w[0]))), "{headings:?}");
        }
    }

    #[test]
    fn steps_beyond_an_end_go_straight_on() {
        // the last key frame is 40 ms before the step that is nearest to it
        let keys = [key(0, 0.0, 0.0), key(1, 4.6, 0.1)];
        let steps = Steps { step_us: 100_000.0, count: 6 };
        for way in [Interpolation::Linear, Interpolation::Smooth] {
            let track = resample(&keys, &[0, 460_000], steps, way, 0.003);
            let last = track.states[5];
            assert_eq!(track.states.len(), 6);
            assert!((last.position_m[0] - 5.0).abs() < 1e-12, "{last:?}");
            assert!((last.velocity_mps[0] - 10.0).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn both_ways_keep_uniform_motion_and_pass_through_key_frames_that_are_not_smoothed(
            xs in proptest::collection::vec((-50.0_f64..50.0, -3.0_f64..3.0), 1..12),
            speed in -20.0_f64..20.0,
        ) {
            let keys: Vec<Key> = xs.iter().enumerate().map(|(i, (x, yaw))| key(i, *x, *yaw)).collect();
            let uniform: Vec<Key> = (0..4).map(|i| key(i, speed * 0.5 * i as f64, 0.3)).collect();
            for way in [Interpolation::Linear, Interpolation::Smooth] {
                let track = at_10_hz(&keys, way, 0.0);
                prop_assert_eq!(track.states.len(), (keys.len() - 1) * 5 + 1);
                for (i, k) in keys.iter().enumerate() {
                    let state = track.states[i * 5];
                    prop_assert!((state.position_m[0] - k.x_m).abs() < 1e-9);
                    let turns = (state.heading_rad - k.yaw_rad) / TAU;
                    prop_assert!((turns - turns.round()).abs() < 1e-9);
                }
                for smoothing_s3 in [0.0, 0.003, 1.0] {
                    for (step, state) in at_10_hz(&uniform, way, smoothing_s3).states.iter().enumerate() {
                        prop_assert!((state.position_m[0] - speed * 0.1 * step as f64).abs() < 1e-9);
                        prop_assert!((state.velocity_mps[0] - speed).abs() < 1e-9);
                    }
                }
            }
        }
    }
}
