//! A batch of worlds with the buffers it writes into.
#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test file uses its own part; a test fails by panicking"
)]

use ccdiff_sim::Result;
use ccdiff_sim::drivers::DriverModel;
use ccdiff_sim::scene::Scene;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{ResetRequest, StepBuffers, VecWorld, WorldConfig};
use std::sync::Arc;

macro_rules! batch {
    ($($name:ident: $type:ty),+) => {
        pub(crate) struct Batch {
            pub(crate) world: VecWorld,
            $(pub(crate) $name: Vec<$type>,)+
        }

        impl Batch {
            pub(crate) fn around(world: VecWorld) -> Self {
                let arrays = world.extent().arrays(world.num_worlds());
                let size = |name: &str| {
                    let array = arrays.iter().find(|array| array.name == name).unwrap();
                    if array.shape.is_empty() { 0 } else { array.shape.iter().product() }
                };
                Self { $($name: vec![Default::default(); size(stringify!($name))],)+ world }
            }

            fn with<T>(&mut self, call: impl FnOnce(&mut VecWorld, StepBuffers<'_>) -> T) -> T {
                call(&mut self.world, StepBuffers { $($name: &mut self.$name),+ })
            }
        }
    };
}

ccdiff_sim::with_step_arrays!(batch);

pub(crate) fn city(num_agents: usize) -> Arc<Scene> {
    Arc::new(GridCity { num_agents, ..GridCity::default() }.scene().validated().unwrap())
}

impl Batch {
    pub(crate) fn new(scenes: Vec<Arc<Scene>>, config: WorldConfig, envs: usize, threads: usize) -> Self {
        Self::with_drivers(scenes, config, envs, threads, Vec::new())
    }

    pub(crate) fn with_drivers(
        scenes: Vec<Arc<Scene>>,
        config: WorldConfig,
        envs: usize,
        threads: usize,
        drivers: Vec<(String, Box<dyn DriverModel>)>,
    ) -> Self {
        Self::around(VecWorld::new(scenes, config, envs, threads, drivers).unwrap())
    }

    pub(crate) fn reset(&mut self, seeds: &[Option<u64>], scenes: &[Option<usize>]) -> Result<()> {
        let request = ResetRequest { seeds, scenes, ..ResetRequest::default() };
        self.with(|world, out| world.reset(&request, out))
    }

    pub(crate) fn reset_all(&mut self, seed: u64) {
        let n = self.world.num_worlds();
        let seeds: Vec<_> = (0..n as u64).map(|i| Some(seed + i)).collect();
        self.reset(&seeds, &vec![None; n]).unwrap();
    }

    pub(crate) fn step(&mut self, actions: &[f32]) -> Result<()> {
        self.with(|world, out| world.step(actions, None, out))
    }

    pub(crate) fn step_some(&mut self, actions: &[f32], active: &[bool]) -> Result<()> {
        self.with(|world, out| world.step(actions, Some(active), out))
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
