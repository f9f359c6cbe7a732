//! Plans for the agents of many worlds at once: the network behind the background policy.

use crate::batch::Batch;
use crate::checkpoint;
use crate::config::{ModelConfig, ModelKind};
use crate::error::{ModelError, Result};
use crate::features::{self, SceneFeatures, Window, row_offsets};
use crate::grad::guarded;
use crate::guidance::{Clip, Guidance, GuidanceConfig, GuidanceContext, GuidanceReport, WorldGuidance};
use crate::optimiser::variables;
use crate::plan_model::{self, PlanModel};
use crate::raster::MapBitmap;
use crate::sampler::{SampleOptions, Samples, to_vec};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use tch::{Device, Kind, Tensor, nn};

/// What a model sees of one world.
#[derive(Debug, Clone, Copy)]
pub struct PlanInput<'a> {
    /// States of the world's vehicles over the last steps.
    pub window: &'a Window,
    /// The scene's map, drawn once by [`TrajectoryModel::bitmap`].
    pub bitmap: Option<&'a MapBitmap>,
    /// Seed of this world's noise for this plan: another one for every plan.
    pub seed: u64,
    /// Whose plans are guided and what guidance may know; `None`: nobody's. Used if the options hold a guidance.
    pub guide: Option<WorldGuidance<'a>>,
}

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
    /// The options as a kind of network takes them: what means nothing to it is refused, or not reported.
    ///
    /// Networks that do not denoise, or in one step alone, are guided at once on their plan, with as many gradient steps as
    /// the guided denoising steps of the default sampler take together.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the option.
    pub(crate) fn of_kind(mut self, kind: ModelKind) -> Result<Self> {
        if self.sampling.guidance_weight > 1.0 && kind != ModelKind::Ccdiff {
            let (got, expected) =
                (self.sampling.guidance_weight.to_string(), "1: it was not trained without its graph");
            return Err(ModelError::Config { field: "guidance_weight", got, expected });
        }
        if kind.denoises() && self.sampling.solver_steps != Some(1) {
            return Ok(self);
        }
        let default = SampleOptions::default().solver_steps;
        if !kind.denoises() && self.sampling.solver_steps != default {
            let (got, expected) =
                (format!("{:?}", self.sampling.solver_steps), "the default: this model does not denoise");
            return Err(ModelError::Config { field: "solver_steps", got, expected });
        }
        self.gradient_statistics &= kind.denoises();
        if let (Some(guidance), Some(steps)) = (&mut self.guidance, default) {
            guidance.gradient_steps *= steps - 1;
            guidance.clip = Clip::Sigma;
            guidance.clip_limit = guidance.learning_rate * guidance.gradient_steps.max(1) as f32;
        }
        Ok(self)
    }
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
    /// Losses, selected samples, realism cost, gradient statistics; `None` for a world without guidance.
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
            matrix[at / k * m + self.features.neighbours[at]] = *weight;
        }
        Some(matrix)
    }
}

/// A loaded network.
#[derive(Debug)]
pub struct TrajectoryModel {
    network: Box<dyn PlanModel>,
    header: serde_json::Value,
    store: nn::VarStore,
    device: Device,
    /// The network's configuration as features are built from it.
    inputs: ModelConfig,
}

impl TrajectoryModel {
    /// Loads a weight file, checking every name and shape.
    ///
    /// # Errors
    /// [`ModelError::Io`], [`ModelError::Checkpoint`], [`ModelError::Config`].
    pub fn load(path: &Path, device: Device) -> Result<Self> {
        guarded(false, "loading weights", || {
            let (header, tensors) = checkpoint::read(path)?;
            let config = checkpoint::field::<ModelConfig>(path, &header, "model")?.validated()?;
            let kind: String = checkpoint::field(path, &header, "kind")?;
            if kind != config.kind.name() {
                return Err(ModelError::Checkpoint {
                    path: path.to_path_buf(),
                    entry: "kind".into(),
                    got: format!("{kind:?}"),
                    expected: format!("weights of {:?}", config.kind.name()),
                });
            }
            let mut store = nn::VarStore::new(device);
            let network = plan_model::build(&store.root(), &config)?;
            store.freeze();
            checkpoint::fill(path, &tensors, "", &mut variables(&store))?;
            Ok(Self { network, header, store, device, inputs: config })
        })
    }

    /// The network.
    pub(crate) fn network(&self) -> &dyn PlanModel {
        self.network.as_ref()
    }

    /// All numbers of the network by name.
    pub(crate) fn variables(&self) -> BTreeMap<String, Tensor> {
        variables(&self.store)
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
        if !self.plans_in_one_step() || steps == Some(1) {
            return Ok(());
        }
        let expected = "1: these weights were taught to plan in one step";
        Err(ModelError::Config { field: "denoising_steps", got: format!("{steps:?}"), expected })
    }

    /// The network's configuration.
    pub fn config(&self) -> &ModelConfig {
        self.network.space().config()
    }

    /// The file's JSON header.
    pub fn header(&self) -> &serde_json::Value {
        &self.header
    }

