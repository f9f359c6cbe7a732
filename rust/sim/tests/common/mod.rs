//! A batch of worlds with the buffers it writes into.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses its own part; a test fails by panicking"
)]

use ccdiff_sim::Result;
use ccdiff_sim::policy::TrafficPolicy;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{Autoreset, NUM_COLUMNS, ResetRequest, StepBuffers, VecWorld, WorldConfig};
use std::sync::Arc;

pub(crate) struct Batch {
    pub(crate) world: VecWorld,
    pub(crate) obs: Vec<f32>,
    pub(crate) reward: Vec<f32>,
    pub(crate) terminated: Vec<bool>,
    pub(crate) truncated: Vec<bool>,
    pub(crate) alive: Vec<bool>,
    pub(crate) columns: Vec<f32>,
    pub(crate) done: Vec<bool>,
    pub(crate) was_reset: Vec<bool>,
    pub(crate) final_obs: Vec<f32>,
    pub(crate) bev: Vec<u8>,
    pub(crate) final_bev: Vec<u8>,
}

macro_rules! buffers {
    ($b:expr) => {
        StepBuffers {
            obs: &mut $b.obs,
            reward: &mut $b.reward,
            terminated: &mut $b.terminated,
            truncated: &mut $b.truncated,
            alive: &mut $b.alive,
            columns: &mut $b.columns,
            done: &mut $b.done,
            was_reset: &mut $b.was_reset,
            final_obs: &mut $b.final_obs,
            bev: &mut $b.bev,
            final_bev: &mut $b.final_bev,
        }
    };
}

pub(crate) fn city(num_agents: usize) -> Arc<Scene> {
    Arc::new(GridCity { num_agents, ..GridCity::default() }.scene().validated().unwrap())
}

impl Batch {
    pub(crate) fn new(scenes: Vec<Arc<Scene>>, config: WorldConfig, envs: usize, threads: usize) -> Self {
        Self::with_policies(scenes, config, envs, threads, Vec::new())
    }

    pub(crate) fn with_policies(
        scenes: Vec<Arc<Scene>>,
        config: WorldConfig,
        envs: usize,
        threads: usize,
        policies: Vec<(String, Box<dyn TrafficPolicy>)>,
    ) -> Self {
        Self::of(scenes, config, envs, threads, policies).unwrap()
    }

    /// As [`Batch::with_policies`], for scenes and configurations that may not go together.
    pub(crate) fn of(
        scenes: Vec<Arc<Scene>>,
        config: WorldConfig,
        envs: usize,
        threads: usize,
        policies: Vec<(String, Box<dyn TrafficPolicy>)>,
    ) -> Result<Self> {
        let slots = envs * config.num_slots;
        let same_step = config.autoreset == Autoreset::SameStep;
        let world = VecWorld::new(scenes, config, envs, threads, policies)?;
        let row = world.layout().size;
        let rasters = slots * world.extent().raster.iter().product::<usize>();
        Ok(Self {
            obs: vec![0.0; slots * row],
            reward: vec![0.0; slots],
            terminated: vec![false; slots],
            truncated: vec![false; slots],
            alive: vec![false; slots],
            columns: vec![0.0; slots * NUM_COLUMNS],
            done: vec![false; envs],
            was_reset: vec![false; envs],
            final_obs: vec![0.0; if same_step { slots * row } else { 0 }],
            bev: vec![0; rasters],
            final_bev: vec![0; if same_step { rasters } else { 0 }],
            world,
        })
    }

    pub(crate) fn reset(&mut self, seeds: &[Option<u64>], scenes: &[Option<usize>]) -> Result<()> {
        let request = ResetRequest { seeds, scenes, ..ResetRequest::default() };
        self.world.reset(&request, buffers!(self))
    }

    pub(crate) fn reset_all(&mut self, seed: u64) {
        let n = self.world.num_worlds();
        let seeds: Vec<_> = (0..n as u64).map(|i| Some(seed + i)).collect();
        self.reset(&seeds, &vec![None; n]).unwrap();
    }

    pub(crate) fn reset_masked(&mut self, mask: &[bool]) -> Result<()> {
        let n = self.world.num_worlds();
        let request = ResetRequest {
            seeds: &vec![None; n],
            scenes: &vec![None; n],
            mask: Some(mask),
            ..ResetRequest::default()
        };
        self.world.reset(&request, buffers!(self))
    }

    pub(crate) fn step(&mut self, actions: &[f32]) -> Result<()> {
        self.world.step(actions, None, buffers!(self))
    }

    pub(crate) fn step_some(&mut self, actions: &[f32], active: &[bool]) -> Result<()> {
        self.world.step(actions, Some(active), buffers!(self))
    }

    /// All bits that a step gives out.
    pub(crate) fn bits(&self) -> Vec<u32> {
        let reals = self.obs.iter().chain(&self.reward).chain(&self.columns);
        let flags = self.terminated.iter().chain(&self.truncated).chain(&self.alive);
        let worlds = self.done.iter().chain(&self.was_reset);
        let bytes = self.bev.iter().map(|b| u32::from(*b));
        let flags = flags.chain(worlds).map(|b| u32::from(*b));
        reals.map(|x| x.to_bits()).chain(flags).chain(bytes).collect()
    }
}

/// Actions in [-1, 1] that look random, from a linear congruence.
pub(crate) fn actions(step: usize, n: usize) -> Vec<f32> {
    (0..n)
        .map(|i| {
            let x = (step as u32).wrapping_mul(2654435761).wrapping_add((i as u32).wrapping_mul(40503));
            (x.wrapping_mul(1664525).wrapping_add(1013904223) >> 8) as f32 / (1u32 << 23) as f32 - 1.0
        })
        .collect()
}
