//! One world's tick, phase by phase. The order of the phases is fixed here and nowhere else.

mod actions;
mod arrival;
mod assist;
mod decide;
mod detect;
mod halt;
mod motion;
mod reward;
mod roles;
mod rows;
mod surroundings;
mod sweep;
mod termination;
mod tow;

pub use actions::ActionDecoder;
pub use assist::assisted_action;
pub use surroundings::place_on_route;
pub(super) use surroundings::straddles_lanes;
pub(super) use tow::find_towed;

use crate::drivers::{AgentMotion, Driver, PlanRequest, WorldView};
use crate::dynamics::Action;
use crate::error::{Result, SimError};
use crate::events::{Collisions, Contact, LeastTimes};
use crate::geom::{Pose2, Real};
use crate::observe::Observer;
use crate::scene::EGO_ID;
use crate::stage::PreparedScene;
use crate::world::buffers::{Extent, StepBuffers};
use crate::world::config::{Autoreset, Controlled, WorldConfig};
use crate::world::driver_table::DriverTable;
use crate::world::episode::{Episode, Metrics, Phase, Wanted};
use std::ops::Range;
use std::sync::Arc;

/// A world: its scene, its episode, what follows from these, and the memory its tick works in.
pub(crate) struct World {
    pub(crate) idx: usize,
    pub(crate) scene: Arc<PreparedScene>,
    pub(crate) episode: Episode,
    /// Metrics of the slots in the last episode that ended.
    pub(crate) ended: Vec<Metrics>,
    pub(super) adversaries: Vec<bool>,
    /// Presence of all agents before a step, where poses before it are kept.
    pub(super) active_before: Vec<bool>,
    pub(super) observer: Observer,
    pub(super) scratch: Box<Scratch>,
}

/// Memory that a step works in: dropped between steps, nothing would change.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) motions: Vec<(u32, AgentMotion)>,
    /// Agents that the log moves in the step, without a motion of theirs, and memory for it.
    pub(super) follow_log: Vec<bool>,
    pub(super) masks: Vec<u32>,
    /// Poses before the step, where contacts stop the traffic.
    pub(super) before: Vec<Pose2>,
    pub(super) actions: Vec<Action>,
    /// Agents with slots that are there.
    pub(super) present: Vec<u32>,
    /// Contact of each slot that begins in the step, and slots with the agents that theirs touch in it.
    pub(super) contacts: Vec<Option<Contact>>,
    pub(super) touched: Vec<(u32, u32)>,
    /// Distance of each slot's agent from its place on the route, metres.
    pub(super) from_route_m: Vec<Real>,
    /// The slot of each agent that has one.
    pub(super) slot_of: Vec<Option<u32>>,
    pub(super) collisions: Collisions,
    pub(super) least_times: LeastTimes,
}

/// What all worlds of a batch have in common.
pub(crate) struct Shared<'a> {
    pub(crate) config: &'a WorldConfig,
    pub(crate) decoder: &'a ActionDecoder,
    pub(crate) drivers: &'a DriverTable,
    pub(crate) extent: Extent,
}

impl World {
    pub(crate) fn new(idx: usize, num_scenes: usize, scene: Arc<PreparedScene>, observer: Observer) -> Self {
        let episode = Episode::new(idx, num_scenes);
        let mut world = Self {
            idx,
            scene,
            episode,
            ended: Vec::new(),
            adversaries: Vec::new(),
            active_before: Vec::new(),
            observer,
            scratch: Box::default(),
        };
        world.enter(Arc::clone(&world.scene));
        world
    }

    /// Puts another scene under the world.
    pub(super) fn enter(&mut self, scene: Arc<PreparedScene>) {
        self.scene = scene;
        self.observer.enter(&self.scene.footprints, &self.scene.kinds, &self.scene.segments);
    }

    /// Gives the agents with slots the sizes that were drawn for them.
    pub(super) fn resize(&mut self) {
        let factors = self.episode.slots.iter().filter_map(|s| Some((s.agent_idx?, s.drawn.size)));
        let others: Vec<_> = factors.filter(|(_, factor)| *factor != 1.0).collect();
        if !others.is_empty() {
            self.enter(Arc::new(self.scene.resized(&others)));
        }
    }

    /// The ego of the present episode: the data's, unless it is drawn.
    pub(crate) fn ego(&self, config: &WorldConfig) -> Option<usize> {
        match config.controlled {
            Controlled::Any => self.episode.slots.first()?.agent_idx,
            _ => self.scene.scene.agent_index(EGO_ID),
        }
    }

    pub(crate) fn view<'a>(&'a self, config: &'a WorldConfig) -> WorldView<'a> {
        let e = &self.episode;
        WorldView {
            world_idx: self.idx,
            scene_idx: e.scene_idx,
            scene: &self.scene,
            states: &e.states,
            route_s_m: &e.route_s_m,
            ego: self.ego(config),
            drivers: &e.drivers,
            halted: &e.halted,
            history: e.history.as_ref(),
            step_idx: e.step_idx,
            elapsed_steps: e.elapsed_steps,
            horizon_steps: config.horizon_steps,
            noise_seed: e.noise_seed(),
            dt_s: config.dt_s,
            speed_limit_mps: config.speed_limit_mps,
            idm: &config.idm,
        }
    }

