//! One world's tick, phase by phase. The order of the phases is fixed here and nowhere else.

use crate::dynamics::{Action, Dynamics};
use crate::error::{Result, SimError};
use crate::events::{Collisions, Contact, ContactKind, LeastTimes};
use crate::geom::{Pose2, Real, Vector2};
use crate::observe::{EgoFacts, Observer, View};
use crate::policy::{Driver, Motion, PlanRequest, WorldView};
use crate::scene::AgentKind;
use crate::world::actions::ActionDecoder;
use crate::world::assist;
use crate::world::buffers::{Extent, StepBuffers};
use crate::world::columns::{Col, Earlier, NUM_COLUMNS, TTC_HORIZON_S};
use crate::world::config::{Autoreset, Consequence, TrafficCollision, WorldConfig};
use crate::world::episode::{Episode, Phase};
use crate::world::halt;
use crate::world::policies::Policies;
use crate::world::prepared::PreparedScene;
use crate::world::reward;
use crate::world::surroundings::{log_distance, place_is_free, road_and_lane, touching};
use crate::world::tally::Metrics;
use std::ops::Range;
use std::sync::Arc;

/// From this many slots on, contacts are looked for among all agents at once.
const JOINT_DETECTION_SLOTS: usize = 4;

/// Parts of a tick, for the cost split of the benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum TickPhase {
    /// Actions decoded, background motions asked for.
    Decide = 0,
    /// Agents moved, entered, left.
    Move = 1,
    /// Collisions, road, lanes.
    Events = 2,
    /// Rewards, figures, endings.
    Reward = 3,
    /// Observations written.
    Observe = 4,
}

impl TickPhase {
    /// All phases in order.
    pub const ALL: [Self; 5] = [Self::Decide, Self::Move, Self::Events, Self::Reward, Self::Observe];
}

/// A world: its state and the memory its tick works in.
pub(crate) struct World {
    pub(crate) idx: usize,
    pub(crate) scene: Arc<PreparedScene>,
    pub(crate) episode: Episode,
    motions: Vec<(u32, Motion)>,
    /// Poses before the step, where contacts stop the traffic.
    before: Vec<Pose2>,
    /// Physical actions of the slots.
    actions: Vec<Action>,
    contacts: Vec<Option<Contact>>,
    /// Metrics of the slots in the last episode that ended.
    pub(crate) ended: Vec<Metrics>,
    collisions: Collisions,
    least_times: LeastTimes,
    observer: Observer,
}

/// What all worlds of a batch have in common.
pub(crate) struct Shared<'a> {
    pub(crate) config: &'a WorldConfig,
    pub(crate) decoder: &'a ActionDecoder,
    pub(crate) policies: &'a Policies,
    pub(crate) extent: Extent,
}

impl World {
    pub(crate) fn new(idx: usize, num_scenes: usize, scene: Arc<PreparedScene>, observer: Observer) -> Self {
        let episode = Episode::new(idx, num_scenes);
        Self {
            idx,
            scene,
            episode,
            motions: Vec::new(),
            before: Vec::new(),
            actions: Vec::new(),
            contacts: Vec::new(),
            ended: Vec::new(),
            collisions: Collisions::new(),
            least_times: LeastTimes::default(),
            observer,
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
            drivers: &e.drivers,
            halted: &e.halted,
            history: e.history.as_ref(),
            step_idx: e.step_idx,
            elapsed_steps: e.elapsed_steps,
            noise_seed: e.noise_seed(),
            config,
        }
    }

    /// What a policy of the table is asked about this world.
    pub(crate) fn request<'a>(&'a self, config: &'a WorldConfig, policy_idx: u16) -> PlanRequest<'a> {
        PlanRequest {
            world: self.view(config),
            driver: Driver::Policy(policy_idx),
            plan: self.episode.plans[usize::from(policy_idx)].as_ref(),
            command: &self.episode.command,
        }
    }

