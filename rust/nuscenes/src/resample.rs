//! From key frames at 2 Hz to steps of constant length.

use crate::options::Interpolation;
use crate::tables::Key;
use std::f64::consts::{PI, TAU};

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
    /// Gaps inside the track that were filled.
    pub(crate) filled_gaps: usize,
    /// Key frames in those gaps.
    pub(crate) filled_key_frames: usize,
}

/// Resamples a track; `keys` in time order, one per key frame at most.
///
/// The key frame k is step k * `steps_per_key` exactly, whatever the sensors' jitter (reference.md#time-base); velocities use
/// the true timestamps. Steps between key frames follow `interpolation`; missing key frames are bridged the same way.
pub(crate) fn resample(keys: &[Key], steps_per_key: usize, interpolation: Interpolation) -> Resampled {
    let Some(first) = keys.first() else { return Resampled::default() };
    let headings = unwrapped(keys);
    let velocities = key_velocities(keys);
    let yaw_rates = rates(keys, |i| headings[i]);
    let mut out = Resampled { first_step: first.frame * steps_per_key, ..Resampled::default() };
    out.states.reserve_exact((keys[keys.len() - 1].frame - first.frame) * steps_per_key + 1);
    for (i, pair) in keys.windows(2).enumerate() {
        let frames = pair[1].frame - pair[0].frame;
        if frames > 1 {
            out.filled_gaps += 1;
            out.filled_key_frames += frames - 1;
        }
        let span = Span {
            seconds: seconds(&pair[0], &pair[1]),
            position_m: [[pair[0].x_m, pair[1].x_m], [pair[0].y_m, pair[1].y_m]],
            velocity_mps: [0, 1].map(|axis| [velocities[i][axis], velocities[i + 1][axis]]),
            heading_rad: [headings[i], headings[i + 1]],
            yaw_rate_radps: [yaw_rates[i], yaw_rates[i + 1]],
        };
        let steps = frames * steps_per_key;
        out.states.extend((0..steps).map(|s| span.at(s as f64 / steps as f64, interpolation)));
    }
    let last = keys.len() - 1;
    out.states.push(State {
        position_m: [keys[last].x_m, keys[last].y_m],
        heading_rad: headings[last],
        velocity_mps: velocities[last],
    });
    out
}

fn seconds(from: &Key, to: &Key) -> f64 {
    (to.timestamp_us as f64 - from.timestamp_us as f64) * 1e-6
}

/// Yaw without jumps: neighbouring key frames differ by at most half a turn.
fn unwrapped(keys: &[Key]) -> Vec<f64> {
    let mut headings: Vec<f64> = Vec::with_capacity(keys.len());
    for key in keys {
        let heading = match headings.last() {
            Some(before) => before + (key.yaw_rad - before + PI).rem_euclid(TAU) - PI,
            None => key.yaw_rad,
        };
        headings.push(heading);
    }
    headings
}

/// Velocities at key frames as the devkit's `box_velocity`: central differences over the neighbours, one-sided at the
/// ends, zero for a single key frame. Differs from the devkit: it answers NaN over long gaps, this the difference.
fn key_velocities(keys: &[Key]) -> Vec<[f64; 2]> {
    let (x, y) = (rates(keys, |i| keys[i].x_m), rates(keys, |i| keys[i].y_m));
    x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
}

fn rates(keys: &[Key], value: impl Fn(usize) -> f64) -> Vec<f64> {
    let last = keys.len() - 1;
    let rate = |i: usize| {
        let (from, to) = (i.saturating_sub(1), (i + 1).min(last));
        if from == to { 0.0 } else { (value(to) - value(from)) / seconds(&keys[from], &keys[to]) }
    };
    (0..keys.len()).map(rate).collect()
}

/// Between two key frames.
struct Span {
    seconds: f64,
    position_m: [[f64; 2]; 2],
    velocity_mps: [[f64; 2]; 2],
    heading_rad: [f64; 2],
    yaw_rate_radps: [f64; 2],
}

impl Span {
    /// State at a fraction of the span, 0 to 1.
    fn at(&self, fraction: f64, interpolation: Interpolation) -> State {
        let linear = |[a, b]: [f64; 2]| a + (b - a) * fraction;
        match interpolation {
            Interpolation::Linear => State {
                position_m: self.position_m.map(linear),
                heading_rad: linear(self.heading_rad),
                velocity_mps: self.velocity_mps.map(linear),
            },
            Interpolation::Smooth => {
                let curve = |axis: usize| {
                    hermite(self.position_m[axis], self.velocity_mps[axis], self.seconds, fraction)
                };
                let (x, y) = (curve(0), curve(1));
                State {
                    position_m: [x.0, y.0],
                    heading_rad: hermite(self.heading_rad, self.yaw_rate_radps, self.seconds, fraction).0,
                    velocity_mps: [x.1, y.1],
                }
            }
        }
    }
}

