//! Plans for the agents of many worlds at once: the network behind the background policy.

use crate::batch::{Batch, row_offsets};
use crate::ccdiff::Network;
use crate::checkpoint;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::features::{self, SceneFeatures, Window};
use crate::grad::guarded;
use crate::optimiser::variables;
use crate::raster::MapBitmap;
use crate::sampler::{self, SampleOptions};
use crate::schedule::Schedule;
use rayon::prelude::*;
use std::path::Path;
use tch::{Device, Tensor, nn};

/// What a planner is told about one world.
#[derive(Debug, Clone, Copy)]
pub struct WorldView<'a> {
    /// States of the world's vehicles over the last steps.
    pub window: &'a Window,
    /// The scene's map, drawn once by [`Planner::bitmap`].
    pub bitmap: Option<&'a MapBitmap>,
    /// Seed of this world's noise for this plan: another one for every plan.
    pub seed: u64,
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
    /// Inputs the plan was made from: graph, times to contact, poses.
    pub features: SceneFeatures,
}

/// A loaded network.
#[derive(Debug)]
pub struct Planner {
    network: Network,
    schedule: Schedule,
    header: serde_json::Value,
    store: nn::VarStore,
    device: Device,
    /// The network's configuration as features are built from it.
    inputs: ModelConfig,
}

impl Planner {
    /// Loads a weight file, checking every name and shape.
    ///
    /// # Errors
    /// [`ModelError::Io`], [`ModelError::Checkpoint`], [`ModelError::Config`].
    pub fn load(path: &Path, device: Device) -> Result<Self> {
        guarded(false, "loading weights", || {
            let (header, tensors) = checkpoint::read(path)?;
            let kind: String = checkpoint::field(path, &header, "kind")?;
            if kind != "ccdiff" {
                return Err(ModelError::Checkpoint {
                    path: path.to_path_buf(),
                    entry: "kind".into(),
                    got: format!("{kind:?}"),
                    expected: "\"ccdiff\"".into(),
                });
            }
            let config = checkpoint::field::<ModelConfig>(path, &header, "model")?.validated()?;
            let mut store = nn::VarStore::new(device);
            let network = Network::new(&store.root(), &config);
            store.freeze();
            checkpoint::fill(path, &tensors, "", &mut variables(&store))?;
            let schedule = Schedule::cosine(config.diffusion_steps)?;
            Ok(Self { network, schedule, header, store, device, inputs: config })
        })
    }

    /// The network's configuration.
    pub fn config(&self) -> &ModelConfig {
        self.network.config()
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
    pub fn bitmap(&self, scene: &ccdiff_sim::scene::Scene) -> Option<MapBitmap> {
        self.config().map.as_ref().map(|m| MapBitmap::from_scene(scene, m))
    }

    /// Plans for all agents of all worlds: one network pass per denoising step for all of them.
    ///
    /// # Errors
    /// [`ModelError::Shape`] for windows of the wrong length, [`ModelError::Config`] for bad options.
    pub fn plan(&mut self, worlds: &[WorldView<'_>], options: SampleOptions) -> Result<Vec<Plan>> {
        let config = self.network.config();
        let build = |w: &WorldView<'_>| features::build(w.window, w.bitmap, &self.inputs);
        let built: Vec<SceneFeatures> = if worlds.len() < 4 {
            worlds.iter().map(build).collect::<Result<_>>()?
        } else {
            worlds.par_iter().map(build).collect::<Result<_>>()?
        };
        let seeds: Vec<u64> = worlds.iter().map(|w| w.seed).collect();
        let sizes: Vec<usize> = built.iter().map(|f| f.agents.len()).collect();
        let rows: usize = sizes.iter().sum();
        let n = options.num_samples;
        let (actions, states) = if rows == 0 {
            (Vec::new(), Vec::new())
        } else {
            guarded(false, "planning", || {
                let features: Vec<&SceneFeatures> = built.iter().collect();
                let batch = Batch::new(&features, config, self.device)?;
                let net = &self.network;
                let knots = sampler::sample(net, &self.schedule, &batch, &seeds, options)?;
                let actions = net.actions(&knots);
                let states = net.states(&knots, &batch.speed_mps.repeat([n as i64]));
                Ok((to_vec(&actions), to_vec(&states)))
            })?
        };
        let steps = config.horizon_steps;
        let part = |all: &[f32], offset: usize, size: usize, width: usize| -> Vec<f32> {
            let samples = (0..n).map(|s| (s * rows + offset) * steps * width);
            samples.flat_map(|at| all[at..at + size * steps * width].iter().copied()).collect()
        };
        let worlds = built.into_iter().zip(row_offsets(&sizes));
        Ok(worlds
            .map(|(features, offset)| Plan {
                actions: part(&actions, offset, features.agents.len(), 2),
                states: part(&states, offset, features.agents.len(), 6),
                agents: features.agents.clone(),
                num_samples: n,
                features,
            })
            .collect())
    }
}

fn to_vec(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.to_device(Device::Cpu).contiguous();
    let count = flat.numel();
    let mut values = vec![0f32; count];
    flat.view([-1]).copy_data(&mut values, count);
    values
}
