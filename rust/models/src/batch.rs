//! Scenes' features as a batch: rows of all agents of all worlds, without padding between scenes.

use crate::error::{ModelError, Result};
use crate::features::{EDGE_FEATURES, Futures, SceneFeatures, row_offsets};
use ccdiff_nets::compute::numbers;
use ccdiff_nets::config::ModelConfig;
use ccdiff_nets::inputs::tokens::{NEAR_NUMBERS, near_columns, own_columns};
use ccdiff_nets::sampling::sampler::Rows;
use ccdiff_sim::geom::Region;
use std::sync::Arc;
use tch::{Device, Kind, Tensor};

/// Inputs of R agents of several scenes. Neighbour indices count rows of the batch.
#[derive(Debug, Clone)]
pub struct Batch {
    /// The scenes.
    pub scenes: Vec<SceneFeatures>,
    /// Agents of each scene, summing up to R.
    pub scene_sizes: Vec<usize>,
    /// The road of each scene, for a loss that asks for it; else empty.
    pub roads: Vec<Option<Arc<Region>>>,
    /// Where tensors are.
    pub device: Device,
    /// Seed of each row's own noise, [R]; `None`: noise of the world's seed.
    noise_seeds: Vec<Option<u64>>,
}

/// The neighbours of the rows of a batch, in as many slots for each.
#[derive(Debug)]
pub(crate) struct Neighbourhood {
    /// Rows of the agents in each slot [R, K], int64; slot 0 is the row itself.
    pub(crate) rows: Tensor,
    /// Whether a slot is an edge of G [R, K], bool.
    pub(crate) is_edge: Tensor,
    /// Edges [R, K, tokens, 9].
    pub(crate) edges: Tensor,
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
    pub fn new(scenes: Vec<SceneFeatures>, device: Device) -> Result<Self> {
        let scene_sizes: Vec<usize> = scenes.iter().map(|s| s.agents.len()).collect();
        if scene_sizes.iter().all(|size| *size == 0) {
            let (got, expected) = ("0 agents".into(), "at least one".into());
            return Err(ModelError::Shape { what: "batch", got, expected });
        }
        let noise_seeds = scenes.iter().flat_map(|s| s.noise_seed.iter().copied()).collect();
        Ok(Self { scenes, scene_sizes, roads: Vec::new(), device, noise_seeds })
    }

    /// Number of rows R.
    pub fn num_rows(&self) -> usize {
        self.noise_seeds.len()
    }

