//! Scenes' features joined into tensors: rows of all agents of all worlds, without padding between scenes.

use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::features::{EDGE_FEATURES, Futures, HISTORY_FEATURES, SceneFeatures, row_offsets};
use crate::segments::{NUM_SEGMENTS, SEGMENT_FEATURES};
use ccdiff_nets::inputs::features::TokenInputs;
use ccdiff_nets::inputs::tokens::{NEAR, NEAR_NUMBERS, near_columns, own_columns};
use ccdiff_nets::sampling::sampler::Rows;
use ccdiff_sim::geom::Region;
use std::sync::Arc;
use tch::{Device, Kind, Tensor};

/// Inputs of R agents of several scenes. Neighbour indices count rows of the batch.
#[derive(Debug)]
pub struct Batch {
    /// Agents of each scene, summing up to R.
    pub scene_sizes: Vec<usize>,
    /// Histories [R, H, 8].
    pub history: Tensor,
    /// Poses now, scene frame: x, y, heading [R, 3].
    pub poses: Tensor,
    /// Speeds now [R].
    pub speed_mps: Tensor,
    /// Rows of the agents in each slot [R, K], int64; slot 0 is the row itself.
    pub neighbours: Tensor,
    /// Whether a slot is an edge of G [R, K], bool.
    pub is_edge: Tensor,
    /// Edges [R, K, tokens, 9].
    pub edges: Tensor,
    /// Lines of the map [R, segments, numbers]; `None` for a map-blind network.
    pub lines: Option<Tensor>,
    /// The road of each scene, for a loss that asks for it; else empty.
    pub roads: Vec<Option<Arc<Region>>>,
    /// Routes ahead [R, 1 + 2 P], see [`SceneFeatures::route`]; `None` for a network that knows none.
    pub route: Option<Tensor>,
    /// Inputs of a network of tokens; empty for others.
    pub tokens: TokenBatch,
    /// Seed of each row's own noise, [R]; `None`: noise of the world's seed.
    pub noise_seeds: Vec<Option<u64>>,
}

/// Inputs of tokens, see [`TokenInputs`]; empty tensors for other networks.
#[derive(Debug, Default)]
pub struct TokenBatch {
    /// Own numbers [R, own].
    pub own: Tensor,
    /// Neighbours [R, near, numbers].
    pub near: Tensor,
    /// Yaw rates now, rad/s, [R].
    pub yaw_rate_radps: Vec<f32>,
    /// Whether motion is known now, [R].
    pub known: Vec<bool>,
}

impl TokenBatch {
    fn new(scenes: &[&SceneFeatures], device: Device) -> Self {
        let of = |part: fn(&TokenInputs) -> &Vec<f32>| -> Vec<f32> {
            scenes.iter().flat_map(|s| part(&s.tokens)).copied().collect()
        };
        let yaw_rate_radps = of(|t| &t.yaw_rate_radps);
        let rows = yaw_rate_radps.len() as i64;
        if rows == 0 {
            return Self::default();
        }
        let put = |numbers: Vec<f32>, size: &[i64]| Tensor::from_slice(&numbers).view(size).to_device(device);
        Self {
            own: put(of(|t| &t.own), &[rows, -1]),
            near: put(of(|t| &t.near), &[rows, NEAR as i64, NEAR_NUMBERS as i64]),
            yaw_rate_radps,
            known: scenes.iter().flat_map(|s| &s.tokens.known).copied().collect(),
        }
    }

    /// The same rows with what comes from the route times `keep` [R, 1].
    fn with_routes_kept(mut self, keep: &Tensor, num_points: usize) -> Self {
        let told = |columns: Vec<bool>| Tensor::from_slice(&columns).to_device(keep.device());
        let hide = |told: Tensor, keep: &Tensor| told.logical_not().logical_or(keep).to_kind(Kind::Float);
        if !self.yaw_rate_radps.is_empty() {
            self.own *= hide(told(own_columns(num_points).map(|c| c.1).collect()), keep);
            self.near *= hide(told(near_columns().map(|c| c.1).collect()), &keep.unsqueeze(1));
        }
        self
    }

    fn shallow_clone(&self) -> Self {
        Self {
            own: self.own.shallow_clone(),
            near: self.near.shallow_clone(),
            yaw_rate_radps: self.yaw_rate_radps.clone(),
            known: self.known.clone(),
        }
    }
}

/// Logged futures of the rows of a batch.
#[derive(Debug)]
pub struct Targets {
    /// States [R, T, 6].
    pub states: Tensor,
    /// Whether logged [R, T], as 0 or 1.
    pub valid: Tensor,
}

