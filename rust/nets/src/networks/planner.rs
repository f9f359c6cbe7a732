//! What plans are drawn from, and how.

use crate::compute::backend::Backend;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::{GuidanceConfig, Guide};
use crate::inputs::features::SceneFeatures;
pub use crate::sampling::sampler::Asked;
use crate::sampling::sampler::{Rows, SampleOptions};
use std::fmt::Debug;

/// How plans are drawn.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlanOptions {
    /// The reverse process.
    pub sampling: SampleOptions,
    /// Guidance of the worlds that have a guide; `None`: of none.
    pub guidance: Option<GuidanceConfig>,
    /// Whether plans come with the attention between agents.
    pub attention: bool,
    /// Whether guided plans come with the statistics of gradients, at the cost of one gradient per objective and step.
    pub gradient_statistics: bool,
}

impl From<SampleOptions> for PlanOptions {
    /// Unguided.
    fn from(sampling: SampleOptions) -> Self {
        Self { sampling, ..Self::default() }
    }
}

impl PlanOptions {
    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn validated(self) -> Result<Self> {
        let sampling = self.sampling.validated()?;
        let guidance = self.guidance.map(GuidanceConfig::validated).transpose()?;
        Ok(Self { sampling, guidance, ..self })
    }

    /// What is asked of a network for rows, with one seed per scene.
    pub fn asked<'a>(&self, rows: Rows<'a>, seeds: &'a [u64], config: &ModelConfig) -> Asked<'a> {
        let (knots, stride) = (config.num_knots(), config.knot_stride);
        let executed = self.guidance.as_ref().and_then(|g| g.executed_steps);
        let executed = executed.map_or(knots, |steps| steps.div_ceil(stride).min(knots));
        Asked { rows, seeds, options: self.sampling, attention: self.attention.then_some(executed) }
    }
}

/// Plans of all rows as numbers, sample by sample; empty without rows.
#[derive(Debug, Default)]
pub struct Drawn {
    /// Clean normalised knots [N · R, knots, 2].
    pub knots: Vec<f32>,
    /// Physical actions [N · R, T, 2].
    pub actions: Vec<f32>,
    /// States [N · R, T, 6].
    pub states: Vec<f32>,
    /// Mean attention of the plans' executed tokens [R, K], if asked for and there is any.
    pub attention: Option<Vec<f32>>,
}

/// A network as plans are drawn from it.
pub trait PlanSampler: Debug + Send {
    /// Most worlds that share a batch: fixed, so that plans do not depend on the number of threads. More are hardly faster, fewer
    /// leave no thread without work. Two leave a layer's numbers in the cache of a processor.
    fn most_worlds(&self) -> usize {
        2
    }

    /// Draws plans for all agents of all scenes; at least one has an agent. `seeds` holds one seed per scene; `guide` moves
    /// the plans on the way.
    fn draw(
        &self,
        scenes: &[SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Guide<'_, '_>,
    ) -> Result<Drawn>;
}

/// Normalised knots [N · R, knots, 2], sample by sample, and attention [R, K] between the agents, if it is asked for and there is any.
pub type Proposed = (Vec<f32>, Option<Vec<f32>>);

/// A network that plans, on any backend.
pub trait Proposes<B: Backend>: Debug + Sized {
    /// The network with its weights under a path.
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self;

    /// The configuration.
    fn config(&self) -> &ModelConfig;

    /// Draws plans; `guide` moves them, or has agents choose.
    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed>;
}

/// A network from noisy plans to clean ones, which plans within a `Denoising`.
pub trait Denoises<B: Backend>: Debug + Sized {
    /// What does not depend on the noisy plan: computed once per plan, used in every denoising step.
    type Context;

    /// The network with its weights under a path.
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self;

    /// The configuration.
    fn config(&self) -> &ModelConfig;

    /// Encodes a batch.
    fn encode(&self, batch: &B::Batch<'_>) -> Self::Context;

    /// The rows in the slots of each row, for a network whose plans attend to each other.
    fn slots(_: &Self::Context) -> Option<&B::Slots> {
        None
    }

    /// Predicts clean knots [R, knots, 2] from noisy ones at the rows' diffusion steps, one for all or one for each, with the attention between agents of a network that has it.
    fn predict(
        &self,
        context: &Self::Context,
        noisy: &B::Tensor,
        steps: &[usize],
    ) -> (B::Tensor, Option<B::Attention>);
}
