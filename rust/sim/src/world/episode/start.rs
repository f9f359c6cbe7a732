//! Where an episode starts, and its ego where that is drawn.

use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::stage::PreparedScene;
use crate::world::config::{Controlled, WorldConfig, check_style};
use crate::world::rng::Rng;
use std::collections::BTreeMap;

/// Least distance of a drawn ego's start from its logged place at the end of the episode, metres.
pub const LEAST_WAY_M: Real = 10.0;

/// What a reset asks for beside the scene; `None` leaves the choice to the draw.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Wanted {
    /// Index of the vehicle that is the ego.
    pub ego: Option<usize>,
    /// Step of the log at which the episode starts.
    pub start: Option<usize>,
    /// Factors of weights of the reward by name; others are drawn.
    pub style: BTreeMap<String, Real>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Start {
    /// The ego, where [`Controlled::Any`] leaves it to the draw.
    pub(crate) ego: Option<usize>,
    pub(crate) step_idx: usize,
}

/// Whether an agent is logged at a step, and far enough away at its last one of the episode.
fn drives_on(scene: &Scene, agent_idx: usize, step_idx: usize, horizon_steps: usize) -> bool {
    let end = step_idx.saturating_add(horizon_steps).min(scene.num_steps - 1);
    let place = |t: usize| scene.tracks.position[scene.at(agent_idx, t)];
    let last = || (step_idx..=end).rev().find(|t| scene.is_valid(agent_idx, *t)).unwrap_or(step_idx);
    scene.is_valid(agent_idx, step_idx) && (place(last()) - place(step_idx)).norm() >= LEAST_WAY_M
}

impl Start {
    /// Draws a start; `None` without an agent to control. Egos whose log leaves the `prepared` road come last.
    pub(crate) fn draw(
        scene: &Scene,
        prepared: Option<&PreparedScene>,
        config: &WorldConfig,
        wanted: &Wanted,
        mut rng: Rng,
    ) -> Option<Self> {
        let first = config.history_steps;
        let most = scene.num_steps.saturating_sub(first + 2);
        if config.controlled != Controlled::Any {
            let there = |step: &usize| config.controlled.anyone_at(scene, *step);
            let spread = config.start_spread_steps.min(most);
            let drawn = (spread > 0).then(|| first + rng.below(spread + 1)).filter(there);
            return there(&first).then(|| Self { ego: None, step_idx: drawn.unwrap_or(first) });
        }
        let anyhow = config.standing_share > 0.0 && rng.uniform() < config.standing_share;
        let spread = if config.start_spread_steps == 0 { most } else { config.start_spread_steps.min(most) };
        let steps = wanted.start.map_or(first..=first + spread, |step| step..=step);
        let vehicles =
            || (0..scene.num_agents()).filter(|a| scene.agents[*a].kind == AgentKind::Vehicle).collect();
        for prepared in [prepared, None] {
            let is_towed = |a: &usize| prepared.is_some_and(|p| p.is_towed(*a));
            let stays = |ego: usize, t: usize| {
                prepared.is_none_or(|p| !p.leaves_road(ego, t, t.saturating_add(config.horizon_steps)))
            };
            let mut left: Vec<usize> = wanted.ego.map_or_else(vehicles, |a| vec![a]);
            left.retain(|a| wanted.ego.is_some() || !is_towed(a));
            while !left.is_empty() {
                let ego = left.swap_remove(rng.below(left.len()));
                let end = |t: usize| t.saturating_add(config.horizon_steps).min(scene.num_steps - 1);
                let goes = |t| {
                    anyhow && scene.is_valid(ego, t) && scene.is_valid(ego, end(t))
                        || drives_on(scene, ego, t, config.horizon_steps)
                };
                let moving = steps.clone().filter(|t| goes(*t));
                let moving: Vec<usize> = moving.filter(|t| stays(ego, *t)).collect();
                if !moving.is_empty() {
                    return Some(Self { ego: Some(ego), step_idx: moving[rng.below(moving.len())] });
                }
            }
        }
        let ego = wanted.ego.or_else(|| scene.agent_index(EGO_ID))?;
        let step_idx = steps.clone().find(|t| scene.is_valid(ego, *t))?;
        Some(Self { ego: Some(ego), step_idx })
    }
}

impl Wanted {
    /// Refuses what episodes of a configuration cannot start with in a scene, which a reset must name.
    pub(crate) fn check(&self, scene: Option<&Scene>, config: &WorldConfig) -> Result<()> {
        check_style(&self.style, &config.style)?;
        if self.ego.is_none() && self.start.is_none() {
            return Ok(());
        }
        let field = if self.ego.is_some() { "ego" } else { "start" };
        if config.controlled != Controlled::Any {
            let expected = "nothing: who starts where is drawn with ego=\"any\"";
            return Err(SimError::config(field, "given", expected));
        }
        let Some(scene) = scene else {
            return Err(SimError::config(field, "given without a scene", "a scene besides"));
        };
        let is_vehicle = |a: usize| scene.agents.get(a).is_some_and(|agent| agent.kind == AgentKind::Vehicle);
        if let Some(a) = self.ego.filter(|a| !is_vehicle(*a)) {
            let got = scene.agents.get(a).map_or_else(|| a.to_string(), |agent| agent.id.clone());
            return Err(SimError::config("ego", got, format!("a vehicle of {}", scene.name)));
        }
        let (first, last) = (config.history_steps, scene.num_steps - 2);
        if let Some(step) = self.start.filter(|step| !(first..=last).contains(step)) {
            return Err(SimError::config("start", step, format!("{first} to {last} in {}", scene.name)));
        }
        if Start::draw(scene, None, config, self, Rng::new(0)).is_none() {
            let got = self.ego.map_or_else(|| "nobody".into(), |a| scene.agents[a].id.clone());
            let at = self.start.map_or_else(|| "a start".into(), |step| format!("step {step}"));
            let expected = format!("a vehicle that is logged at {at} of {}", scene.name);
            return Err(SimError::config("ego", got, expected));
        }
        Ok(())
    }
}