/// Value and rate of the cubic with these values and rates at the ends of an interval of `seconds`.
fn hermite([a, b]: [f64; 2], [rate_a, rate_b]: [f64; 2], seconds: f64, u: f64) -> (f64, f64) {
    let (ta, tb) = (rate_a * seconds, rate_b * seconds);
    let (u2, u3) = (u * u, u * u * u);
    let value = a * (2.0 * u3 - 3.0 * u2 + 1.0)
        + ta * (u3 - 2.0 * u2 + u)
        + b * (3.0 * u2 - 2.0 * u3)
        + tb * (u3 - u2);
    let slope = (b - a) * 6.0 * (u - u2) + ta * (3.0 * u2 - 4.0 * u + 1.0) + tb * (3.0 * u2 - 2.0 * u);
    (value, slope / seconds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn key(frame: usize, x_m: f64, yaw_rad: f64) -> Key {
        Key { frame, timestamp_us: 500_000 * frame as i64, x_m, y_m: -x_m, yaw_rad }
    }

    #[test]
    fn a_gap_is_filled_and_counted() {
        let track = resample(&[key(1, 0.0, 0.0), key(4, 3.0, 0.0)], 5, Interpolation::Linear);
        assert_eq!((track.first_step, track.states.len()), (5, 16));
        assert_eq!((track.filled_gaps, track.filled_key_frames), (1, 2));
        assert!((track.states[5].position_m[0] - 1.0).abs() < 1e-12);
        assert!(track.states.iter().all(|s| (s.velocity_mps[0] - 2.0).abs() < 1e-12));
    }

    #[test]
    fn a_single_key_frame_stands_still() {
        let track = resample(&[key(2, 7.0, 1.0)], 5, Interpolation::Smooth);
        assert_eq!((track.first_step, track.states.len()), (10, 1));
        assert_eq!(track.states[0].velocity_mps, [0.0, 0.0]);
    }

    #[test]
    fn heading_crosses_the_seam_the_short_way() {
        let track = resample(&[key(0, 0.0, 3.1), key(1, 1.0, -3.1)], 5, Interpolation::Linear);
        let headings: Vec<f64> = track.states.iter().map(|s| s.heading_rad).collect();
        assert!(headings.windows(2).all(|w| (0.0..0.02).contains(&(w[1] - w[0]))), "{headings:?}");
    }

    proptest! {
        #[test]
        fn both_ways_pass_through_the_key_frames_and_agree_on_uniform_motion(
            xs in proptest::collection::vec((-50.0_f64..50.0, -3.0_f64..3.0), 1..12),
            speed in -20.0_f64..20.0,
            steps in 1_usize..10,
        ) {
            let keys: Vec<Key> = xs.iter().enumerate().map(|(i, (x, yaw))| key(i, *x, *yaw)).collect();
            for way in [Interpolation::Linear, Interpolation::Smooth] {
                let track = resample(&keys, steps, way);
                prop_assert_eq!(track.states.len(), (keys.len() - 1) * steps + 1);
                for (i, k) in keys.iter().enumerate() {
                    let state = track.states[i * steps];
                    prop_assert!((state.position_m[0] - k.x_m).abs() < 1e-9);
                    prop_assert!(((state.heading_rad - k.yaw_rad) / TAU).fract().abs().min(
                        1.0 - ((state.heading_rad - k.yaw_rad) / TAU).fract().abs()) < 1e-9);
                    prop_assert!((state.velocity_mps[0] - key_velocities(&keys)[i][0]).abs() < 1e-9);
                }
            }
            let uniform: Vec<Key> = (0..4).map(|i| key(i, speed * 0.5 * i as f64, 0.3)).collect();
            let (a, b) = (resample(&uniform, steps, Interpolation::Linear), resample(&uniform, steps, Interpolation::Smooth));
            for (a, b) in a.states.iter().zip(&b.states) {
                prop_assert!((a.position_m[0] - b.position_m[0]).abs() < 1e-9);
                prop_assert!((a.velocity_mps[0] - b.velocity_mps[0]).abs() < 1e-9);
            }
        }
    }
}
