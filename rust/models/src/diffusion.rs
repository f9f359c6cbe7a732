//! The loss of denoising networks.

use crate::batch::{Batch, Targets};
use crate::losses::{logged_actions, plan_loss, trajectory_loss};
use crate::plan_model::{Learns, Taught, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::torch::{Torch, tensor, to_vec};
use ccdiff_nets::compute::numbers::Array;
use ccdiff_nets::networks::denoising::Denoising;
use ccdiff_nets::networks::planner::Denoises;
use tch::{Kind, Tensor};

/// Clean knots of noisy ones [R, knots, 2] at the rows' diffusion steps.
fn predicted(network: &impl Denoises<Torch>, batch: &Batch, noisy: &Tensor, steps: &[usize]) -> Tensor {
    let knots = tensor(Array::new(network.config().num_knots(), 2, to_vec(noisy)), batch.device);
    network.predict(&network.encode(batch), &knots, steps).0.view(noisy.size().as_slice())
}

impl<N: Denoises<Torch>> Learns for Denoising<N> {
    /// The loss of the plan predicted from the noised log, each scene at a diffusion step of its own, with G replaced by
    /// the identity in some scenes; with a teacher, the distance from its plans.
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        if let Some(taught) = step.taught {
            return distillation_loss(self, space, step.batch, taught);
        }
        let (batch, targets, device) = (step.batch, step.targets, step.batch.device);
        let (of_step, of_drop) = (step.draw(0), step.draw(1));
        let scenes = batch.scene_sizes.iter().zip(0u64..);
        let k = |scene| of_step.below(scene, self.schedule.num_steps() as u64) as usize;
        let k: Vec<usize> = scenes.flat_map(|(size, s)| std::iter::repeat_n(k(s), *size)).collect();
        let drops = |scene: usize| of_drop.uniform(scene as u64) < step.config.drop_graph;
        let batch = batch.clone().with_graph_dropped(drops);

        let clean = space.knots_of(&logged_actions(targets));
        let numbers = step.draw(2).normals(clean.numel());
        let noise = Tensor::from_slice(&numbers).view_as(&clean).to_device(device);
        let of_noise = |f: &dyn Fn(f64) -> f64| {
            let values: Vec<f32> = k.iter().map(|k| f(self.schedule.alpha_bar[*k]) as f32).collect();
            Tensor::from_slice(&values).view([-1, 1, 1]).to_device(device)
        };
        let noisy = &clean * of_noise(&f64::sqrt) + noise * of_noise(&|a| (1.0 - a).sqrt());

        let knots = predicted(&self.network, &batch, &noisy, &k);
        let share = || of_noise(&f64::sqrt).flatten(0, 2);
        plan_loss(space, &knots, &batch, targets, step.config.collision_weight, share)
    }
}

/// The distance of the plan made of the first noise in one step from the one that the teacher makes of it.
fn distillation_loss(
    student: &Denoising<impl Denoises<Torch>>,
    space: &PlanSpace,
    batch: &Batch,
    taught: &Taught,
) -> Tensor {
    let last = student.schedule.num_steps();
    let numbers = batch.rows().noise(&taught.seeds, last as u64, 1, space.config().num_knots() * 2);
    let noise = Tensor::from_slice(&numbers).view_as(&taught.knots).to_device(batch.device);
    let predicted = predicted(&student.network, batch, &noise, &vec![last - 1; batch.num_rows()]);
    let speed_mps = batch.speed_mps();
    let states = space.states(&taught.knots, &speed_mps);
    let targets = Targets { valid: states.select(2, 0).ones_like(), states };
    trajectory_loss(space, &space.states(&predicted, &speed_mps), &targets, &targets.valid)
        + (predicted - &taught.knots).square().mean(Kind::Float)
}
