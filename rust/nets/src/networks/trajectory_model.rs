//! Plans for the agents of many worlds at once: the network behind planned traffic.

pub use crate::networks::planner::{Drawn, PlanOptions, PlanSampler};

use crate::compute::weights::File;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result, require};
use crate::guidance::{Guidance, GuidanceContext, GuidanceReport, WorldGuidance};
use crate::inputs::features::{SceneFeatures, Window, row_offsets};
use crate::inputs::segments::MapLines;
use crate::networks::kind::NetworkKind;
use crate::networks::kinds::{check_cpu, described};
use rayon::prelude::*;
use std::path::Path;

/// What a model sees of one world.
#[derive(Debug, Clone, Copy)]
pub struct PlanInput<'a> {
    /// States of the world's vehicles over the last steps.
    pub window: &'a Window,
    /// The scene's map, read once by [`TrajectoryModel::map`].
    pub map: Option<&'a MapLines>,
    /// Seed of this world's noise for this plan: another one for every plan.
    pub seed: u64,
    /// Guided agents and what guidance knows of the world; `None`: no guidance. Used if the options hold a guidance.
    pub guide: Option<WorldGuidance<'a>>,
}

/// Plans of the agents of one world.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Window rows that are planned for, [M].
    pub agents: Vec<usize>,
    /// Actions (m/s², rad/s), [N, M, T, 2].
    pub actions: Vec<f32>,
    /// States x, y, v, yaw, acceleration, yaw rate in each agent's own frame now, [N, M, T, 6].
    pub states: Vec<f32>,
    /// Samples N.
    pub num_samples: usize,
    /// Losses, selected samples, moves, gradient statistics; `None` for a world without guidance.
    pub guidance: Option<GuidanceReport>,
    /// Attention of agent i to the agents in its slots, [M, K] as in the features, if asked for: mean over heads, the
    /// plan's executed tokens and samples, first edge-aware layer, last denoising step.
    pub attention: Option<Vec<f32>>,
    /// Inputs the plan was made from: graph, times to contact, poses.
    pub features: SceneFeatures,
}

impl Plan {
    /// Sample to follow for each agent, [M]: the selected one, or the first where nothing was selected.
    pub fn selected_sample(&self) -> Vec<usize> {
        self.guidance.as_ref().map_or_else(|| vec![0; self.agents.len()], |g| g.selected_sample.clone())
    }

    /// Attention [M, M] of row i to column j, 0 outside of G; `None` if not asked for.
    pub fn attention_matrix(&self) -> Option<Vec<f32>> {
        let (m, k) = (self.agents.len(), self.features.num_slots);
        let slots = self.attention.as_ref()?;
        let mut matrix = vec![0.0; m * m];
        for (at, weight) in slots.iter().enumerate().filter(|(at, _)| self.features.is_edge[*at]) {
            let (row, of) = (at / k, self.features.neighbours[at]);
            matrix[row * m + of] = if self.features.graph.contains(row, of) { *weight } else { 0.0 };
        }
        Some(matrix)
    }
}

/// A loaded network.
#[derive(Debug)]
pub struct TrajectoryModel {
    planner: Box<dyn PlanSampler>,
    header: serde_json::Value,
    num_parameters: usize,
    config: ModelConfig,
    network: &'static NetworkKind,
}

impl TrajectoryModel {
    /// The network of a weight file, read or parsed, on the kernels of this crate; checks every name and shape.
    ///
    /// # Errors
    /// [`ModelError::Checkpoint`] names the path; [`ModelError::Config`] for a network that needs torch.
    pub fn new(path: &Path, (header, tensors): File) -> Result<Self> {
        let config = described(path, &header)?;
        let num_parameters = tensors.values().map(|(_, numbers)| numbers.len()).sum();
        check_cpu(&config)?;
        let planner = (config.network()?.on_cpu)(path, &config, tensors)?;
        Self::of(planner, header, config, num_parameters)
    }

    /// A network that plans are drawn from in whatever way.
    ///
    /// # Errors
    /// As [`ModelConfig::network`].
    pub fn of(
        planner: Box<dyn PlanSampler>,
        header: serde_json::Value,
        config: ModelConfig,
        num_parameters: usize,
    ) -> Result<Self> {
        let network = config.network()?;
        Ok(Self { planner, header, num_parameters, config, network })
    }

