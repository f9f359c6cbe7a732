//! The loss of SimNet.

use crate::losses::plan_loss;
use crate::plan_model::{Learns, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::torch::Torch;
use ccdiff_nets::networks::simnet::Simnet;
use tch::{Kind, Tensor};

impl Learns for Simnet<Torch> {
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let rows = step.batch.num_rows() as i64;
        let knots = self.plan(step.batch).view([rows, -1, 2]);
        let share = || Tensor::ones([rows], (Kind::Float, knots.device()));
        plan_loss(space, &knots, step.batch, step.targets, step.config.collision_weight, share)
    }
}
