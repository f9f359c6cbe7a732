//! The whole mutable state of one running world, and how an episode begins. What is here is what a snapshot holds.

mod progress;
mod ranked;
mod start;
mod statistics;

pub use ranked::ranked_vehicles;
pub(crate) use start::Start;
pub use start::{LEAST_WAY_M, Wanted};
pub use statistics::{METRICS, Metrics, NUM_METRICS};

use crate::drivers::{Driver, PlanOverride, PlanState};
use crate::geom::math::is_sound;
use crate::geom::{Pose2, Real, Vector2};
use crate::observe::RoutePlace;
use crate::options::CRITICALITY;
use crate::scene::{AgentKind, Scene};
use crate::stage::History;
use crate::stage::PreparedScene;
use crate::state::{AgentStates, Height};
use crate::world::config::{Controlled, Drawn, VehicleRanking, WorldConfig};
use crate::world::driver_table::DriverTable;
use crate::world::rng::Rng;
use progress::Progress;
use serde::{Deserialize, Serialize};
use statistics::EpisodeStatistics;
use std::collections::BTreeMap;

/// Steps of an episode are far fewer.
const MOST_STEPS: usize = 1 << 30;

/// Where a world is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum Phase {
    #[default]
    NeverReset,
    Running,
    Ended,
}

/// A controlled agent's own account.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Slot {
    /// Its agent; `None` where it is empty.
    pub agent_idx: Option<usize>,
    /// Whether its agent goes on in the present episode.
    pub alive: bool,
    /// Elapsed steps at which the agent's episode ended.
    pub(crate) ended_at: Option<usize>,
    /// Stands still whatever its action.
    pub(crate) stopped: bool,
    pub(crate) progress: Progress,
    pub(crate) last_action: [Real; 3],
    /// Acceleration of the step before, for the jerk.
    pub(crate) acceleration_mps2: Real,
    pub(crate) ever_collided: bool,
    pub(crate) ever_off_road: bool,
    /// Whether it has reached its goal, without a collision or a step off the road up to then: a success.
    pub(crate) arrived_unharmed: bool,
    /// Whether the agent has been on the road; before that, it is not counted as off the road.
    pub(crate) has_been_on_road: bool,
    // what the last step found out, for reward and observation
    pub(crate) off_road: bool,
    pub(crate) off_road_centroid: bool,
    pub(crate) place: RoutePlace,
    pub(crate) statistics: EpisodeStatistics,
    /// What was drawn for it.
    pub drawn: Drawn,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Episode {
    pub(crate) phase: Phase,
    pub(crate) rng: Rng,
    /// Seed that the generator was last started from.
    pub(crate) seed: u64,
    /// Episodes begun since then.
    pub(crate) number: u64,
    pub(crate) scene_idx: usize,
    /// Scene of the next episode in sequential order.
    pub(crate) next_scene_idx: usize,
    /// Step of the log that belongs to the states.
    pub(crate) step_idx: usize,
    pub(crate) elapsed_steps: usize,
    pub(crate) states: AgentStates,
    pub(crate) route_s_m: Vec<Real>,
    pub(crate) drivers: Vec<Driver>,
    /// Whether an agent has been in the world: those that do not follow their log enter once.
    pub(crate) entered: Vec<bool>,
    /// Pairs that touch since the start and are no collisions until they have parted.
    pub(crate) initial_contacts: Vec<(u32, u32)>,
    /// Slots and the agents that theirs touched in the last step, but for these.
    pub(crate) contacts: Vec<(u32, u32)>,
    /// Pairs since the start for all agents, where contacts stop the traffic.
    pub(crate) given_contacts: Vec<(u32, u32)>,
    /// Whether a contact has stopped an agent without a slot.
    pub(crate) halted: Vec<bool>,
    pub(crate) slots: Vec<Slot>,
    pub(crate) history: Option<History>,
    /// The plan of each driver of the batch's table.
    pub(crate) plans: Vec<Option<PlanState>>,
    /// What is asked of these plans.
    pub(crate) plan_override: PlanOverride,
}

impl Episode {
    pub(crate) fn new(world_idx: usize, num_scenes: usize) -> Self {
        Self {
            rng: Rng::new(world_idx as u64),
            seed: world_idx as u64,
            next_scene_idx: world_idx % num_scenes,
            ..Self::default()
        }
    }

