//! A planning network as a driver of traffic: plans for all worlds of a batch at once, every n steps, followed in
//! between.
//!
//! The network plans for every vehicle that is there, the ones with other drivers included: those are predicted only.
//! Pedestrians, cyclists and motorcycles are not seen, as in the released code (reference.md#agents).
//!
//! Differs from the released code: vehicles that arrive later are driven too, and none vanishes where the log ends but
//! at the edge of the map, unless the world is told otherwise (reference.md#consequences-of-contact).

mod adversary_policy;
pub(crate) mod config;
pub mod egos;
mod memory;
mod planned_agents;
mod planning;
mod reach;
pub mod swift;
pub mod way_out;

pub use config::{
    BackgroundDriver, CcdiffConfig, CollisionTargets, Conflict, DRIVERS, GraphMode, GuidanceChoice,
    ParkedRule, Ranking,
};

pub(crate) use adversary_policy::AdversaryPolicy;
pub use planned_agents::STATIONARY_REACH_M;

use crate::compute::weights::read;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result, require};
use crate::inputs::segments::MapLines;
use crate::networks::trajectory_model::{PlanOptions, TrajectoryModel};
use ccdiff_sim::SimError;
use ccdiff_sim::drivers::{AgentMotion, DriverModel, Idm, PlanRequest, PlanState, Replay, WorldView};
use ccdiff_sim::geom::{Pose2, Real, Vector2};
use ccdiff_sim::scene::{AgentKind, Scene};
use memory::Memory;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::path::Path;
use std::sync::Arc;
use sync_wrapper::SyncWrapper;

/// Traffic of a batch of worlds that follows the plans of a network.
pub struct PlannedTraffic {
    /// A network for each thread of the pool; used by `plan` alone, which takes them exclusively.
    copies: SyncWrapper<Vec<TrajectoryModel>>,
    /// Threads that plan. `None`: the caller's thread plans.
    pool: Option<ThreadPool>,
    /// Step and history of the weights.
    model: ModelConfig,
    config: CcdiffConfig,
    /// A learned choice of guided vehicles, in place of the ranking.
    adversary_policy: Option<AdversaryPolicy>,
    /// How plans are drawn with guidance and without.
    guided: PlanOptions,
    unguided: PlanOptions,
    /// Maps as the network reads them, by the scene's index in the batch; none where it was not played yet.
    maps: Vec<Option<Arc<MapLines>>>,
}

impl PlannedTraffic {
    /// Traffic on the kernels of this crate; the name of the weights in the configuration is for the reader. Worlds are planned for
    /// on `num_threads` threads; results do not depend on their number.
    ///
    /// # Errors
    /// [`ModelError::Io`], [`ModelError::Checkpoint`], [`ModelError::Config`].
    pub fn new(config: CcdiffConfig, weights: &Path, num_threads: usize) -> Result<Self> {
        let (fits, got) = (config.device == config::CPU, format!("{:?}", config.device));
        require(fits, "ccdiff.device", got, "\"cpu\" without torch")?;
        let pool = planning_pool(num_threads)?;
        let (file, copies) = (read(weights)?, 0..num_threads.max(1));
        let copies = copies.map(|_| TrajectoryModel::new(weights, file.clone())).collect::<Result<_>>()?;
        Self::of(config, copies, Some(pool))
    }

    /// Traffic of a network that is there once for each thread of a pool, or once without one.
    ///
    /// # Errors
    /// [`ModelError::Config`] for options that do not fit the network.
    pub fn of(
        config: CcdiffConfig,
        mut copies: Vec<TrajectoryModel>,
        pool: Option<ThreadPool>,
    ) -> Result<Self> {
        if config.graph == GraphMode::Full {
            copies.iter_mut().for_each(|c| c.set_graph_thresholds(f32::INFINITY, f32::INFINITY));
        }
        let model = copies[0].config().clone();
        let network = copies[0].network();
        config.check(network, &model)?;
        copies[0].check_solver_steps(config.denoising_steps)?;
        let (guided, unguided) = (config.guided(network)?, config.unguided(network));
        let copies = SyncWrapper::new(copies);
        let adversary_policy = AdversaryPolicy::of(&config)?;
        Ok(Self { adversary_policy, copies, pool, model, config, guided, unguided, maps: Vec::new() })
    }

    /// Kind of the network.
    pub fn kind(&self) -> &str {
        self.model.kind.as_str()
    }

    /// Checks that worlds can be planned for.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another step than the weights were trained with, [`SimError::Scene`] for a scene
    /// without a map where the network reads it.
    pub fn check(&self, dt_s: Real, scenes: &[Arc<Scene>]) -> Result<()> {
        let model = &self.model;
        let expected = "the step that the weights of the traffic were trained with";
        require((f64::from(dt_s) - model.dt_s).abs() <= 1e-6, "dt_s", dt_s, expected)?;
        let blank = |s: &&Arc<Scene>| s.map.drivable_area.is_empty() && s.map.lanes.is_empty();
        if let Some(scene) = scenes.iter().find(blank).filter(|_| model.map.is_some()) {
            return Err(SimError::Scene {
                scene: scene.name.clone(),
                field: "map".into(),
                got: "neither drivable area nor lanes".into(),
                expected: "a map: the network of the traffic reads it".into(),
            }
            .into());
        }
        Ok(())
    }