    /// Begins an episode in a scene.
    pub(crate) fn begin(&mut self, scene: Arc<PreparedScene>, scene_idx: usize, shared: &Shared<'_>) {
        self.scene = scene;
        self.episode.begin(&self.scene, scene_idx, shared.config, shared.policies);
        halt::begin(&mut self.episode, &self.scene, &mut self.collisions);
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

    /// Advances a running world by the next step of a decision, up to and with its rewards; returns whether its
    /// episode ended.
    pub(crate) fn advance(
        &mut self,
        actions: &[Real],
        is_first: bool,
        shared: &Shared<'_>,
        out: &mut StepBuffers<'_>,
        lap: &mut impl FnMut(TickPhase),
    ) -> bool {
        self.decide(actions, shared);
        lap(TickPhase::Decide);
        self.move_agents(shared);
        lap(TickPhase::Move);
        self.find_events(shared.config, false);
        lap(TickPhase::Events);
        let done = self.reward(shared.config, is_first, out);
        lap(TickPhase::Reward);
        done
    }

    fn decide(&mut self, actions: &[Real], shared: &Shared<'_>) {
        let width = shared.decoder.width();
        self.actions.clear();
        for (c, slot) in self.episode.slots.iter_mut().enumerate() {
            let external = slot.agent_idx.is_some_and(|a| self.episode.drivers[a] == Driver::External);
            let mut physical = [0.0; 3];
            if external && slot.alive {
                physical = shared.decoder.decode(&actions[c * width..(c + 1) * width]);
                slot.last_action = shared.decoder.normalise(&physical);
            }
            self.actions.push(physical);
        }
        let mut motions = std::mem::take(&mut self.motions);
        motions.clear();
        let mut own = std::mem::take(&mut self.actions);
        let view = self.view(shared.config);
        if let Dynamics::Assisted(limits) = shared.decoder.dynamics() {
            for (slot, action) in self.episode.slots.iter().zip(&mut own) {
                if let Some(a) = slot.agent_idx.filter(|a| view.drivers[*a] == Driver::External) {
                    *action = assist::unicycle_action(limits, &view, a, *action);
                }
            }
        }
        for a in 0..view.states.len() {
            let Driver::Policy(policy_idx) = view.drivers[a] else { continue };
            // obstacles do not move
            if view.states.active[a] && view.scene.kinds[a] != AgentKind::Static {
                let plan = self.episode.plans[usize::from(policy_idx)].as_ref();
                motions.push((a as u32, shared.policies.get(policy_idx).act(&view, plan, a)));
            }
        }
        (self.motions, self.actions) = (motions, own);
    }

    fn move_agents(&mut self, shared: &Shared<'_>) {
        let config = shared.config;
        let e = &mut self.episode;
        e.step_idx += 1;
        e.elapsed_steps += 1;
        let stops = config.on_traffic_collision == TrafficCollision::Stop;
        self.before.clear();
        if stops {
            self.before.extend((0..e.states.len()).map(|a| e.states.pose(a)));
        }
        for (c, slot) in e.slots.iter().enumerate() {
            let Some(a) = slot.agent_idx.filter(|a| e.states.active[*a]) else { continue };
            if slot.stopped {
                let pose = e.states.pose(a);
                e.states.place(a, pose, Vector2::zeros());
            } else if e.drivers[a] == Driver::External {
                let body = &self.scene.bodies[a];
                shared.decoder.dynamics().step_agent(&mut e.states, a, self.actions[c], config.dt_s, body);
            }
        }
        for (a, motion) in self.motions.drain(..) {
            let a = a as usize;
            let slot = e.slots.iter().find(|s| s.agent_idx == Some(a));
            let log_ended = config.vanish_with_log && !self.scene.scene.is_valid(a, e.step_idx);
            match (motion, slot) {
                (_, Some(slot)) if slot.stopped => {}
                (Motion::Place(pose, velocity), Some(_)) => e.place(a, pose, velocity, config.dt_s),
                // an agent with a slot waits where its policy has no more way for it
                (Motion::Leave, Some(_)) => {
                    let pose = e.states.pose(a);
                    e.place(a, pose, Vector2::zeros(), config.dt_s);
                }
                (_, None) if e.halted[a] && !log_ended => {
                    let pose = e.states.pose(a);
                    e.place(a, pose, Vector2::zeros(), config.dt_s);
                }
                (Motion::Place(pose, velocity), None) if !log_ended => {
                    e.place(a, pose, velocity, config.dt_s);
                }
                _ => e.states.active[a] = false,
            }
        }
        if stops && e.drivers.iter().any(|d| !matches!(*d, Driver::External | Driver::REPLAY)) {
            halt::halt(e, &self.scene, &mut self.collisions, &self.before);
        }
        for a in 0..e.states.len() {
            let follows_route = e.drivers[a] != Driver::REPLAY || e.has_slot(a);
            if e.states.active[a] && follows_route {
                let path = &self.scene.routes[a].path;
                e.route_s_m[a] = path.project_near(e.states.position(a), e.route_s_m[a], 8.0).s_m;
            }
        }
        if config.late_arrivals {
            for a in 0..self.scene.scene.num_agents() {
                if !e.entered[a]
                    && self.scene.scene.is_valid(a, e.step_idx)
                    && place_is_free(e, &self.scene, a)
                {
                    e.enter(&self.scene, a);
                }
            }
        }
        if let Some(history) = &mut e.history {
            history.push(&e.states);
        }
    }

    /// Finds out what happened to the agents with slots. At the start of an episode contacts are taken as given.
    fn find_events(&mut self, config: &WorldConfig, at_start: bool) {
        let e = &mut self.episode;
        let scene = &*self.scene;
        self.contacts.clear();
        self.contacts.resize(e.slots.len(), None);
        let mut standing = std::mem::take(&mut e.initial_contacts);
        standing.retain(|(i, j)| touching(&e.states, scene, *i as usize, *j as usize));
        let jointly = e.slots.len() >= JOINT_DETECTION_SLOTS;
        if jointly {
            self.collisions.detect(&e.states, &scene.bodies, &scene.kinds);
        }
        for c in 0..e.slots.len() {
            let Some(a) = e.slots[c].agent_idx.filter(|a| e.states.active[*a]) else { continue };
            let mut meet = |j: usize| {
                let pair = (a as u32, j as u32);
                if at_start {
                    standing.push(pair);
                } else if !standing.contains(&pair) && self.contacts[c].is_none() {
                    self.contacts[c] = Some(Contact::between(&e.states, &scene.bodies, a, j));
                }
            };
            if jointly {
                for (i, j) in self.collisions.pairs() {
                    let (i, j) = (*i as usize, *j as usize);
                    if i == a {
                        meet(j);
                    } else if j == a {
                        meet(i);
                    }
                }
            } else {
                (0..e.states.len())
                    .filter(|j| *j != a && touching(&e.states, scene, a, *j))
                    .for_each(&mut meet);
            }
            road_and_lane(&e.states, scene, a, e.route_s_m[a], &mut e.slots[c], config);
        }
        e.initial_contacts = standing;
    }

    /// Rewards and figures of a step; those of earlier steps of the decision lie in `out`, zero for the first one.
    fn reward(&mut self, config: &WorldConfig, is_first: bool, out: &mut StepBuffers<'_>) -> bool {
        let e = &mut self.episode;
        let at_end = e.elapsed_steps >= config.horizon_steps
            || (config.truncate_at_log_end && e.step_idx + 1 >= self.scene.scene.num_steps);
        self.least_times.prepare(&e.states, &self.scene.bodies);
        for c in 0..e.slots.len() {
            let Some(a) = e.slots[c].agent_idx.filter(|_| e.slots[c].alive) else { continue };
            let columns = &mut out.columns[c * NUM_COLUMNS..(c + 1) * NUM_COLUMNS];
            let earlier = (!is_first).then(|| Earlier::of(out.reward[c], columns));
            let contact = self.contacts[c];
            let facts = StepFacts {
                contact: contact.filter(|_| !e.slots[c].touching),
                ttc_s: self.least_times.of(&e.states, &self.scene.bodies, a, TTC_HORIZON_S),
                log_distance_m: log_distance(e, &self.scene, a),
            };
            let slot = &mut e.slots[c];
            slot.touching = contact.is_some();
            let before_m = slot.best_s_m;
            slot.best_s_m = before_m.max(e.route_s_m[a].min(slot.goal_s_m));
            let reward = reward::score(&e.states, a, slot, &facts, before_m, config, columns);
            let ends = |event: bool, consequence: Consequence| {
                event && matches!(consequence, Consequence::Terminate | Consequence::Remove)
            };
            let collided = facts.contact.is_some();
            let reached = columns[Col::GoalReached as usize] > 0.0;
            out.terminated[c] = ends(collided, config.on_collision)
                || ends(slot.off_road, config.on_off_road)
                || (reached && config.terminate_at_goal);
            out.truncated[c] = at_end && !out.terminated[c];
            columns[Col::TimeLimit as usize] = f32::from(out.truncated[c]);
            let gone = |event: bool, consequence: Consequence| event && consequence == Consequence::Remove;
            let halted = |event: bool, consequence: Consequence| event && consequence == Consequence::Stop;
            slot.stopped |=
                halted(collided, config.on_collision) || halted(slot.off_road, config.on_off_road);
            let ended = out.terminated[c] || out.truncated[c];
            columns[Col::Success as usize] = f32::from(ended && reward::is_success(slot));
            slot.tally.add(reward, columns);
            out.reward[c] = earlier.map_or(reward, |earlier| earlier.join(reward, columns));
            if ended {
                slot.alive = false;
                slot.ended_at = Some(e.elapsed_steps);
                // who ends by an accident stays in the others' way; who reached its goal leaves
                slot.stopped = true;
                let leaves = (reached && !collided && !slot.off_road)
                    || gone(collided, config.on_collision)
                    || gone(slot.off_road, config.on_off_road);
                e.states.active[a] &= !leaves;
            }
        }
        let done = e.slots.iter().all(|s| !s.alive);
        if done {
            e.phase = Phase::Ended;
            self.ended.clear();
            self.ended.extend(e.slots.iter().map(|s| s.tally.metrics()));
        }
        done
    }

    /// Writes the observations of all slots: of agents that go on, and of those whose episode ended in this very
    /// step. Those of agents whose episode ended after `since` elapsed steps are there already. Rows and rasters of
    /// the others are zero.
    pub(crate) fn observe(
        &mut self,
        config: &WorldConfig,
        extent: Extent,
        since: usize,
        obs: &mut [Real],
        bev: &mut [u8],
    ) {
        let e = &self.episode;
        self.observer.prepare(&e.states, &self.scene.bodies);
        let bytes = extent.raster.iter().product::<usize>();
        for (c, slot) in e.slots.iter().enumerate() {
            let out = &mut obs[c * extent.row..(c + 1) * extent.row];
            let raster = &mut bev[c * bytes..(c + 1) * bytes];
            if slot.ended_at.is_some_and(|at| since < at && at < e.elapsed_steps) {
                continue;
            }
            let shown = slot.alive || slot.ended_at == Some(e.elapsed_steps);
            let Some(a) = slot.agent_idx.filter(|_| shown) else {
                out.fill(0.0);
                raster.fill(0);
                continue;
            };
            let route = &self.scene.routes[a].path;
            let facts = EgoFacts {
                last_action: [slot.last_action[0], slot.last_action[1]],
                speed_limit_mps: slot.speed_limit_mps,
                lane_distance_m: slot.lane_distance_m,
                lateral_m: slot.route_distance_m,
                heading_error_rad: slot.route_heading_error_rad,
                off_road: slot.off_road,
                collided: slot.touching,
                route_remaining_m: (slot.goal_s_m - e.route_s_m[a]).max(0.0),
                time_remaining: 1.0 - e.elapsed_steps as Real / config.horizon_steps as Real,
            };
            let view = View {
                states: &e.states,
                bodies: &self.scene.bodies,
                kinds: &self.scene.kinds,
                pieces: &self.scene.pieces,
                route,
                route_s_m: e.route_s_m[a],
                agent_idx: a,
                anticipation_s: config.idm.anticipation_s,
                facts,
            };
            self.observer.write(&view, out);
            if let (Some(bev), Some(ground)) = (&config.observation.bev, &self.scene.ground) {
                bev.draw(&view, ground, raster);
            }
        }
    }

    /// Steps `held` of a decision: advance to the last of them or the episode's end, or the reset that NEXT_STEP owes;
    /// then observations. Nothing where the episode has ended in an earlier step of the decision.
    pub(crate) fn step(
        &mut self,
        actions: &[Real],
        held: Range<usize>,
        shared: &Shared<'_>,
        next_scene: impl FnOnce(&mut Episode) -> (Arc<PreparedScene>, usize),
        out: &mut StepBuffers<'_>,
        lap: &mut impl FnMut(TickPhase),
    ) {
        if held.start == 0 {
            out.clear_step();
            out.was_reset[0] = false;
        } else if out.done[0] || out.was_reset[0] {
            return;
        }
        // the batch has refused ended worlds before, in every mode but NEXT_STEP
        let owed = self.episode.phase == Phase::Ended;
        let since = self.episode.elapsed_steps.saturating_sub(held.start);
        let goes_on = held.end < shared.config.decision_steps;
        for step in held.filter(|_| !owed) {
            out.done[0] = self.advance(actions, step == 0, shared, out, lap);
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
        let ends_now = out.done[0] && shared.config.autoreset == Autoreset::SameStep;
        if ends_now {
            out.final_obs.copy_from_slice(out.obs);
            out.final_bev.copy_from_slice(out.bev);
            self.observe(shared.config, shared.extent, since, out.final_obs, out.final_bev);
        }
        if owed || ends_now {
            let (scene, scene_idx) = next_scene(&mut self.episode);
            self.begin(scene, scene_idx, shared);
            out.was_reset[0] = true;
        }
        if out.done[0] || out.was_reset[0] || !goes_on {
            self.finish(shared, since, out);
            lap(TickPhase::Observe);
        }
    }

    /// Writes who is alive, and the observations.
    pub(crate) fn finish(&mut self, shared: &Shared<'_>, since: usize, out: &mut StepBuffers<'_>) {
        for (alive, slot) in out.alive.iter_mut().zip(&self.episode.slots) {
            *alive = slot.alive;
        }
        self.observe(shared.config, shared.extent, since, out.obs, out.bev);
    }
}

/// What a slot's reward is made from, besides its state.
pub(crate) struct StepFacts {
    /// A contact that begins in this step.
    pub(crate) contact: Option<Contact>,
    pub(crate) ttc_s: Real,
    pub(crate) log_distance_m: Real,
}

impl StepFacts {
    /// Number of the side that is hit, as in the columns.
    pub(crate) fn contact_number(&self) -> Real {
        match self.contact.map(|c| c.kind) {
            None => 0.0,
            Some(ContactKind::Front) => 1.0,
            Some(ContactKind::Rear) => 2.0,
            Some(ContactKind::Side) => 3.0,
        }
    }
}
