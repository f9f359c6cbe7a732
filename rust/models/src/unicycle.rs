//! The unicycle as tensors (reference.md#unicycle).
//!
//! This is the rollout of a *plan*: the cumulative sum of accelerations is clipped ("parallel" mode), which differs
//! from integrating step by step once a bound is hit.

use ccdiff_nets::inputs::unicycle::plan_limits;
use ccdiff_sim::dynamics::UnicycleLimits;
use tch::{Kind, Tensor};

/// Rolls actions out from the origin, heading +x.
///
/// # Shapes
/// `actions` [R, T, 2] (m/s², rad/s), `speed_mps` [R] → states [R, T, 6]: x, y, v, yaw, acceleration, yaw rate. The last
/// two are the actions as given, not clipped. Differentiable; the yaw-rate bound has no gradient.
pub fn rollout(actions: &Tensor, speed_mps: &Tensor, dt_s: f64) -> Tensor {
    let limits = plan_limits();
    let (slowest, fastest) = limits.speed_mps.map(f64::from).into();
    let (hardest, strongest) = limits.acceleration_mps2.map(f64::from).into();
    let (acceleration, yaw_rate) = (actions.select(2, 0), actions.select(2, 1));
    let gained = (acceleration.clamp(hardest, strongest) * dt_s).cumsum(1, Kind::Float);
    let start = speed_mps.unsqueeze(1);
    let after = (&gained + &start).clamp(slowest, fastest);
    let steps = after.size()[1];
    let before = Tensor::cat(&[start, after.narrow(1, 0, steps - 1)], 1);
    let pace = before.detach().abs();
    let by_curvature = &pace * f64::from(limits.max_curvature_1pm);
    let slow = pace.clamp_min(f64::from(UnicycleLimits::LEAST_PACE_MPS));
    let by_lateral = slow.reciprocal() * f64::from(limits.max_lateral_acceleration_mps2);
    let bound = by_curvature.minimum(&by_lateral).clamp_min(f64::from(limits.min_yaw_rate_radps));
    let turned = yaw_rate.minimum(&bound).maximum(&bound.neg()) * dt_s;
    let yaw_after = turned.cumsum(1, Kind::Float);
    let yaw_before = &yaw_after - &turned;
    let step_m = (&before + &after) * (0.5 * dt_s);
    let x = (&step_m * yaw_before.cos()).cumsum(1, Kind::Float);
    let y = (&step_m * yaw_before.sin()).cumsum(1, Kind::Float);
    Tensor::stack(&[&x, &y, &after, &yaw_after, &acceleration, &yaw_rate], 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ccdiff_nets::inputs::unicycle::states_of_poses;

    fn roll(speed: f32, actions: &[[f32; 2]]) -> Vec<f32> {
        let flat: Vec<f32> = actions.iter().flatten().copied().collect();
        let states = rollout(
            &Tensor::from_slice(&flat).view([1, actions.len() as i64, 2]),
            &Tensor::from_slice(&[speed]),
            0.1,
        );
        Vec::<f32>::try_from(states.view([-1])).unwrap()
    }

    fn check(speed: f32, actions: &[[f32; 2]], want: &[[f32; 4]]) {
        let got = roll(speed, actions);
        for (t, w) in want.iter().enumerate() {
            for c in 0..4 {
                let v = got[t * 6 + c];
                assert!((v - w[c]).abs() < 2e-5, "step {t} component {c}: got {v}, want {}", w[c]);
            }
            assert_eq!(got[t * 6 + 4..t * 6 + 6], actions[t]);
        }
    }

    #[test]
    fn the_rollout_reproduces_the_tabulated_states() {
        check(
            5.0,
            &[[2.0, 0.1], [2.0, 0.3], [-12.0, 0.3], [0.0, 5.0], [1.0, -1.0]],
            &[
                [0.51, 0.0, 5.2, 0.01],
                [1.039974, 0.0053, 5.4, 0.04],
                [1.529582, 0.024895, 4.4, 0.07],
                [1.968504, 0.05567, 4.4, 0.2128],
                [2.403466, 0.149652, 4.5, 0.1128],
            ],
        );
        check(
            0.0,
            &[[9.0, 0.5], [9.0, 0.5], [0.0, 0.01]],
            &[[0.04, 0.0, 0.8, 0.01], [0.159994, 0.0012, 1.6, 0.05], [0.319794, 0.009197, 1.6, 0.051]],
        );
    }

    #[test]
    fn speed_leaves_its_bound_as_the_cumulative_sum_does() {
        let got = roll(29.5, &[[8.0, 0.0], [8.0, 0.0], [-8.0, 0.0]]);
        assert!((got[2] - 30.0).abs() < 1e-5 && (got[8] - 30.0).abs() < 1e-5);
        // 29.5 + 0.8 + 0.8 - 0.8 = 30.3 is still clipped, where step-by-step integration would give 29.2
        assert!((got[14] - 30.0).abs() < 1e-5);
    }

    #[test]
    fn actions_of_a_rolled_out_path_are_recovered() {
        let actions: Vec<[f32; 2]> =
            (0..52).map(|t| [(t as f32 * 0.2).sin(), 0.1 * (t as f32 * 0.1).cos()]).collect();
        let rolled = roll(6.0, &actions);
        let poses: Vec<[f32; 3]> = rolled.chunks(6).map(|s| [s[0], s[1], s[3]]).collect();
        let states = states_of_poses(&poses, 6.0, 0.1);
        for (t, state) in states.iter().enumerate() {
            // the chord's speed lies half a step behind
            assert!((state[2] - rolled[t * 6 + 2]).abs() < 0.1, "speed at {t}");
            assert!((state[5] - actions[t][1]).abs() < 1e-3, "yaw rate at {t}");
        }
    }
}