    /// What a driver of the table is asked about this world.
    pub(crate) fn request<'a>(&'a self, config: &'a WorldConfig, driver_idx: u16) -> PlanRequest<'a> {
        PlanRequest {
            world: self.view(config),
            driver: Driver::Model(driver_idx),
            plan: self.episode.plans[usize::from(driver_idx)].as_ref(),
            plan_override: &self.episode.plan_override,
        }
    }

    /// Begins an episode in a scene.
    pub(crate) fn begin(
        &mut self,
        scene: Arc<PreparedScene>,
        scene_idx: usize,
        shared: &Shared<'_>,
        wanted: &Wanted,
    ) {
        self.enter(scene);
        self.episode.begin(&self.scene, scene_idx, shared.config, shared.drivers, wanted);
        tow::find_towed(&mut self.episode, &self.scene);
        self.resize();
        halt::begin(&mut self.episode, &self.scene, &mut self.scratch.collisions);
        self.cast(shared.config);
        self.find_events(shared.config, true);
    }

    /// Refuses actions that are no numbers, before anything moves.
    pub(crate) fn check_actions(&self, actions: &[Real], decoder: &ActionDecoder) -> Result<()> {
        if self.episode.phase == Phase::Running {
            for (c, slot) in self.episode.slots.iter().enumerate() {
                let external = slot.agent_idx.is_some_and(|a| self.episode.drivers[a] == Driver::External);
                if slot.alive && external {
                    let width = decoder.width();
                    decoder.check(&actions[c * width..(c + 1) * width]).map_err(|(got, expected)| {
                        SimError::Action { world: self.idx, slot: c, got, expected }
                    })?;
                }
            }
        }
        Ok(())
    }

    /// Advances a running world by one step, rewards included; returns whether its episode ended.
    pub(crate) fn advance(
        &mut self,
        actions: &[Real],
        is_first: bool,
        shared: &Shared<'_>,
        out: &mut StepBuffers<'_>,
    ) -> bool {
        self.decide(actions, shared);
        self.move_agents(shared);
        self.find_events(shared.config, false);
        self.reward(shared.config, is_first, out)
    }

    /// Steps `held` of a decision, or the reset that NEXT_STEP owes, then observations; nothing after an end in it.
    pub(crate) fn step(
        &mut self,
        actions: &[Real],
        held: Range<usize>,
        shared: &Shared<'_>,
        next_scene: impl FnOnce(&mut Episode) -> (Arc<PreparedScene>, usize),
        out: &mut StepBuffers<'_>,
    ) {
        if held.start == 0 {
            out.clear_step();
            out.was_reset[0] = false;
        } else if out.done[0] || out.was_reset[0] {
            return;
        }
        // the batch has refused ended worlds before, in every mode but NEXT_STEP
        let reset_pending = self.episode.phase == Phase::Ended;
        let since = self.episode.elapsed_steps.saturating_sub(held.start);
        let goes_on = held.end < shared.config.decision_steps;
        for step in held.filter(|_| !reset_pending) {
            out.done[0] = self.advance(actions, step == 0, shared, out);
            if out.done[0] {
                break;
            }
            // others play on: what an agent sees at its end is written now
            let now = self.episode.elapsed_steps;
            if step + 1 < shared.config.decision_steps
                && self.episode.slots.iter().any(|s| s.ended_at == Some(now))
            {
                self.observe(shared.config, shared.extent, since, out.obs, out.bev);
            }
        }
        if !reset_pending && (out.done[0] || !goes_on) && self.play_roles(shared.config, since, out) {
            out.done[0] = true;
        }
        self.autoreset(reset_pending, since, shared, next_scene, out);
        if out.done[0] || out.was_reset[0] || !goes_on {
            self.finish(shared, since, out);
        }
    }

    /// Begins the next episode where it is due; SAME_STEP first writes the last observations of this one aside.
    fn autoreset(
        &mut self,
        reset_pending: bool,
        since: usize,
        shared: &Shared<'_>,
        next_scene: impl FnOnce(&mut Episode) -> (Arc<PreparedScene>, usize),
        out: &mut StepBuffers<'_>,
    ) {
        let ends_now = out.done[0] && shared.config.autoreset == Autoreset::SameStep;
        if ends_now {
            self.keep_earlier(shared.extent, since, out);
            self.observe(shared.config, shared.extent, since, out.final_obs, out.final_bev);
        }
        if reset_pending || ends_now {
            let (scene, scene_idx) = next_scene(&mut self.episode);
            self.begin(scene, scene_idx, shared, &Wanted::default());
            out.was_reset[0] = true;
        }
    }

    /// Writes a step in which nothing happened; observations stay as they are in the buffers.
    pub(crate) fn rest(&self, out: &mut StepBuffers<'_>) {
        out.clear_step();
        out.was_reset[0] = false;
        self.write_alive(out);
    }

    fn write_alive(&self, out: &mut StepBuffers<'_>) {
        out.alive.fill(false);
        for (alive, slot) in out.alive.iter_mut().zip(&self.episode.slots) {
            *alive = slot.alive;
        }
    }

    /// Writes which slots are alive, and the observations.
    pub(crate) fn finish(&mut self, shared: &Shared<'_>, since: usize, out: &mut StepBuffers<'_>) {
        self.write_alive(out);
        self.observe(shared.config, shared.extent, since, out.obs, out.bev);
    }
}
