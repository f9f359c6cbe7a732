//! The loss of SimNet.

use crate::losses::plan_loss;
use crate::plan_model::{Learns, TorchKind, TrainingStep, on_tape};
use crate::plan_space::PlanSpace;
use crate::tape::Tape;
use crate::torch::Torch;
use crate::trains::Trains;
use ccdiff_nets::networks::simnet::Simnet;
use tch::{Kind, Tensor};

/// SimNet.
pub(crate) const SIMNET: TorchKind =
    TorchKind { name: "simnet", build: on_tape::<Simnet<Torch>, Simnet<Tape>>, fast: |settings| settings };

impl<B: Trains> Learns<B> for Simnet<B> {
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let rows = step.batch.num_rows() as i64;
        let knots = B::leaf(&self.plan(step.batch), &[rows, -1, 2]);
        let share = || Tensor::ones([rows], (Kind::Float, knots.device()));
        plan_loss(space, &knots, step.batch, step.targets, step.config.collision_weight, share)
    }
}
