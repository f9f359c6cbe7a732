//! Guidance of networks that plan from latents: descent in the latents (rivals.md#guidance).
//!
//! Objectives know plans as numbers, so their gradient g with respect to the knots is taken as a constant of each step:
//! the gradient of g · x(z) with respect to z is then exact.

use super::distributions::Gaussian;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::sampler::to_vec;
use tch::{Kind, Tensor};

const BETA: (f64, f64) = (0.9, 0.999);
/// Largest norm of a row's gradient: those through 52 steps of the unicycle grow with time.
const CLIP_NORM: f64 = 10.0;

/// Gradient [N · R, D] of an objective, known by its gradient with respect to the knots, and of the distance from a prior
/// with its weight [N · R, 1].
fn gradient(
    z: &Tensor,
    prior: Option<(&Gaussian, &Tensor)>,
    of_knots: &dyn Fn(&[f32]) -> Result<Vec<f32>>,
    decode: &dyn Fn(&Tensor) -> Tensor,
) -> Result<Tensor> {
    tch::with_grad(|| {
        let leaf = z.detach().copy().set_requires_grad(true);
        let knots = decode(&leaf);
        let fixed = of_knots(&to_vec(&knots.detach()))?;
        let fixed = Tensor::from_slice(&fixed).view_as(&knots).to_device(z.device());
        let mut total = (&knots * fixed).sum(Kind::Float);
        if let Some((prior, share)) = prior {
            let off = (&leaf - &prior.mean) / prior.std();
            total += (off.square() * share).sum(Kind::Float) * 0.5;
        }
        total.backward();
        Ok(leaf.grad())
    })
}

/// Latents [N · R, D] that guidance prefers to `start`, found by Adam; rows that are not guided keep their bits. With a
/// prior, ½‖(z − μ)/σ‖², mean over the agents of a world, is minimised as well.
pub(super) fn descended(
    start: &Tensor,
    prior: Option<&Gaussian>,
    guide: &Guidance<'_>,
    decode: &dyn Fn(&Tensor) -> Tensor,
) -> Result<Tensor> {
    let column = |v: Vec<f32>| Tensor::from_slice(&v).unsqueeze(1).to_device(start.device());
    let (guidance_scale, share) = (column(guide.guidance_scales()), column(guide.shares()));
    let guided = guidance_scale.gt(0.0);
    let (mut z, mut first, mut second) = (start.copy(), start.zeros_like(), start.zeros_like());
    let config = guide.config();
    for step in 1..=config.gradient_steps as i32 {
        let gradient = gradient(&z, prior.map(|p| (p, &share)), &|knots| guide.gradient(knots), decode)?;
        let norm = gradient.square().sum_dim_intlist([1i64].as_slice(), true, Kind::Float).sqrt();
        let gradient = gradient * (CLIP_NORM / norm.clamp_min(CLIP_NORM));
        let gradient = gradient.where_self(&guided, &start.zeros_like());
        first = first * BETA.0 + &gradient * (1.0 - BETA.0);
        second = second * BETA.1 + gradient.square() * (1.0 - BETA.1);
        let (unbias_1, unbias_2) = (1.0 - BETA.0.powi(step), 1.0 - BETA.1.powi(step));
        let change = (&first / unbias_1) / ((&second / unbias_2).sqrt() + 1e-8);
        z -= change * f64::from(config.learning_rate);
    }
    Ok((start + guidance_scale * (z - start)).where_self(&guided, start))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ModelConfig;
    use crate::guidance::{AgentCollision, Approach, GuidanceConfig, GuidanceContext, Objective};
    use ccdiff_sim::geom::Pose2;
    use tch::Device;

    fn standard(rows: i64, latent: i64) -> Gaussian {
        Gaussian::standard(rows, latent, Device::Cpu)
    }

    #[test]
    fn the_gradient_is_that_of_the_objective_through_the_decoder_and_of_the_prior() {
        // tabulated in float64: x = W z, gradient W^T g + z / M
        let w = Tensor::from_slice(&[1f32, 2.0, 0.5, -1.0, 0.0, 0.25]).view([3, 2]);
        let z = Tensor::from_slice(&[0.3f32, -0.2]).view([1, 2]);
        let share = Tensor::from_slice(&[0.25f32]).view([1, 1]);
        let found = gradient(&z, Some((&standard(1, 2), &share)), &|_| Ok(vec![-1.0, 0.5, 2.0]), &|z| {
            z.matmul(&w.transpose(0, 1))
        })
        .unwrap();
        assert!((found.double_value(&[0, 0]) + 0.675).abs() < 1e-6, "{found:?}");
        assert!((found.double_value(&[0, 1]) + 2.05).abs() < 1e-6, "{found:?}");
    }

    /// A car, and one 12 m ahead in the next lane, both at 8 m/s; the first is guided.
    fn pair(model: &ModelConfig) -> GuidanceContext<'static> {
        GuidanceContext {
            num_steps: model.horizon_steps,
            dt_s: model.dt_s as f32,
            poses: vec![Pose2::new(0.0, 0.0, 0.0), Pose2::new(12.0, 2.5, 0.0)],
            speed_mps: vec![8.0; 2],
            length_m: vec![4.5; 2],
            width_m: vec![2.0; 2],
            moving: vec![true; 2],
            guided: vec![true, false],
            guidance_scale: 1.0,
            partner: vec![true; 2],
            road: None,
            goals: vec![None; 2],
            target_speed_mps: vec![None; 2],
            speed_limit_mps: None,
            step_weights: vec![1.0 / 52.0; 52],
        }
    }

    fn descended_pair(weight: f32, prior: Option<&Gaussian>) -> (Tensor, Tensor) {
        let model = ModelConfig::of("strive", "fast").unwrap();
        let config = GuidanceConfig {
            objectives: vec![
                Objective::AgentCollision(AgentCollision { weight, ..AgentCollision::default() }),
                Objective::Approach(Approach { weight, ..Approach::default() }),
            ],
            gradient_steps: 60,
            learning_rate: 0.1,
            ..GuidanceConfig::rl()
        };
        let guide = Guidance::new(&config, &model, vec![Some(pair(&model))], &[2], 1, false).unwrap();
        let start = Tensor::from_slice(&[1f32, -0.5, 0.7, 0.2]).view([2, 2]);
        // two latents: all accelerations, all yaw rates
        let decode = |z: &Tensor| z.view([2, 1, 2]).expand([2, 13, 2], false) * 0.5;
        let end = descended(&start, prior, &guide, &decode).unwrap();
        (start, end)
    }

    #[test]
    fn rows_that_are_not_guided_keep_their_bits_and_a_prior_alone_draws_to_its_mean() {
        let (start, end) = descended_pair(-50.0, None);
        assert_eq!(start.get(1), end.get(1));
        assert!(!start.get(0).allclose(&end.get(0), 1e-3, 1e-3, false));
        let prior = standard(2, 2);
        let (start, end) = descended_pair(0.0, Some(&prior));
        assert_eq!(start.get(1), end.get(1));
        assert!(end.get(0).abs().max().double_value(&[]) < 0.15, "{end:?}");
    }
}