    /// Steps of the episode that are left: to its horizon, or to the end of the log where that ends it.
    pub(crate) fn steps_left(&self, scene: &PreparedScene, config: &WorldConfig) -> usize {
        let left = config.horizon_steps.saturating_sub(self.elapsed_steps);
        let logged = (scene.scene.num_steps - 1).saturating_sub(self.step_idx);
        if config.truncate_at_log_end { left.min(logged) } else { left }
    }

    /// Puts the agents where the log has them after the history, and hands out slots and drivers.
    pub(crate) fn begin(
        &mut self,
        scene: &PreparedScene,
        scene_idx: usize,
        config: &WorldConfig,
        drivers: &DriverTable,
        wanted: &Wanted,
    ) {
        let log = &scene.scene;
        let num_agents = log.num_agents();
        self.phase = Phase::Running;
        self.number += 1;
        self.scene_idx = scene_idx;
        let rng = Rng::of_episode(self.seed, self.number).split(u64::MAX);
        let start = Start::draw(log, Some(scene), config, wanted, rng);
        let start = start.unwrap_or(Start { ego: None, step_idx: config.history_steps });
        self.step_idx = start.step_idx;
        self.elapsed_steps = 0;
        self.states.clear_for(num_agents);
        if log.has_levels() {
            self.states.heights.resize(num_agents, Height::default());
        }
        self.route_s_m.clear();
        self.route_s_m.resize(num_agents, 0.0);
        self.entered.clear();
        self.entered.resize(num_agents, false);
        self.drivers.clear();
        let (seed, number) = (self.seed, self.number);
        self.drivers.extend(scene.kinds.iter().enumerate().map(|(a, kind)| match kind {
            AgentKind::Vehicle => drivers.of_vehicle(seed, number, a),
            AgentKind::Pedestrian => drivers.pedestrians,
            _ => Driver::REPLAY,
        }));
        for a in 0..num_agents {
            if log.is_valid(a, self.step_idx) {
                self.enter(scene, a, config.dt_s);
            }
        }
        self.fill_slots(scene, config, drivers.slots, start.ego, &wanted.style);
        for (id, driver) in &drivers.by_id {
            let agent = log.agent_index(id).filter(|a| scene.kinds[*a] == AgentKind::Vehicle);
            // actions reach agents with a slot only
            let takes = |a: &usize| *driver != Driver::External || self.has_slot(*a);
            if let Some(a) = agent.filter(takes) {
                self.drivers[a] = *driver;
            }
        }
        self.states.chain.clone_from(&scene.chains);
        self.initial_contacts.clear();
        self.contacts.clear();
        let len = drivers.history_states;
        self.history = (len > 0).then(|| History::from_log(log, self.step_idx, len));
        self.plans.clear();
        self.plans.resize(drivers.len(), None);
        self.plan_override = PlanOverride::default();
    }

    /// Puts an agent at its logged state of the present step. Accelerations and yaw rates are the log's.
    pub(crate) fn enter(&mut self, scene: &PreparedScene, agent_idx: usize, dt_s: Real) {
        let Some((pose, _)) = scene.log.at(agent_idx, self.step_idx) else { return };
        self.states.set_pose(agent_idx, pose, self.velocity_at_entry(&scene.scene, agent_idx));
        let (acceleration, yaw_rate) = scene.log.rates(agent_idx, self.step_idx, dt_s);
        self.states.acceleration_mps2[agent_idx] = acceleration;
        self.states.yaw_rate_radps[agent_idx] = yaw_rate;
        self.states.active[agent_idx] = true;
        if let Some(height) = scene.log.height(agent_idx, self.step_idx) {
            self.states.heights[agent_idx] = height;
        }
        self.entered[agent_idx] = true;
        self.route_s_m[agent_idx] = scene.logged_s_m(agent_idx, self.step_idx);
    }

    /// Logged velocity; for driven late arrivals the mean of their first second: tracks end in two annotations.
    fn velocity_at_entry(&self, log: &Scene, agent_idx: usize) -> Vector2 {
        let at = log.at(agent_idx, self.step_idx);
        let replays = self.elapsed_steps == 0 || self.drivers[agent_idx] == Driver::REPLAY;
        let second = (1.0 / log.dt_s).round() as usize;
        let steps = (1..=second).take_while(|k| log.is_valid(agent_idx, self.step_idx + k)).last();
        match steps.filter(|_| !replays) {
            Some(k) => (log.tracks.position[at + k] - log.tracks.position[at]) / (k as Real * log.dt_s),
            None => log.tracks.velocity[at],
        }
    }

