//! What there is to know of a planning network, in one value that everything else reads.

use crate::compute::weights::Entry;
use crate::config::{HistoryTokens, ModelConfig, NeighbourOrder};
use crate::error::{Result, require};
use crate::guidance::Target;
use crate::inputs::features::{self, SceneFeatures, Window};
use crate::inputs::segments::MapLines;
use crate::networks::planner::{PlanOptions, PlanSampler};
use crate::sampling::sampler::SampleOptions;
use ccdiff_sim::drivers::Kind;
use std::collections::BTreeMap;
use std::path::Path;

/// Makes a network of this crate's kernels from the tensors of a file.
pub type MakeOnCpu = fn(&Path, &ModelConfig, BTreeMap<String, Entry>) -> Result<Box<dyn PlanSampler>>;

/// Builds the inputs of one scene, as [`features::build`].
pub type MakeFeatures = fn(&Window, Option<&MapLines>, &ModelConfig) -> Result<SceneFeatures>;

/// A kind of network: its file declares one, [`crate::networks::NETWORKS`] lists it.
#[derive(Debug, Clone, Copy)]
pub struct NetworkKind {
    /// The driver that it is, shown in the colour of CCDiff; its options are those of [`crate::traffic::DRIVERS`].
    pub kind: Kind,
    /// Its shipped weights: `"fast"`, and what else files are called by.
    pub weights: &'static [&'static str],
    /// Whether plans are denoised step by step.
    pub denoises: bool,
    /// Whether plans attend to each other, so that there is attention to tell of.
    pub attends: bool,
    /// Whether it has one plan, whatever the noise.
    pub one_plan: bool,
    /// Whether it sees the decision causal graph, and is trained without it as well.
    pub causal: bool,
    /// Whether it may know routes.
    pub routes: bool,
    /// Whether it reads agents by the trunk that rivals share.
    pub trunk: bool,
    /// Whether its loss asks where the road is.
    pub road: bool,
    /// Whether it draws tokens, of which guidance chooses some.
    pub samples_tokens: bool,
    /// Its sizes from those of a preset.
    pub sizes: fn(ModelConfig) -> ModelConfig,
    /// What else it asks of its sizes.
    pub fits: fn(&ModelConfig) -> Result<()>,
    /// How its inputs are built.
    pub features: MakeFeatures,
    /// How it is made without torch.
    pub on_cpu: MakeOnCpu,
}

fn by_distance(preset: ModelConfig) -> ModelConfig {
    ModelConfig { neighbour_order: NeighbourOrder::Distance, ..preset }
}

impl NetworkKind {
    /// A network with default capabilities: it sees neighbours by distance.
    pub const fn of(name: &'static str, title: &'static str, on_cpu: MakeOnCpu) -> Self {
        Self {
            kind: Kind { name, title, style: "ccdiff", options: None, always: false, make: None },
            weights: &["fast"],
            denoises: false,
            attends: false,
            one_plan: false,
            causal: false,
            routes: false,
            trunk: false,
            road: false,
            samples_tokens: false,
            sizes: by_distance,
            fits: |_| Ok(()),
            features: features::build,
            on_cpu,
        }
    }

    /// The same with the trunk that rivals share.
    pub const fn with_trunk(name: &'static str, title: &'static str, on_cpu: MakeOnCpu) -> Self {
        Self { trunk: true, ..Self::of(name, title, on_cpu) }
    }

    /// Checks that the network can have these sizes.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] names the field.
    pub fn check(&self, config: &ModelConfig) -> Result<()> {
        let fits = !self.trunk || config.history == HistoryTokens::Summary;
        let expected = "a summary, as in \"fast\", for this model";
        require(fits, "model.history", config.history.name(), expected)?;
        let (points, name) = (config.route_points_m.len(), self.kind.name);
        let (fits, got) = (self.routes || points == 0, format!("{points} points for {name}"));
        require(fits, "model.route_points_m", got, "none: this model knows no routes")?;
        (self.fits)(config)
    }

    /// How plans are drawn as this network takes it: what means nothing to it is refused, or not reported.
    ///
    /// Networks that do not denoise, or in one step alone, are guided on their finished plan.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] names the option.
    pub fn options(&self, mut options: PlanOptions) -> Result<PlanOptions> {
        let sampling = options.sampling;
        let (weight, temperature) = (sampling.guidance_weight, sampling.temperature);
        let fits = weight <= 1.0 || self.causal;
        require(fits, "guidance_weight", weight, "1: it was not trained without its graph")?;
        let fits = self.samples_tokens || self.denoises || temperature == 1.0;
        require(fits, "temperature", temperature, "1: this model neither denoises nor draws tokens")?;
        if self.samples_tokens {
            // a choice among draws
            if let Some(guidance) = &mut options.guidance {
                guidance.gradient_steps = 0;
            }
        }
        let default = SampleOptions::default().solver_steps;
        let (fits, got) =
            (self.denoises || sampling.solver_steps == default, format!("{:?}", sampling.solver_steps));
        require(fits, "solver_steps", got, "the default: this model does not denoise")?;
        options.gradient_statistics &= self.denoises;
        if !self.denoises || sampling.solver_steps == Some(1) {
            options.guidance.iter_mut().for_each(|guidance| guidance.target = Target::Finished);
        }
        Ok(options)
    }
}
