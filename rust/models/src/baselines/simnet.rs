//! The loss of SimNet.

use crate::losses::plan_loss;
use crate::plan_model::{Imitates, TorchKind, TrainingStep, proposing};
use crate::plan_space::PlanSpace;
use crate::torch::Torch;
use ccdiff_nets::networks::simnet::Simnet;
use tch::{Kind, Tensor};

/// SimNet.
pub(crate) const SIMNET: TorchKind =
    TorchKind { name: "simnet", build: proposing::<Simnet<Torch>>, fast: |settings| settings };

impl Imitates for Simnet<Torch> {
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let rows = step.batch.num_rows();
        let knots = self.plan(step.batch, true).view([rows, -1, 2]);
        let share = || Tensor::ones([rows], (Kind::Float, knots.device()));
        plan_loss(space, &knots, step.batch, step.targets, step.config.collision_weight, share)
    }
}
