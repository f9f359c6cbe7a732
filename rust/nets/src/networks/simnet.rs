//! SimNet: behaviour cloning, one plan by regression (rivals.md#simnet).
//!
//! Differs from the paper: the port has no hidden layer in its decoder and reads a raster of the agents; this one has
//! one, and reads states and edges.

use crate::compute::backend::Backend;
use crate::compute::cpu::Cpu;
use crate::compute::layers::perceptron::Perceptron;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guide;
use crate::networks::cpu_planner::on_cpu;
use crate::networks::kind::NetworkKind;
use crate::networks::planner::{Asked, Proposed, Proposes};
use crate::networks::trunk::Trunk;

/// One plan per agent by regression.
pub const SIMNET: NetworkKind =
    NetworkKind { one_plan: true, ..NetworkKind::with_trunk("simnet", "SimNet", on_cpu::<Simnet<Cpu>>) };

/// Hidden width of the regression head.
pub const HIDDEN: i64 = 128;

/// The regressor.
#[derive(Debug)]
pub struct Simnet<B: Backend> {
    trunk: Trunk<B>,
    head: Perceptron<B>,
}

impl<B: Backend> Simnet<B> {
    /// Normalised knots of the plans, those of an agent side by side, [R, 1, 2 · knots].
    pub fn plan(&self, batch: &B::Batch<'_>) -> B::Tensor {
        self.head.forward(&self.trunk.forward(batch).state)
    }
}

impl<B: Backend> Proposes<B> for Simnet<B> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let widths = [config.width + 1, HIDDEN, 2 * config.num_knots() as i64];
        Self {
            trunk: Trunk::new(&B::sub(p, "trunk"), config),
            head: Perceptron::new(&B::sub(p, "head"), &widths),
        }
    }

    fn config(&self) -> &ModelConfig {
        self.trunk.config()
    }

    /// The one plan, N times.
    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        let mut knots = B::numbers(&self.plan(batch)).repeat(asked.options.num_samples);
        if let Some(guide) = guide {
            guide.adjust_finished(&mut knots);
        }
        Ok((knots, None))
    }
}