    /// The rows as plans are drawn for them.
    pub fn rows(&self) -> Rows<'_> {
        Rows { scene_sizes: &self.scene_sizes, noise_seeds: &self.noise_seeds }
    }

    /// The same in plain numbers.
    pub fn numbers(&self) -> numbers::Batch<'_> {
        numbers::Batch { scenes: &self.scenes, alone: false }
    }

    /// A number of each row, given its scene and its place there, [R].
    pub(crate) fn column(&self, of: impl Fn(&SceneFeatures, usize) -> f32) -> Tensor {
        let rows = self.scenes.iter().flat_map(|s| (0..s.agents.len()).map(move |row| (s, row)));
        Tensor::from_slice(&rows.map(|(s, row)| of(s, row)).collect::<Vec<_>>()).to_device(self.device)
    }

    /// Speeds now [R].
    pub fn speed_mps(&self) -> Tensor {
        self.column(|s, row| s.speed_mps[row])
    }

    /// Lengths and widths, metres, [R].
    pub(crate) fn sizes(&self) -> [Tensor; 2] {
        // of the last of the history's 8 numbers
        let end = |s: &SceneFeatures, row: usize| (row + 1) * s.history.len() / s.agents.len();
        [3, 2].map(|back| self.column(|s, row| s.history[end(s, row) - back]))
    }

    /// The neighbours of all rows.
    pub(crate) fn neighbourhood(&self) -> Neighbourhood {
        let (rows, slots) = (self.num_rows(), self.scenes.iter().map(|s| s.num_slots).max().unwrap_or(1));
        let per_slot = |s: &SceneFeatures| s.edges.len() / (s.agents.len() * s.num_slots).max(1);
        let edge = self.scenes.iter().map(per_slot).max().unwrap_or(0);
        let (mut neighbours, mut is_edge) = (vec![0i64; rows * slots], vec![false; rows * slots]);
        let mut edges = vec![0f32; rows * slots * edge];
        for (scene, offset) in self.scenes.iter().zip(row_offsets(&self.scene_sizes)) {
            let own = scene.num_slots;
            for row in 0..scene.agents.len() {
                let (to, from) = ((offset + row) * slots, row * own);
                for slot in 0..slots {
                    let local = if slot < own { scene.neighbours[from + slot] } else { row };
                    neighbours[to + slot] = (offset + local) as i64;
                }
                is_edge[to..to + own].copy_from_slice(&scene.is_edge[from..from + own]);
                edges[to * edge..(to + own) * edge]
                    .copy_from_slice(&scene.edges[from * edge..(from + own) * edge]);
            }
        }
        let size = [rows as i64, slots as i64];
        let put = |t: Tensor| t.view(size).to_device(self.device);
        let of_edges = [size[0], size[1], (edge / EDGE_FEATURES) as i64, EDGE_FEATURES as i64];
        Neighbourhood {
            rows: put(Tensor::from_slice(&neighbours)),
            is_edge: put(Tensor::from_slice(&is_edge)),
            edges: Tensor::from_slice(&edges).view(of_edges).to_device(self.device),
        }
    }

    /// The same rows with G replaced by the identity in the scenes that `drops` names: their rows see themselves alone.
    #[must_use]
    pub fn with_graph_dropped(mut self, drops: impl Fn(usize) -> bool) -> Self {
        for (_, scene) in self.scenes.iter_mut().enumerate().filter(|(at, _)| drops(*at)) {
            scene.is_edge.fill(false);
        }
        self
    }

    /// The same rows with the routes of those untold that `drops` names.
    #[must_use]
    pub fn with_routes_dropped(mut self, drops: impl Fn(usize) -> bool) -> Self {
        let mut next = 0..;
        for scene in &mut self.scenes {
            let m = scene.agents.len();
            let tokens = &mut scene.tokens;
            let points = (scene.route.len() / m.max(1)).saturating_sub(1) / 2;
            for row in (0..m).zip(&mut next).filter(|(_, at)| drops(*at)).map(|(row, _)| row) {
                let part = scene.route.len() / m;
                scene.route[row * part..(row + 1) * part].fill(0.0);
                if tokens.own.is_empty() {
                    continue;
                }
                let own = tokens.own.chunks_exact_mut(own_columns(points).count()).nth(row);
                let per_row = tokens.near.len() / m;
                let near = tokens.near.chunks_exact_mut(per_row).nth(row);
                let near = near.into_iter().flat_map(|near| near.chunks_exact_mut(NEAR_NUMBERS));
                let of_near = near.flat_map(|near| near.iter_mut().zip(near_columns()));
                let all = own.into_iter().flat_map(|own| own.iter_mut().zip(own_columns(points)));
                all.chain(of_near).filter(|(_, (_, told))| *told).for_each(|(number, _)| *number = 0.0);
            }
        }
        self
    }
}

impl Targets {
    /// Joins the futures of the scenes of a batch.
    pub fn new(futures: &[Futures], config: &ModelConfig, device: Device) -> Self {
        let states: Vec<f32> = futures.iter().flat_map(|f| f.states.iter().copied()).collect();
        let valid = futures.iter().flat_map(|f| f.valid.iter().copied());
        let valid = Tensor::from_slice(&valid.collect::<Vec<bool>>()).to_kind(Kind::Float);
        let steps = config.horizon_steps as i64;
        Self {
            states: Tensor::from_slice(&states).view([-1, steps, 6]).to_device(device),
            valid: valid.view([-1, steps]).to_device(device),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::features::{Window, build};
    use ccdiff_sim::geom::Pose2;

    /// Vehicles at the origin with these speeds, 4 m by 2 m; none sees another.
    pub(crate) fn cars(speed_mps: &[f32]) -> SceneFeatures {
        let (config, m) = (ModelConfig { map: None, ..ModelConfig::fast() }, speed_mps.len());
        let window = Window {
            num_steps: config.history_steps,
            poses: vec![Pose2::new(0.0, 0.0, 0.0); m * config.history_steps],
            speed_mps: speed_mps.iter().flat_map(|v| vec![*v; config.history_steps]).collect(),
            valid: vec![true; m * config.history_steps],
            length_m: vec![4.0; m],
            width_m: vec![2.0; m],
            ..Window::default()
        };
        build(&window, None, &config).unwrap()
    }
}
