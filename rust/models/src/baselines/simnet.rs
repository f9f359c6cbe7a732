//! SimNet on libtorch: its loss and its proposals.

use super::moved;
use crate::batch::Batch;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::losses::plan_loss;
use crate::plan_model::{PlanModel, TorchKind, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::sampler::{SampleOptions, Samples};
use crate::torch::Torch;
use tch::{Kind, Tensor, nn};

/// SimNet.
pub(crate) const SIMNET: TorchKind = TorchKind {
    name: "simnet",
    build: |p, config| Ok(Box::new(Simnet::new(p, config))),
    fast: |settings| settings,
};

/// The regressor.
#[derive(Debug)]
pub struct Simnet {
    space: PlanSpace,
    network: ccdiff_nets::simnet::Simnet<Torch>,
}

impl Simnet {
    /// A network with fresh weights under a path.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        let network = ccdiff_nets::simnet::Simnet::new(p, config);
        Self { space: PlanSpace::new(config, p.device()), network }
    }

    fn plan(&self, batch: &Batch, train: bool) -> Tensor {
        self.network.plan(batch, train).view([batch.num_rows(), -1, 2])
    }
}

impl PlanModel for Simnet {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        let knots = self.plan(step.batch, true);
        let share = || Tensor::ones([step.batch.num_rows()], (Kind::Float, knots.device()));
        let weight = step.config.collision_weight;
        plan_loss(&self.space, &knots, step.batch, step.targets, weight, share)
    }

    /// The one plan, N times.
    fn propose(
        &self,
        batch: &Batch,
        seeds: &[u64],
        options: SampleOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Samples> {
        batch.rows().check_seeds(seeds)?;
        let knots = self.plan(batch, false).repeat([options.num_samples as i64, 1, 1]);
        Ok(Samples { knots: moved(&knots, guide)?, attention: None })
    }
}