    /// Replaces the thresholds of the graph G: infinite ones join all pairs.
    pub fn set_graph_thresholds(&mut self, ttc_s: f32, distance_m: f32) {
        self.inputs.ttc_threshold_s = ttc_s;
        self.inputs.distance_threshold_m = distance_m;
    }

    /// Numbers in the network.
    pub fn num_parameters(&self) -> usize {
        variables(&self.store).values().map(Tensor::numel).sum()
    }

    /// Draws a scene's map as this network wants it; `None` for a map-blind network.
    ///
    /// # Errors
    /// As [`MapBitmap::from_scene`].
    pub fn bitmap(&self, scene: &ccdiff_sim::scene::Scene) -> Result<Option<MapBitmap>> {
        self.config().map.as_ref().map(|m| MapBitmap::from_scene(scene, m)).transpose()
    }

    /// Plans for all agents of all worlds: one network pass per denoising step for all of them.
    ///
    /// # Errors
    /// [`ModelError::Shape`] for windows or guides of the wrong length, [`ModelError::Config`] for bad options.
    pub fn plan(&mut self, worlds: &[PlanInput<'_>], options: &PlanOptions) -> Result<Vec<Plan>> {
        let options = options.clone().validated()?.of_kind(self.config().kind)?;
        self.check_solver_steps(options.sampling.solver_steps)?;
        let config = self.network.space().config();
        let build = |w: &PlanInput<'_>| features::build(w.window, w.bitmap, &self.inputs);
        let built: Vec<SceneFeatures> = if worlds.len() < 4 {
            worlds.iter().map(build).collect::<Result<_>>()?
        } else {
            worlds.par_iter().map(build).collect::<Result<_>>()?
        };
        let sizes: Vec<usize> = built.iter().map(|f| f.agents.len()).collect();
        let n = options.sampling.num_samples;
        let mut guide = guide_of(worlds, &built, config, &options, &sizes)?;
        let drawn = if sizes.iter().all(|s| *s == 0) {
            Drawn::default()
        } else {
            let seeds: Vec<u64> = worlds.iter().map(|w| w.seed).collect();
            guarded(false, "planning", || self.draw(&built, &seeds, &options, guide.as_mut()))?
        };
        let mut reports = match &guide {
            Some(guide) => guide.report(&drawn.knots)?,
            None => vec![None; worlds.len()],
        };
        if !config.kind.denoises() {
            for report in reports.iter_mut().flatten() {
                report.realism_cost.fill(f32::NAN);
                report.shift_sigmas.fill(f32::NAN);
            }
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

    /// Samples plans for all rows.
    fn draw(
        &self,
        features: &[SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Drawn> {
        let (space, n) = (self.network.space(), options.sampling.num_samples as i64);
        let features: Vec<&SceneFeatures> = features.iter().collect();
        let batch = Batch::new(&features, space.config(), self.device)?;
        let Samples { knots, attention } = self.network.propose(&batch, seeds, options.sampling, guide)?;
        let attention = attention.filter(|_| options.attention).map(|attention| {
            let (config, size) = (space.config(), attention.size());
            let history = config.history_token_steps().len() as i64;
            let executed = options.guidance.as_ref().and_then(|g| g.executed_steps);
            let tokens = executed.map_or(config.num_knots(), |s| s.div_ceil(config.knot_stride));
            let tokens = tokens.min(config.num_knots()) as i64;
            let plan = attention.narrow(2, history, tokens).view([n, size[0] / n, size[1], tokens]);
            to_vec(&plan.mean_dim([0i64, 3].as_slice(), false, Kind::Float))
        });
        Ok(Drawn {
            actions: to_vec(&space.actions(&knots)),
            states: to_vec(&space.states(&knots, &batch.speed_mps.repeat([n]))),
            knots: to_vec(&knots),
            attention,
        })
    }
}

/// Plans of all rows as numbers, sample by sample; empty without rows.
#[derive(Debug, Default)]
struct Drawn {
    knots: Vec<f32>,
    actions: Vec<f32>,
    states: Vec<f32>,
    attention: Option<Vec<f32>>,
}

/// Guidance of the worlds that have a guide; `None` without a configuration or any guide.
fn guide_of<'a>(
    worlds: &[PlanInput<'a>],
    features: &[SceneFeatures],
    model: &ModelConfig,
    options: &'a PlanOptions,
    sizes: &[usize],
) -> Result<Option<Guidance<'a>>> {
    let Some(config) = options.guidance.as_ref().filter(|_| worlds.iter().any(|w| w.guide.is_some())) else {
        return Ok(None);
    };
    let context = |(world, features): (&PlanInput<'a>, &SceneFeatures)| {
        world.guide.map(|g| GuidanceContext::new(&g, world.window, features, model, config)).transpose()
    };
    let contexts = worlds.iter().zip(features).map(context).collect::<Result<Vec<_>>>()?;
    let samples = options.sampling.num_samples;
    Guidance::new(config, model, contexts, sizes, samples, options.gradient_statistics).map(Some)
}