    /// Reads the maps of scenes that are played for the first time, side by side.
    fn read_maps(&mut self, worlds: &[WorldView<'_>]) {
        if self.model.map.is_none() {
            return;
        }
        let mut new: Vec<(usize, &Arc<Scene>)> = Vec::new();
        for world in worlds {
            if self.map(world).is_none() && !new.iter().any(|(idx, _)| *idx == world.scene_idx) {
                new.push((world.scene_idx, &world.scene.scene));
            }
        }
        let read = |(idx, scene): (usize, &Arc<Scene>)| (idx, Arc::new(MapLines::from_scene(scene)));
        for (idx, map) in side_by_side(self.pool.as_ref(), new, read) {
            self.maps.resize(self.maps.len().max(idx + 1), None);
            self.maps[idx] = Some(map);
        }
    }

    /// The map of a world's scene, once it was read.
    fn map(&self, world: &WorldView<'_>) -> Option<&Arc<MapLines>> {
        self.maps.get(world.scene_idx)?.as_ref()
    }

    fn map_has(&self, world: &WorldView<'_>, pose: &Pose2) -> bool {
        self.map(world).is_none_or(|map| map.covers(pose.position))
    }
}

/// Threads that plan.
///
/// # Errors
/// [`ModelError::Config`] where the system has no more of them.
pub fn planning_pool(num_threads: usize) -> Result<ThreadPool> {
    ThreadPoolBuilder::new()
        .num_threads(num_threads.max(1))
        .thread_name(|i| format!("ccdiff-plan-{i}"))
        .build()
        .map_err(|e| ModelError::Config { field: "num_threads", got: e.to_string(), expected: "threads" })
}

/// What is made of items, in their order, on the threads of a pool; without one on the caller's.
fn side_by_side<T: Send, R: Send>(
    pool: Option<&ThreadPool>,
    items: Vec<T>,
    of: impl Fn(T) -> R + Send + Sync,
) -> Vec<R> {
    match pool {
        Some(pool) => pool.install(|| items.into_par_iter().map(of).collect()),
        None => items.into_iter().map(of).collect(),
    }
}

/// Metres before the end of its route at which a vehicle leaves.
const END_M: Real = 0.5;

/// What a vehicle does that decides for itself: it follows its plan, stays where it is parked, and leaves at the end of its
/// route; `None` without a plan. Other agents follow the log.
fn followed(world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> Option<AgentMotion> {
    let route = &world.scene.routes[agent_idx];
    if world.scene.kinds[agent_idx] != AgentKind::Vehicle {
        return Some(Replay.act(world, None, agent_idx));
    }
    if route.is_parked() {
        return Some(stands(world, agent_idx));
    }
    if world.route_s_m[agent_idx] >= route.path.length_m() - END_M {
        return Some(AgentMotion::Leave);
    }
    plan?.follow(world, agent_idx).map(|(pose, velocity)| AgentMotion::Place(pose, velocity))
}

fn stands(world: &WorldView<'_>, agent_idx: usize) -> AgentMotion {
    AgentMotion::Place(world.states.pose(agent_idx), Vector2::zeros())
}

/// The error of this crate as the simulator passes it on.
fn driver_error(name: &str, error: ModelError) -> SimError {
    match error {
        ModelError::Sim(error) => error,
        other => SimError::Driver { driver: name.into(), message: other.to_string() },
    }
}

impl DriverModel for PlannedTraffic {
    fn name(&self) -> &str {
        self.kind()
    }

    fn history_states(&self) -> usize {
        self.model.history_steps
    }

    /// Shorter histories than the weights' own are masked; training has none that are shorter still.
    fn least_history_states(&self) -> usize {
        self.model.history_steps.min(crate::inputs::features::FIRST_STEP + 1)
    }

    fn follows_route(&self, plan: Option<&PlanState>, agent_idx: usize) -> bool {
        self.config.follow_route && !plan.is_some_and(|plan| memory::is_parked(&plan.memory, agent_idx))
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> ccdiff_sim::Result<Vec<Option<PlanState>>> {
        let due: Vec<&PlanRequest<'_>> =
            requests.iter().filter(|r| r.is_due(self.config.replan_steps)).collect();
        let mut made = vec![None; requests.len()];
        if !due.is_empty() {
            let plans = self.plan_due(&due).map_err(|e| driver_error(self.kind(), e))?;
            for (request, plan) in plans {
                let at = requests.iter().position(|r| r.world.world_idx == request.world.world_idx);
                if let Some(slot) = at.and_then(|at| made.get_mut(at)) {
                    *slot = Some(plan);
                }
            }
        }
        Ok(made)
    }

    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let Some(plan) = plan else {
            return Replay.act(world, None, agent_idx);
        };
        if memory::is_parked(&plan.memory, agent_idx) {
            return stands(world, agent_idx);
        }
        match plan.follow(world, agent_idx) {
            Some((pose, velocity)) if self.map_has(world, &pose) => AgentMotion::Place(pose, velocity),
            Some(_) => AgentMotion::Leave,
            None if self.config.background_driver == BackgroundDriver::Idm
                || self.config.plan_radius_m.is_some() =>
            {
                Idm { config: *world.idm }.act(world, None, agent_idx)
            }
            // not planned for yet, or left to the log
            None => Replay.act(world, None, agent_idx),
        }
    }
}