impl Batch {
    /// Joins scenes. Scenes without agents are fine; a batch without any agent is not.
    ///
    /// # Errors
    /// [`ModelError::Shape`] where no scene has an agent.
    pub fn new(scenes: &[&SceneFeatures], config: &ModelConfig, device: Device) -> Result<Self> {
        let scene_sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        let rows: usize = scene_sizes.iter().sum();
        if rows == 0 {
            return Err(ModelError::Shape {
                what: "batch",
                got: "0 agents".into(),
                expected: "at least one".into(),
            });
        }
        let slots = scenes.iter().map(|s| s.num_slots).max().unwrap_or(1);
        let tokens = config.history_token_steps().len();
        let edge = tokens * EDGE_FEATURES;
        let mut history = Vec::with_capacity(rows * config.history_steps * HISTORY_FEATURES);
        let mut poses = Vec::with_capacity(rows * 3);
        let mut speed = Vec::with_capacity(rows);
        let mut neighbours = vec![0i64; rows * slots];
        let mut is_edge = vec![0u8; rows * slots];
        let mut edges = vec![0f32; rows * slots * edge];
        let (mut segments, mut route) = (Vec::new(), Vec::new());
        for (scene, offset) in scenes.iter().zip(row_offsets(&scene_sizes)) {
            history.extend_from_slice(&scene.history);
            poses.extend(scene.poses.iter().flat_map(|p| [p.position.x, p.position.y, p.heading_rad]));
            speed.extend_from_slice(&scene.speed_mps);
            segments.extend_from_slice(&scene.segments);
            route.extend_from_slice(&scene.route);
            let own = scene.num_slots;
            for row in 0..scene.agents.len() {
                let (to, from) = ((offset + row) * slots, row * own);
                for slot in 0..slots {
                    let local = if slot < own { scene.neighbours[from + slot] } else { row };
                    neighbours[to + slot] = (offset + local) as i64;
                }
                for slot in 0..own {
                    is_edge[to + slot] = u8::from(scene.is_edge[from + slot]);
                }
                edges[to * edge..(to + own) * edge]
                    .copy_from_slice(&scene.edges[from * edge..(from + own) * edge]);
            }
        }
        let (r, k) = (rows as i64, slots as i64);
        let put = |t: Tensor, size: &[i64]| t.view(size).to_device(device);
        let lines = [r, NUM_SEGMENTS as i64, SEGMENT_FEATURES as i64];
        Ok(Self {
            scene_sizes,
            tokens: TokenBatch::new(scenes, device),
            route: (!route.is_empty()).then(|| put(Tensor::from_slice(&route), &[r, -1])),
            noise_seeds: scenes.iter().flat_map(|s| s.noise_seed.iter().copied()).collect(),
            history: put(
                Tensor::from_slice(&history),
                &[r, config.history_steps as i64, HISTORY_FEATURES as i64],
            ),
            poses: put(Tensor::from_slice(&poses), &[r, 3]),
            speed_mps: put(Tensor::from_slice(&speed), &[r]),
            neighbours: put(Tensor::from_slice(&neighbours), &[r, k]),
            is_edge: put(Tensor::from_slice(&is_edge).to_kind(Kind::Bool), &[r, k]),
            edges: put(Tensor::from_slice(&edges), &[r, k, tokens as i64, EDGE_FEATURES as i64]),
            lines: config.map.as_ref().map(|_| put(Tensor::from_slice(&segments), &lines)),
            roads: Vec::new(),
        })
    }

    /// Number of rows R.
    pub fn num_rows(&self) -> i64 {
        self.speed_mps.size()[0]
    }

    /// The rows as plans are drawn for them.
    pub fn rows(&self) -> Rows<'_> {
        Rows { scene_sizes: &self.scene_sizes, noise_seeds: &self.noise_seeds }
    }

    /// The same rows with G replaced by the identity where `dropped` [R] (bool) says so: those rows see themselves
    /// alone.
    #[must_use]
    pub fn with_graph_dropped(&self, dropped: &Tensor) -> Self {
        let keep = dropped.logical_not();
        Self {
            scene_sizes: self.scene_sizes.clone(),
            tokens: self.tokens.shallow_clone(),
            route: self.route.as_ref().map(Tensor::shallow_clone),
            noise_seeds: self.noise_seeds.clone(),
            history: self.history.shallow_clone(),
            poses: self.poses.shallow_clone(),
            speed_mps: self.speed_mps.shallow_clone(),
            neighbours: self.neighbours.shallow_clone(),
            is_edge: self.is_edge.logical_and(&keep.unsqueeze(1)),
            edges: self.edges.shallow_clone(),
            lines: self.lines.as_ref().map(Tensor::shallow_clone),
            roads: self.roads.clone(),
        }
    }

    /// The same rows with the routes of those untold that `dropped` [R] (bool) names.
    #[must_use]
    pub fn with_routes_dropped(mut self, dropped: &Tensor) -> Self {
        let keep = dropped.logical_not().unsqueeze(1);
        let points = self.route.as_ref().map_or(0, |route| (route.size()[1] - 1) / 2);
        self.tokens = self.tokens.with_routes_kept(&keep, points as usize);
        self.route = self.route.map(|route| route * keep);
        self
    }

    /// The same rows with G = identity for all, and a single slot.
    #[must_use]
    pub fn with_identity_graph(&self) -> Self {
        let all = Tensor::ones([self.num_rows()], (Kind::Bool, self.speed_mps.device()));
        let mut batch = self.with_graph_dropped(&all);
        batch.neighbours = batch.neighbours.narrow(1, 0, 1);
        batch.is_edge = batch.is_edge.narrow(1, 0, 1);
        batch.edges = batch.edges.narrow(1, 0, 1);
        batch
    }
}

impl Targets {
    /// Joins the futures of the scenes of a batch.
    pub fn new(futures: &[&Futures], config: &ModelConfig, device: Device) -> Self {
        let states: Vec<f32> = futures.iter().flat_map(|f| f.states.iter().copied()).collect();
        let valid: Vec<f32> =
            futures.iter().flat_map(|f| f.valid.iter().map(|v| f32::from(u8::from(*v)))).collect();
        let steps = config.horizon_steps as i64;
        Self {
            states: Tensor::from_slice(&states).view([-1, steps, 6]).to_device(device),
            valid: Tensor::from_slice(&valid).view([-1, steps]).to_device(device),
        }
    }
}
