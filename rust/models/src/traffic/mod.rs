//! CCDiff as a background policy: plans for all worlds of a batch at once, anew every n steps, followed in between.
//!
//! The network plans for every vehicle that is there, the ones driven from outside included: those are predicted only.
//! Pedestrians, cyclists and motorcycles are not seen, as in the released code (method.md 1.3).
//!
//! Differs from the released code: vehicles that arrive later are driven too, and nobody vanishes where the log ends but
//! at the edge of the map, unless the world is told otherwise (method.md 5.4).

mod config;
mod roster;

pub use config::{CcdiffConfig, Frozen, GraphMode, Others, Ranking};

use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::planner::{Plan, Planner, WorldView as PlannerView};
use crate::raster::MapBitmap;
use ccdiff_sim::SimError;
use ccdiff_sim::geom::{Pose2, Real, Vector2};
use ccdiff_sim::policy::{BackgroundPolicy, Command, Explanation, Idm, Motion, Replay, WorldView};
use ccdiff_sim::scene::Scene;
use roster::Roster;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

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
        Ok(Self { planner: Mutex::new(planner), model, config, worlds: Vec::new(), bitmaps: Vec::new() })
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

    fn plan_due(&mut self, worlds: &[&WorldView<'_>]) -> Result<()> {
        let history_steps = self.model.history_steps;
        let mut rosters = Vec::with_capacity(worlds.len());
        let mut bitmaps = Vec::with_capacity(worlds.len());
        for world in worlds {
            let frozen = self.config.frozen;
            let slot = self.slot(world.world_idx);
            if slot.explanation.is_none() {
                slot.frozen = roster::frozen(world, frozen);
                slot.left_log = vec![false; world.states.len()];
            }
            rosters.push(Roster::new(world, &slot.frozen, history_steps)?);
            bitmaps.push(self.bitmap(&world.scene.scene));
        }
        let mut rankings = Vec::with_capacity(worlds.len());
        for (world, roster) in worlds.iter().zip(&rosters) {
            let slot = &self.worlds[world.world_idx];
            let known = !self.config.rerank && slot.explanation.is_some();
            let ranking =
                if known { slot.first_ranking.clone() } else { roster.ranking(world, &self.config, None)? };
            rankings.push(ranking);
        }
        let views: Vec<PlannerView<'_>> = worlds
            .iter()
            .zip(&rosters)
            .zip(&bitmaps)
            .map(|((world, roster), bitmap)| PlannerView {
                window: &roster.window,
                bitmap: bitmap.as_deref(),
                seed: world.noise_seed,
                guide: None,
            })
            .collect();
        let plans = self
            .planner
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .plan(&views, &self.config.sampling().into())?;
        for (((world, roster), ranking), plan) in worlds.iter().zip(&rosters).zip(rankings).zip(plans) {
            self.adopt(world, roster, ranking, plan);
        }
        Ok(())
    }

    /// Makes a plan the one that a world follows.
    fn adopt(&mut self, world: &WorldView<'_>, roster: &Roster, ranking: Vec<usize>, plan: Plan) {
        let (config, slot) = (&self.config, &mut self.worlds[world.world_idx]);
        let (n, m) = (plan.num_samples, plan.agents.len());
        let steps = plan.states.len() / (n * m * 6).max(1);
        let agents: Vec<usize> = plan.agents.iter().map(|row| roster.agents[*row]).collect();
        let singled_out = roster::singled_out(&ranking, &slot.command, config.num_guided);
        let drives =
            |a: &usize| roster.is_ours(*a) && (config.others == Others::Ccdiff || singled_out.contains(a));
        let executed: Vec<bool> = agents
            .iter()
            .map(|a| {
                drives(a) || (roster.is_ours(*a) && config.others == Others::Replay && slot.left_log[*a])
            })
            .collect();
        for (agent, drives) in agents.iter().zip(&executed) {
            slot.left_log[*agent] |= *drives;
        }
        let mut samples = Vec::with_capacity(n * m * steps * 3);
        for states in plan.states.chunks_exact((m * steps * 6).max(1)) {
            for (row, frame) in plan.features.poses.iter().enumerate() {
                for state in states[row * steps * 6..(row + 1) * steps * 6].chunks_exact(6) {
                    let at = frame.position + frame.rotate(Vector2::new(state[0], state[1]));
                    samples.extend([at.x, at.y, frame.heading_rad + state[3]]);
                }
            }
        }
        let chosen = vec![0usize; m];
        slot.speed_mps.clear();
        for (row, sample) in chosen.iter().enumerate() {
            let from = (sample * m + row) * steps * 6;
            slot.speed_mps.extend(plan.states[from..from + steps * 6].chunks_exact(6).map(|s| s[2]));
        }
        if slot.explanation.is_none() {
            slot.first_ranking.clone_from(&ranking);
        }
        slot.explanation = Some(Explanation {
            made_at: world.elapsed_steps,
            guided: vec![false; m],
            executed,
            graph: plan.features.graph.as_slice().to_vec(),
            ttc_s: plan.features.ttc_s.clone(),
            attention: Vec::new(),
            ranking,
            num_samples: n,
            num_steps: steps,
            samples,
            chosen,
            objectives: Vec::new(),
            losses: Vec::new(),
            realism_cost: vec![0.0; m],
            gradient_cosine: Vec::new(),
            agents,
        });
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

impl WorldPlan {
    /// Whether all arrays have the lengths that following the plan relies on.
    fn is_whole(&self) -> bool {
        let Some(p) = &self.explanation else { return true };
        let m = p.agents.len();
        let num_agents = self.frozen.len();
        self.left_log.len() == num_agents
            && p.agents.iter().chain(&self.first_ranking).all(|a| *a < num_agents)
            && p.executed.len() == m
            && p.chosen.len() == m
            && p.chosen.iter().all(|s| *s < p.num_samples.max(1))
            && p.samples.len() == p.num_samples * m * p.num_steps * 3
            && self.speed_mps.len() == m * p.num_steps
            && p.samples.iter().chain(&self.speed_mps).all(|x| x.is_finite())
    }
}
