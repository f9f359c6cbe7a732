//! CCDiff as a background policy: plans for all worlds of a batch at once, anew every n steps, followed in between.
//!
//! The network plans for every vehicle that is there, the ones driven from outside included: those are predicted only.
//! Pedestrians, cyclists and motorcycles are not seen, as in the released code (reference.md#agents).
//!
//! Differs from the released code: vehicles that arrive later are driven too, and nobody vanishes where the log ends but
//! at the edge of the map, unless the world is told otherwise (reference.md#consequences-of-contact).

mod config;
mod planning;
mod roster;

pub use config::{CcdiffConfig, Frozen, GraphMode, Others, Partners, Ranking};

use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::planner::{PlanOptions, Planner};
use crate::raster::MapBitmap;
use ccdiff_sim::SimError;
use ccdiff_sim::geom::{Pose2, Real, Vector2};
use ccdiff_sim::policy::{BackgroundPolicy, Command, Explanation, Idm, Motion, Replay, WorldView};
use ccdiff_sim::scene::Scene;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// What a world carries from step to step; all of it is in its snapshots.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct WorldPlan {
    /// The plan; `None` before the first one.
    explanation: Option<Explanation>,
    /// Speed of each planned agent after each step of its chosen sample, m/s, [M, T].
    speed_mps: Vec<Real>,
    /// Agents of the scene that stand still for the whole episode.
    frozen: Vec<bool>,
    /// Agents of the scene that have left their log by following a plan.
    left_log: Vec<bool>,
    /// Ranking of the first plan.
    first_ranking: Vec<usize>,
    command: Command,
}

/// CCDiff traffic of a batch of worlds.
pub struct Ccdiff {
    /// Used by `plan` alone; the lock lets worlds ask for motions from many threads.
    planner: Mutex<Planner>,
    /// Step and history of the weights.
    model: ModelConfig,
    config: CcdiffConfig,
    /// How plans are drawn with guidance and without.
    guided: PlanOptions,
    unguided: PlanOptions,
    worlds: Vec<WorldPlan>,
    /// Maps drawn for the network, one for each scene that was played.
    bitmaps: Vec<(Arc<Scene>, Arc<MapBitmap>)>,
}

impl Ccdiff {
    /// Loads a weight file; the name of the weights in the configuration is for the reader.
    ///
    /// # Errors
    /// [`ModelError::Io`], [`ModelError::Checkpoint`], [`ModelError::Config`].
    pub fn new(config: CcdiffConfig, weights: &Path) -> Result<Self> {
        let device = crate::device_named(&config.device)?;
        let mut planner = Planner::load(weights, device)?;
        config.validate(planner.config().horizon_steps)?;
        if config.graph == GraphMode::Full {
            planner.set_graph_thresholds(f32::INFINITY, f32::INFINITY);
        }
        let model = planner.config().clone();
        let (guided, unguided) = (config.guided()?, config.unguided());
        let planner = Mutex::new(planner);
        Ok(Self { planner, model, config, guided, unguided, worlds: Vec::new(), bitmaps: Vec::new() })
    }

    /// Checks that worlds can be planned for.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another step or history than the weights were trained with, [`SimError::Scene`] for a
    /// scene without a map where the network reads one.
    pub fn check(&self, dt_s: Real, history_steps: usize, scenes: &[Arc<Scene>]) -> Result<()> {
        let model = &self.model;
        if (f64::from(dt_s) - model.dt_s).abs() > 1e-6 {
            return Err(ModelError::Config {
                field: "dt_s",
                got: dt_s.to_string(),
                expected: "the step that the weights of traffic \"ccdiff\" were trained with",
            });
        }
        if history_steps + 1 < model.history_steps {
            return Err(ModelError::Config {
                field: "history_steps",
                got: history_steps.to_string(),
                expected: "at least the history that the weights of traffic \"ccdiff\" were trained with (30)",
            });
        }
        let blank = |s: &&Arc<Scene>| s.map.drivable_area.is_empty() && s.map.lanes.is_empty();
        match scenes.iter().find(blank) {
            Some(scene) if self.model.map.is_some() => Err(SimError::Scene {
                scene: scene.name.clone(),
                field: "map".into(),
                got: "neither drivable area nor lanes".into(),
                expected: "a map: the network of traffic \"ccdiff\" reads it",
            }
            .into()),
            _ => Ok(()),
        }
    }

    fn slot(&mut self, world_idx: usize) -> &mut WorldPlan {
        if self.worlds.len() <= world_idx {
            self.worlds.resize_with(world_idx + 1, WorldPlan::default);
        }
        &mut self.worlds[world_idx]
    }