    fn fill_slots(
        &mut self,
        scene: &PreparedScene,
        config: &WorldConfig,
        driver: Driver,
        drawn: Option<usize>,
        style: &BTreeMap<String, Real>,
    ) {
        let log = &scene.scene;
        let mut first_unseen = 0;
        let vehicles = match config.controlled {
            Controlled::Vehicles if config.ranking != VehicleRanking::First => {
                ranked_vehicles(log, &scene.hitches, self.step_idx, config.ranking)
            }
            _ => Vec::new(),
        };
        let rng = Rng::of_episode(self.seed, self.number).split(u64::MAX - 1);
        self.slots.clear();
        for c in 0..config.num_slots {
            let agent = match &config.controlled {
                Controlled::Ego => log.agent_index(crate::scene::EGO_ID),
                Controlled::Any => drawn,
                Controlled::Ids(ids) => ids.get(c).and_then(|id| log.agent_index(id)),
                Controlled::PerScene(scenes) => {
                    scenes.get(&log.name).and_then(|ids| ids.get(c)).and_then(|id| log.agent_index(id))
                }
                Controlled::Vehicles if config.ranking == VehicleRanking::First => {
                    let drives = |a: &usize| {
                        scene.kinds[*a] == AgentKind::Vehicle && self.states.active[*a] && !scene.is_towed(*a)
                    };
                    let found = (first_unseen..log.num_agents()).find(drives);
                    first_unseen = found.map_or(log.num_agents(), |a| a + 1);
                    found
                }
                Controlled::Vehicles => vehicles.get(c).copied(),
            };
            let agent_idx = agent.filter(|a| self.states.active[*a]);
            if let Some(a) = agent_idx {
                self.drivers[a] = driver;
            }
            let progress = |a| Progress::new(scene, a, self.step_idx, self.step_idx + config.horizon_steps);
            self.slots.push(Slot {
                agent_idx,
                alive: agent_idx.is_some(),
                progress: agent_idx.map_or_else(Progress::default, progress),
                acceleration_mps2: agent_idx.map_or(0.0, |a| self.states.acceleration_mps2[a]),
                place: RoutePlace { speed_limit_mps: config.speed_limit_mps, ..RoutePlace::default() },
                drawn: Drawn::new(&config.randomization, &config.style, style, rng.split(c as u64)),
                ..Slot::default()
            });
        }
    }

    /// Moves an agent: accelerations and yaw rates follow from where it was.
    pub(crate) fn set_pose(&mut self, agent_idx: usize, pose: Pose2, velocity: Vector2, dt_s: Real) {
        let (speed, heading) = (self.states.speed_mps[agent_idx], self.states.heading_rad[agent_idx]);
        self.states.set_pose(agent_idx, pose, velocity);
        self.states.acceleration_mps2[agent_idx] = (self.states.speed_mps[agent_idx] - speed) / dt_s;
        self.states.yaw_rate_radps[agent_idx] =
            crate::geom::math::wrap_angle(pose.heading_rad - heading) / dt_s;
    }

    /// Moves an agent as its driver wants: where that is back to the log after a gap, accelerations and yaw rates are the log's.
    pub(crate) fn place(
        &mut self,
        scene: &PreparedScene,
        a: usize,
        pose: Pose2,
        velocity: Vector2,
        dt_s: Real,
    ) {
        let log = &scene.log;
        if !log.has(a, self.step_idx - 1) && log.position(a, self.step_idx) == Some(pose.position) {
            self.enter(scene, a, dt_s);
        } else {
            self.set_pose(a, pose, velocity, dt_s);
        }
    }

    /// Agents that follow their log: in replay, present, without a slot, not stopped, and no obstacles.
    pub(crate) fn find_followers(&self, kinds: &[AgentKind], out: &mut Vec<bool>) {
        let moves =
            |(driver, kind): (&Driver, &AgentKind)| *driver == Driver::REPLAY && *kind != AgentKind::Static;
        let there = self.states.active.iter().zip(&self.halted).map(|(active, halted)| active & !halted);
        out.clear();
        out.extend(self.drivers.iter().zip(kinds).map(moves).zip(there).map(|(moves, there)| moves & there));
        self.slots.iter().filter_map(|s| s.agent_idx).for_each(|a| out[a] = false);
    }