    /// What is known of the network.
    pub fn network(&self) -> &'static NetworkKind {
        self.network
    }

    /// What plans are drawn from.
    pub fn planner(&self) -> &dyn PlanSampler {
        self.planner.as_ref()
    }

    /// Whether the network was taught to plan in one denoising step.
    pub fn plans_in_one_step(&self) -> bool {
        self.header["training"]["teacher_steps"].as_u64().is_some_and(|steps| steps > 0)
    }

    /// Checks that a network of one denoising step is asked for one.
    ///
    /// # Errors
    /// [`ModelError::Config`] where it is asked for more.
    pub fn check_solver_steps(&self, steps: Option<usize>) -> Result<()> {
        let (fits, got) = (!self.plans_in_one_step() || steps == Some(1), format!("{steps:?}"));
        require(fits, "denoising_steps", got, "1: these weights were taught to plan in one step")
    }

    /// The network's configuration.
    pub fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// The file's JSON header.
    pub fn header(&self) -> &serde_json::Value {
        &self.header
    }

    /// Replaces the thresholds of the graph G: infinite ones join all pairs.
    pub fn set_graph_thresholds(&mut self, ttc_s: f32, distance_m: f32) {
        self.config.ttc_threshold_s = ttc_s;
        self.config.distance_threshold_m = distance_m;
    }

    /// Numbers in the network.
    pub fn num_parameters(&self) -> usize {
        self.num_parameters
    }

    /// A scene's map as this network reads it; `None` for a map-blind network.
    pub fn map(&self, scene: &ccdiff_sim::scene::Scene) -> Option<MapLines> {
        self.config().map.as_ref().map(|_| MapLines::from_scene(scene))
    }

    /// Plans for all agents of all worlds: one network pass per denoising step for all of them.
    ///
    /// # Errors
    /// [`ModelError::Shape`] for windows or guides of the wrong length, [`ModelError::Config`] for bad options.
    pub fn plan(&mut self, worlds: &[PlanInput<'_>], options: &PlanOptions) -> Result<Vec<Plan>> {
        let options = self.network.options(options.clone().validated()?)?;
        self.check_solver_steps(options.sampling.solver_steps)?;
        let config = &self.config;
        let build = |w: &PlanInput<'_>| (self.network.features)(w.window, w.map, config);
        let built: Vec<SceneFeatures> = if worlds.len() < 4 {
            worlds.iter().map(build).collect::<Result<_>>()?
        } else {
            worlds.par_iter().map(build).collect::<Result<_>>()?
        };
        let sizes: Vec<usize> = built.iter().map(|f| f.agents.len()).collect();
        let n = options.sampling.num_samples;
        let mut guide = guide_of(worlds, &built, config, &options, &sizes);
        let drawn = if sizes.iter().all(|s| *s == 0) {
            Drawn::default()
        } else {
            let seeds: Vec<u64> = worlds.iter().map(|w| w.seed).collect();
            self.planner.draw(&built, &seeds, &options, guide.as_mut())?
        };
        let reports = match &guide {
            Some(guide) => guide.report(&drawn.knots),
            None => vec![None; worlds.len()],
        };
        if let Some(failure) = guide.as_ref().and_then(Guidance::failure) {
            let (got, expected) = (failure.to_string(), "losses and a gradient");
            return Err(ModelError::Config { field: "guidance.objectives.call", got, expected });
        }
        let rows: usize = sizes.iter().sum();
        let steps = config.horizon_steps;
        let part = |all: &[f32], offset: usize, size: usize, width: usize| -> Vec<f32> {
            let samples = (0..n).map(|s| (s * rows + offset) * steps * width);
            samples.flat_map(|at| all[at..at + size * steps * width].iter().copied()).collect()
        };
        let worlds = built.into_iter().zip(row_offsets(&sizes)).zip(reports);
        Ok(worlds
            .map(|((features, offset), guidance)| Plan {
                actions: part(&drawn.actions, offset, features.agents.len(), 2),
                states: part(&drawn.states, offset, features.agents.len(), 6),
                agents: features.agents.clone(),
                num_samples: n,
                guidance,
                attention: drawn.attention.as_ref().map(|all| {
                    let width = all.len() / rows.max(1);
                    let row = |m: usize| &all[(offset + m) * width..][..features.num_slots];
                    (0..features.agents.len()).flat_map(|m| row(m).iter().copied()).collect()
                }),
                features,
            })
            .collect())
    }
}

/// Guidance of the worlds that have a guide; `None` without a configuration or any guide.
fn guide_of<'a>(
    worlds: &[PlanInput<'a>],
    features: &[SceneFeatures],
    model: &ModelConfig,
    options: &'a PlanOptions,
    sizes: &[usize],
) -> Option<Guidance<'a>> {
    let config = options.guidance.as_ref().filter(|_| worlds.iter().any(|w| w.guide.is_some()))?;
    let steps = (config.discount, config.seen_steps, config.least_target_mps);
    let context = |(world, features): (&PlanInput<'a>, &SceneFeatures)| {
        world.guide.map(|g| GuidanceContext::new(&g, world.window, features, model, steps))
    };
    let contexts = worlds.iter().zip(features).map(context).collect();
    let samples = options.sampling.num_samples;
    Some(Guidance::new(config, model, contexts, sizes, samples, options.gradient_statistics))
}
