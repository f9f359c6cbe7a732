//! Networks as plans are drawn from them on the kernels of this crate.

use crate::compute::cpu::{Batch, Cpu, Place};
use crate::compute::weights::{Entry, Weights};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guide;
use crate::inputs::features::SceneFeatures;
use crate::networks::planner::{Drawn, PlanOptions, PlanSampler, Proposed, Proposes};
use crate::sampling::plan_space::PlanSpace;
use crate::sampling::sampler::Rows;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Debug)]
struct OnCpu<N> {
    network: N,
    space: PlanSpace,
}

/// A network with the tensors of a file.
///
/// # Errors
/// [`crate::ModelError::Checkpoint`] where a tensor does not fit.
pub fn on_cpu<N: Proposes<Cpu> + Send + 'static>(
    path: &Path,
    config: &ModelConfig,
    tensors: BTreeMap<String, Entry>,
) -> Result<Box<dyn PlanSampler>> {
    let weights = Weights::new(path, tensors);
    let network = N::new(&Place::root(&weights), config);
    weights.finish()?;
    Ok(Box::new(OnCpu { network, space: PlanSpace::new(config) }))
}

/// Plans of proposed knots.
pub fn drawn(space: &PlanSpace, scenes: &[SceneFeatures], (knots, attention): Proposed) -> Drawn {
    let actions = space.actions(&knots);
    let speed_mps: Vec<f32> = scenes.iter().flat_map(|s| s.speed_mps.iter().copied()).collect();
    Drawn { states: space.states(&actions, &speed_mps), actions, knots, attention }
}

impl<N: Proposes<Cpu> + Send> PlanSampler for OnCpu<N> {
    fn draw(
        &self,
        scenes: &[SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Guide<'_, '_>,
    ) -> Result<Drawn> {
        let scene_sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        let noise_seeds: Vec<_> = scenes.iter().flat_map(|s| s.noise_seed.iter().copied()).collect();
        let rows = Rows { scene_sizes: &scene_sizes, noise_seeds: &noise_seeds };
        let asked = options.asked(rows, seeds, self.network.config());
        let proposed = self.network.propose(&Batch { scenes, alone: false }, &asked, guide)?;
        Ok(drawn(&self.space, scenes, proposed))
    }
}