    fn bitmap(&mut self, scene: &Arc<Scene>) -> Option<Arc<MapBitmap>> {
        if let Some((_, bitmap)) = self.bitmaps.iter().find(|(s, _)| Arc::ptr_eq(s, scene)) {
            return Some(Arc::clone(bitmap));
        }
        let bitmap = Arc::new(MapBitmap::from_scene(scene, self.model.map.as_ref()?));
        self.bitmaps.push((Arc::clone(scene), Arc::clone(&bitmap)));
        Some(bitmap)
    }

    fn is_due(&self, world: &WorldView<'_>) -> bool {
        let plan = self.worlds.get(world.world_idx).and_then(|w| w.explanation.as_ref());
        plan.is_none_or(|p| world.elapsed_steps >= p.made_at + self.config.replan_steps)
    }

    fn map_has(&self, scene: &Arc<Scene>, pose: &Pose2) -> bool {
        let bitmap = self.bitmaps.iter().find(|(s, _)| Arc::ptr_eq(s, scene));
        bitmap.is_none_or(|(_, b)| b.covers(pose.position))
    }
}

impl WorldPlan {
    /// Where the plan has an agent after the coming step; `None` for agents that do not follow it.
    fn follow(&self, world: &WorldView<'_>, agent_idx: usize) -> Option<(Pose2, Vector2)> {
        let plan = self.explanation.as_ref()?;
        let row = plan.agents.iter().position(|a| *a == agent_idx).filter(|row| plan.executed[*row])?;
        let step = world.elapsed_steps.checked_sub(plan.made_at).filter(|s| *s < plan.num_steps)?;
        let m = plan.agents.len();
        let at = ((plan.chosen[row] * m + row) * plan.num_steps + step) * 3;
        let [x, y, heading_rad] = plan.samples[at..at + 3] else { return None };
        let pose = Pose2::new(x, y, heading_rad);
        let speed = self.speed_mps[row * plan.num_steps + step];
        Some((pose, Vector2::new(pose.cos * speed, pose.sin * speed)))
    }
}

/// The error of this crate as the simulator passes it on.
fn policy_error(error: ModelError) -> SimError {
    match error {
        ModelError::Sim(error) => error,
        other => SimError::Policy { policy: "ccdiff".into(), message: other.to_string() },
    }
}

impl BackgroundPolicy for Ccdiff {
    fn name(&self) -> &'static str {
        "ccdiff"
    }

    fn needs_history(&self) -> bool {
        true
    }

    fn plans(&self) -> bool {
        true
    }

    fn plan(&mut self, worlds: &[WorldView<'_>]) -> ccdiff_sim::Result<()> {
        let due: Vec<&WorldView<'_>> = worlds.iter().filter(|w| self.is_due(w)).collect();
        if due.is_empty() { Ok(()) } else { self.plan_due(&due).map_err(policy_error) }
    }

    fn act(&self, world: &WorldView<'_>, agent_idx: usize) -> Motion {
        let pose = world.states.pose(agent_idx);
        let Some(slot) = self.worlds.get(world.world_idx).filter(|w| w.explanation.is_some()) else {
            return Replay.act(world, agent_idx);
        };
        if slot.frozen[agent_idx] {
            return Motion::Place(pose, Vector2::zeros());
        }
        match slot.follow(world, agent_idx) {
            Some((pose, velocity)) if self.map_has(&world.scene.scene, &pose) => {
                Motion::Place(pose, velocity)
            }
            Some(_) => Motion::Leave,
            None if self.config.others == Others::Idm => Idm.act(world, agent_idx),
            // not planned for yet, or left to the log
            None => Replay.act(world, agent_idx),
        }
    }

    fn command(&mut self, world_idx: usize, command: Command) -> ccdiff_sim::Result<()> {
        self.slot(world_idx).command = command;
        Ok(())
    }

    fn explain(&self, world_idx: usize) -> Option<&Explanation> {
        self.worlds.get(world_idx)?.explanation.as_ref()
    }

    fn reset_world(&mut self, world_idx: usize) {
        *self.slot(world_idx) = WorldPlan::default();
    }

    fn save_world(&self, world_idx: usize) -> Vec<u8> {
        // plain numbers and lists: writing them cannot fail
        self.worlds.get(world_idx).and_then(|w| postcard::to_stdvec(w).ok()).unwrap_or_default()
    }

    fn load_world(&mut self, world_idx: usize, bytes: &[u8]) -> ccdiff_sim::Result<()> {
        let plan = if bytes.is_empty() {
            WorldPlan::default()
        } else {
            let damaged = |e| SimError::Snapshot(format!("damaged plan of traffic \"ccdiff\" ({e})"));
            postcard::from_bytes::<WorldPlan>(bytes).map_err(damaged)?
        };
        if !plan.is_whole() {
            return Err(SimError::Snapshot("plan of traffic \"ccdiff\" whose arrays do not fit".into()));
        }
        *self.slot(world_idx) = plan;
        Ok(())
    }
}
