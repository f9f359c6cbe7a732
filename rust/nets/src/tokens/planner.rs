//! Tokens on the kernels of this crate.

use super::{NEAR, NEAR_NUMBERS, Network, Now, drawn};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::features::SceneFeatures;
use crate::guidance::Guidance;
use crate::own::{Array, Own, Place};
use crate::plan_space::PlanSpace;
use crate::planner::{Drawn, PlanOptions, Planner};
use crate::sampler::Rows;
use crate::segments::{NUM_SEGMENTS, SEGMENT_FEATURES};
use crate::weights::{Entry, Weights};
use std::collections::BTreeMap;
use std::path::Path;

/// A network with the space of its plans.
#[derive(Debug)]
struct TokenPlanner {
    network: Network<Own>,
    space: PlanSpace,
    config: ModelConfig,
}

/// The network with the tensors of a file.
///
/// # Errors
/// [`crate::ModelError::Checkpoint`] where a tensor does not fit.
pub(crate) fn made(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn Planner>> {
    let weights = Weights::new(path, tensors);
    let network = Network::new(&Place::root(&weights), config);
    weights.finish()?;
    Ok(Box::new(TokenPlanner { network, space: PlanSpace::new(config), config: config.clone() }))
}

/// Numbers of the rows of all scenes.
fn joined(scenes: &[&SceneFeatures], of: impl Fn(&SceneFeatures) -> &[f32]) -> Vec<f32> {
    scenes.iter().flat_map(|s| of(s)).copied().collect()
}

impl Planner for TokenPlanner {
    fn draw(
        &self,
        scenes: &[&SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let scene_sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        let noise_seeds: Vec<Option<u64>> =
            scenes.iter().flat_map(|s| s.noise_seed.iter().copied()).collect();
        let rows = Rows { scene_sizes: &scene_sizes, noise_seeds: &noise_seeds };
        let own = joined(scenes, |s| &s.tokens.own);
        let own = Array::new(1, own.len() / rows.count().max(1), own);
        let near = Array::new(NEAR, NEAR_NUMBERS, joined(scenes, |s| &s.tokens.near));
        let lines = Array::new(NUM_SEGMENTS, SEGMENT_FEATURES, joined(scenes, |s| &s.segments));
        let logits = self.network.logits(&own, &near, &lines).into_numbers();
        let speed_mps = joined(scenes, |s| &s.speed_mps);
        let yaw_rate_radps = joined(scenes, |s| &s.tokens.yaw_rate_radps);
        let now = Now { speed_mps: &speed_mps, yaw_rate_radps: &yaw_rate_radps };
        let knots = drawn(&logits, now, rows, seeds, options.sampling, &self.config, guide)?;
        let actions = self.space.actions(&knots);
        Ok(Drawn { states: self.space.states(&actions, &speed_mps), actions, knots, attention: None })
    }
}
