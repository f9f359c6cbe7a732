//! The loss of SimNet.

use crate::losses::plan_loss;
use crate::plan_model::{Imitates, TorchKind, TrainingStep, proposing};
use crate::plan_space::PlanSpace;
use crate::tape::{self, Parameters, Tape};
use crate::torch::Torch;
use ccdiff_nets::networks::planner::Weighted;
use ccdiff_nets::networks::simnet::Simnet;
use tch::{Kind, Tensor};

/// SimNet.
pub(crate) const SIMNET: TorchKind =
    TorchKind { name: "simnet", build: proposing::<Simnet<Torch>>, fast: |settings| settings };

impl Imitates for Simnet<Torch> {
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        distance(space, step, self.plan(step.batch))
    }

    fn learn(&self, space: &PlanSpace, step: &TrainingStep<'_>, parameters: &Parameters) -> Option<f64> {
        let network = Simnet::<Tape>::new(&parameters.root(), space.config());
        let size = [step.batch.num_rows(), 2 * space.config().num_knots() as i64];
        Some(tape::learnt(|| distance(space, step, tape::leaf(&network.plan(step.batch), &size))))
    }
}

fn distance(space: &PlanSpace, step: &TrainingStep<'_>, knots: Tensor) -> Tensor {
    let rows = step.batch.num_rows();
    let share = || Tensor::ones([rows], (Kind::Float, knots.device()));
    let weight = step.config.collision_weight;
    plan_loss(space, &knots.view([rows, -1, 2]), step.batch, step.targets, weight, share)
}
