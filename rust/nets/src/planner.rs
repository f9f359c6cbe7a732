//! What plans are drawn from, and how.

use crate::config::ModelConfig;
use crate::error::Result;
use crate::features::SceneFeatures;
use crate::guidance::{Guidance, GuidanceConfig};
use crate::sampler::SampleOptions;
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
}

impl PlanOptions {
    /// Knots of a plan that are executed before the next one is made.
    pub fn executed_tokens(&self, config: &ModelConfig) -> usize {
        let executed = self.guidance.as_ref().and_then(|g| g.executed_steps);
        executed
            .map_or(config.num_knots(), |steps| steps.div_ceil(config.knot_stride))
            .min(config.num_knots())
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
pub trait Planner: Debug + Send {
    /// Most worlds that share a batch: fixed, so that plans do not depend on the number of threads. More are hardly faster, fewer
    /// leave no thread without work.
    fn most_worlds(&self) -> usize {
        8
    }

    /// Draws plans for all agents of all scenes; at least one has an agent. `seeds` holds one seed per scene; `guide` moves
    /// the plans on the way.
    ///
    /// # Errors
    /// What sampling and the network's library refuse.
    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn>;
}