    /// Reseeds the generator; the next episode is the first of this seed.
    pub(crate) fn reseed(&mut self, seed: u64, next_scene_idx: usize) {
        self.rng = Rng::new(seed);
        self.seed = seed;
        self.number = 0;
        self.next_scene_idx = next_scene_idx;
    }

    pub(crate) fn has_slot(&self, agent_idx: usize) -> bool {
        self.slots.iter().any(|s| s.agent_idx == Some(agent_idx))
    }

    /// Whether an episode has ever begun.
    pub(crate) fn begun(&self) -> bool {
        self.phase != Phase::NeverReset
    }

    /// Whether lengths, indices and numbers are such that a world of this batch can go on from here.
    pub(crate) fn fits(&self, scene: &PreparedScene, num_slots: usize, drivers: &DriverTable) -> bool {
        if !self.begun() {
            let (rng, seed, next_scene_idx) = (self.rng, self.seed, self.next_scene_idx);
            return *self == Self { rng, seed, next_scene_idx, ..Self::default() };
        }
        let n = scene.scene.num_agents();
        let s = &self.states;
        let reals = [
            &s.x,
            &s.y,
            &s.heading_rad,
            &s.cos,
            &s.sin,
            &s.speed_mps,
            &s.velocity_x_mps,
            &s.velocity_y_mps,
            &s.acceleration_mps2,
            &s.yaw_rate_radps,
            &self.route_s_m,
        ];
        let in_range = |i: usize| i < n;
        let contacts = self.initial_contacts.iter().chain(&self.given_contacts);
        reals.iter().all(|v| v.len() == n && v.iter().all(|x| is_sound(*x)))
            && self.elapsed_steps <= self.step_idx
            && self.step_idx < MOST_STEPS
            && self.number < u64::MAX
            && s.active.len() == n
            && s.heights.len() == if scene.scene.has_levels() { n } else { 0 }
            && s.heights.iter().all(|h| is_sound(h.elevation_m) && is_sound(h.grade))
            && s.chain == scene.chains
            && self.drivers.len() == n
            && self.drivers.iter().all(|d| drivers.has(*d))
            && self.entered.len() == n
            && self.halted.len() == n
            && self.slots.len() == num_slots
            && self.slots.iter().all(|slot| slot.agent_idx.is_none_or(in_range) && slot.is_sound())
            && contacts.into_iter().all(|(i, j)| in_range(*i as usize) && in_range(*j as usize))
            && self.contacts.iter().all(|(_, a)| in_range(*a as usize))
            && self.history.as_ref().map_or(0, History::len) == drivers.history_states
            && self.history.as_ref().is_none_or(|h| h.fits(n))
            && self.plans.len() == drivers.len()
            && self.plans.iter().flatten().all(|p| p.fits(n) && p.record.made_at <= self.elapsed_steps)
            && self.plan_override.guided.iter().flatten().all(|a| in_range(*a))
            && self.plan_override.criticality.is_none_or(|level| CRITICALITY.holds(f64::from(level)))
    }

    /// A number that depends on the seed, the episode and the step alone.
    pub(crate) fn noise_seed(&self) -> u64 {
        Rng::of_episode(self.seed, self.number).split(self.elapsed_steps as u64).next_u64()
    }
}

impl Slot {
    /// Metrics of its agent in the present episode so far.
    pub fn metrics(&self) -> Metrics {
        self.statistics.metrics()
    }

    /// Whether all numbers are such that an episode can go on with them.
    fn is_sound(&self) -> bool {
        let found = [
            self.acceleration_mps2,
            self.place.speed_limit_mps,
            self.place.route_distance_m,
            self.place.heading_error_rad,
            self.place.lane_distance_m.unwrap_or(0.0),
        ];
        let ways = self.progress.reals();
        let reals = ways.iter().chain(&found).chain(&self.last_action);
        reals.into_iter().all(|x| is_sound(*x)) && self.statistics.is_finite() && self.drawn.is_sound()
    }

    /// Whether the agent's episode ended in a step after `since` and before the present one.
    pub(super) fn ended_earlier(&self, since: usize, elapsed_steps: usize) -> bool {
        self.ended_at.is_some_and(|at| since < at && at < elapsed_steps)
    }
}
