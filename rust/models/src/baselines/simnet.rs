//! SimNet: behaviour cloning, one plan by regression (rivals.md#simnet).
//!
//! Differs from the paper: the port has no hidden layer in its decoder and reads a raster of the agents; this one has
//! one, and reads states and edges.

use super::moved;
use crate::batch::Batch;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::layers::perceptron::Perceptron;
use crate::losses::plan_loss;
use crate::plan_model::{PlanModel, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::sampler::{SampleOptions, Samples};
use crate::trunk::Trunk;
use tch::{Kind, Tensor, nn};

/// Hidden width of the regression head.
pub(super) const HIDDEN: i64 = 128;

/// The regressor.
#[derive(Debug)]
pub struct Simnet {
    space: PlanSpace,
    trunk: Trunk,
    head: Perceptron,
}

impl Simnet {
    /// A network with fresh weights under a path.
    pub fn new(p: &nn::Path, config: &ModelConfig) -> Self {
        Self {
            space: PlanSpace::new(config, p.device()),
            trunk: Trunk::new(&(p / "trunk"), config),
            head: Perceptron::new(&(p / "head"), &[config.width + 1, HIDDEN, 2 * config.num_knots() as i64]),
        }
    }

    fn plan(&self, batch: &Batch, train: bool) -> Tensor {
        let state = self.trunk.forward(batch, train).state;
        self.head.forward(&state).view([batch.num_rows(), -1, 2])
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
