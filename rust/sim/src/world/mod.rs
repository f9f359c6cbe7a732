//! Many worlds stepped as one batch.
//!
//! A tick runs these phases: drivers plan for all worlds at once; then, world by world and in parallel
//! over worlds, actions are decoded and background motions decided, agents move, enter and leave, contacts and road
//! departures are found, rewards and endings follow, ended worlds are reset as the autoreset mode says, and, after the
//! last tick for which the actions are held, observations are written into the caller's buffers. Nothing depends on the number of threads or on the other
//! worlds of the batch.

mod buffers;
mod config;
mod driver_table;
mod episode;
mod executor;
mod queries;
mod reward_columns;
mod rng;
mod scenes;
mod tick;

pub use buffers::{ArraySpec, Extent, StepBuffers};
pub use config::{
    ActionConfig, Autoreset, Consequence, Controlled, Drawn, EXTERNAL, Pedestrians, Randomization,
    SceneOrder, TABLES, Traffic, TrafficCollision, VehicleRanking, WorldConfig,
};
pub use episode::{LEAST_WAY_M, METRICS, Metrics, NUM_METRICS, Slot, Wanted, ranked_vehicles};
pub use queries::{
    CANDIDATE_BOUND, CANDIDATE_FEATURES, Candidates, LaneAhead, OWN_FEATURES, ScoreFacts, WorldStatus,
};
pub use reward_columns::{
    COLUMNS, COMPONENTS, Col, InfoColumn, NUM_COLUMNS, RewardConfig, RewardForm, TTC_HORIZON_S,
};
pub use rng::Rng;
pub use tick::{ActionDecoder, assisted_action, place_on_route};

use crate::drivers::{Driver, DriverModel, PlanRequest};
use crate::error::{Result, SimError, check_length};
use crate::geom::Real;
use crate::observe::{Layout, Observer};
use crate::scene::Scene;
use driver_table::DriverTable;
use episode::{Episode, Phase};
use executor::{Part, run};
use scenes::{Scenes, check_scene};
use std::ops::Range;
use std::sync::Arc;
use tick::{Shared, World};

/// What a reset asks for, world by world; `None` leaves the choice to the world.
#[derive(Debug, Clone, Copy, Default)]
pub struct ResetRequest<'a> {
    /// Seeds [E]; a world without one goes on with its generator.
    pub seeds: &'a [Option<u64>],
    /// Indices of scenes [E].
    pub scenes: &'a [Option<usize>],
    /// Egos, starts and styles [E]; all are left to the draw where it is empty.
    pub wanted: &'a [Wanted],
    /// Worlds to reset [E]; all without it. The buffers of the others are not touched.
    pub mask: Option<&'a [bool]>,
}

/// Most worlds of a batch.
const MOST_WORLDS: usize = 1 << 16;
/// Most worker threads of a batch.
const MOST_THREADS: usize = 1 << 10;
/// Most bytes of observations and rasters of one step of a batch.
const MOST_BYTES: u64 = 1 << 34;

/// Whether a world of a batch goes on in a step.
fn goes(active: Option<&[bool]>, world_idx: usize) -> bool {
    active.is_none_or(|active| active[world_idx])
}

/// E worlds over a list of scenes.
pub struct VecWorld {
    config: WorldConfig,
    layout: Layout,
    decoder: ActionDecoder,
    scenes: Scenes,
    drivers: DriverTable,
    worlds: Vec<World>,
    /// Indices of the worlds as they are gone through, see [`executor`].
    order: Vec<u32>,
    pool: Option<rayon::ThreadPool>,
}

impl VecWorld {
    /// Worlds that play `scenes`; none is running before [`VecWorld::reset`]. `drivers` are those beside `replay`,
    /// `constant_velocity` and `idm`, by names of their own. `num_threads` 1 never leaves the calling thread.
    ///
    /// # Errors
    /// [`SimError::Config`] and [`SimError::Scene`] for what does not fit together: wrong step, a scene too short
    /// for its history, no controlled agent present at the start, a driver that is not there, a name used twice;
    /// [`SimError::Unknown`] for a driver of a vehicle that no scene has.
    pub fn new(
        scenes: Vec<Arc<Scene>>,
        config: WorldConfig,
        num_worlds: usize,
        num_threads: usize,
        drivers: Vec<(String, Box<dyn DriverModel>)>,
    ) -> Result<Self> {
        config.validate()?;
        if !(1..=MOST_WORLDS).contains(&num_worlds) {
            return Err(SimError::config("num_envs", num_worlds, "1 to 65536"));
        }
        if !(1..=MOST_THREADS).contains(&num_threads) {
            return Err(SimError::config("num_threads", num_threads, "1 to 1024"));
        }
        if scenes.is_empty() {
            return Err(SimError::config("scenes", 0, "at least one scene"));
        }
        for scene in &scenes {
            check_scene(scene, &config)?;
        }
        let drivers = DriverTable::new(&config, &scenes, drivers)?;
        let ranges = config::styled(&config.style).map(|i| (COMPONENTS[i], config.style[COMPONENTS[i]]));
        let layout = Layout::new(&config.observation)?.with_style(ranges);
        let row_bytes =
            size_of::<f32>() * layout.size + layout.bev.as_ref().map_or(0, |b| b.shape.iter().product());
        let bytes =
            [config.num_slots, num_worlds].iter().fold(row_bytes as u64, |b, n| b.saturating_mul(*n as u64));
        if bytes > MOST_BYTES {
            let field = "bytes of the observations of a step";
            return Err(SimError::config(field, bytes, "at most 16 GiB: fewer worlds or columns"));
        }
        let num_scenes = scenes.len();
        let scenes = Scenes::new(scenes, config.observation.bev);
        let observer = Observer::new(layout.clone());
        let first = scenes.prepared(0);
        let worlds = (0..num_worlds)
            .map(|i| World::new(i, num_scenes, Arc::clone(&first), observer.clone()))
            .collect();
        let pool = if num_threads > 1 {
            let made = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build();
            Some(made.map_err(|e| SimError::config("num_threads", e, "threads that start"))?)
        } else {
            None
        };
        let decoder = ActionDecoder::new(&config.action);
        let order = (0..num_worlds as u32).collect();
        Ok(Self { config, layout, decoder, scenes, drivers, worlds, order, pool })
    }

    /// Draws the scenes of episodes that begin later by weights [S], in proportion; all alike without. A world's
    /// random numbers stay those of its seed.
    ///
    /// # Errors
    /// [`SimError::Length`], and [`SimError::Config`] for weights that are negative, not finite or all 0, or where
    /// scenes are played in their order.
    pub fn set_scene_weights(&mut self, weights: Option<&[f64]>) -> Result<()> {
        if weights.is_some() && self.config.scene_order == SceneOrder::Sequential {
            let expected = "random, where scenes are drawn by weights";
            return Err(SimError::config("scene_order", "sequential", expected));
        }
        self.scenes.weigh(weights)
    }

    /// Says what happens to worlds whose episode has ended, before the first of them begins.
    ///
    /// # Errors
    /// [`SimError::Config`] where one has begun.
    pub fn set_autoreset(&mut self, mode: Autoreset) -> Result<()> {
        if self.worlds.iter().any(|w| w.episode.begun()) {
            let got = format!("{mode:?} in worlds that have begun");
            return Err(SimError::config("autoreset", got, "the mode that they were made with"));
        }
        self.config.autoreset = mode;
        Ok(())
    }

    /// Begins new episodes and writes their first observations.
    ///
    /// # Errors
    /// [`SimError::Length`] and [`SimError::Unknown`] before anything changes.
    pub fn reset(&mut self, request: &ResetRequest<'_>, out: StepBuffers<'_>) -> Result<()> {
        let num_worlds = self.worlds.len();
        out.check(num_worlds, self.extent())?;
        check_length("seeds", request.seeds.len(), num_worlds)?;
        check_length("scenes", request.scenes.len(), num_worlds)?;
        check_length("reset_mask", request.mask.map_or(num_worlds, <[bool]>::len), num_worlds)?;
        let n = self.scenes.list.len();
        if let Some(idx) = request.scenes.iter().flatten().find(|i| **i >= n) {
            return Err(queries::no_index("scene", *idx, n));
        }
        if !request.wanted.is_empty() {
            check_length("wanted", request.wanted.len(), num_worlds)?;
        }
        let goes = |i: usize| request.mask.is_none_or(|m| m[i]);
        for (i, wanted) in request.wanted.iter().enumerate().filter(|(i, _)| goes(*i)) {
            wanted.check(request.scenes[i].map(|scene| &*self.scenes.list[scene].0), &self.config)?;
        }
        let shared = Shared {
            config: &self.config,
            decoder: &self.decoder,
            drivers: &self.drivers,
            extent: self.extent(),
        };
        let scenes = &self.scenes;
        let job = |i: usize, world: &mut World, _: &[Real], mut out: StepBuffers<'_>| {
            if !goes(i) {
                return;
            }
            let episode = &mut world.episode;
            if let Some(seed) = request.seeds[i] {
                episode.reseed(seed, i % n);
            }
            let (scene, scene_idx) = match request.scenes[i] {
                Some(idx) => (scenes.prepared(idx), idx),
                None => scenes.next(episode, shared.config.scene_order, num_worlds),
            };
            let drawn = Wanted::default();
            world.begin(scene, scene_idx, &shared, request.wanted.get(i).unwrap_or(&drawn));
            out.clear_step();
            out.was_reset.fill(true);
            world.finish(&shared, 0, &mut out);
        };
        let (worlds, order, extent) = (&mut self.worlds[..], &mut self.order[..], shared.extent);
        run(self.pool.as_ref(), Part { worlds, order, actions: &[], width: 0, out, extent }, &job);
        Ok(())
    }

    /// One decision of all worlds: every action is held for `decision_steps` steps, or up to the end of its world's
    /// episode. `actions` [E, C, width] are normalised numbers or grid indices; those of agents that are not driven
    /// from outside are ignored. Rewards and their components are sums over the steps held; observations and the
    /// other columns are those of the last one, and accidents stay in the columns from the step on that they
    /// happened in.
    ///
    /// Without `active` [E] all worlds go on. A world that rests stays bit for bit as it is, may be one that has ended or
    /// was never reset, and no driver plans for it; its observations in the buffers are not touched, the rest
    /// is that of a step in which nothing happened.
    ///
    /// # Errors
    /// [`SimError::Length`], [`SimError::Action`] and [`SimError::ResetNeeded`] before anything changes;
    /// [`SimError::Driver`] before the step that it stops.
    pub fn step(
        &mut self,
        actions: &[Real],
        active: Option<&[bool]>,
        mut out: StepBuffers<'_>,
    ) -> Result<()> {
        self.check_step(actions, active, &out)?;
        for world in &self.worlds {
            if !goes(active, world.idx) {
                world.rest(&mut out.world(world.idx, self.extent()));
            }
        }
        let steps = self.config.decision_steps;
        // where a driver plans for all worlds they go on step by step together
        let stride = if self.drivers.planners.is_empty() { steps } else { 1 };
        for first in (0..steps).step_by(stride) {
            self.plan(first, active, &out)?;
            self.step_held(actions, active, first..first + stride, out.reborrow());
        }
        Ok(())
    }

    /// Some of the steps of a decision, in all active worlds whose episode has not ended in it.
    fn step_held(
        &mut self,
        actions: &[Real],
        active: Option<&[bool]>,
        held: Range<usize>,
        out: StepBuffers<'_>,
    ) {
        let shared = Shared {
            config: &self.config,
            decoder: &self.decoder,
            drivers: &self.drivers,
            extent: self.extent(),
        };
        let (scenes, num_worlds, order) = (&self.scenes, self.worlds.len(), self.config.scene_order);
        let job = |i: usize, world: &mut World, actions: &[Real], mut out: StepBuffers<'_>| {
            if !goes(active, i) {
                return;
            }
            let next = |episode: &mut Episode| scenes.next(episode, order, num_worlds);
            world.step(actions, held.clone(), &shared, next, &mut out);
        };
        let width = self.decoder.width() * shared.extent.slots;
        let (worlds, order, extent) = (&mut self.worlds[..], &mut self.order[..], shared.extent);
        run(self.pool.as_ref(), Part { worlds, order, actions, width, out, extent }, &job);
    }

    fn check_step(&self, actions: &[Real], active: Option<&[bool]>, out: &StepBuffers<'_>) -> Result<()> {
        let (num_worlds, slots) = (self.worlds.len(), self.config.num_slots);
        out.check(num_worlds, self.extent())?;
        let width = self.decoder.width() * slots;
        check_length("actions", actions.len(), num_worlds * width)?;
        check_length("active", active.map_or(num_worlds, <[bool]>::len), num_worlds)?;
        for (i, world) in self.worlds.iter().enumerate().filter(|(i, _)| goes(active, *i)) {
            match world.episode.phase {
                Phase::NeverReset => {
                    return Err(SimError::ResetNeeded { world: i, why: "it was never reset" });
                }
                Phase::Ended if self.config.autoreset == Autoreset::Disabled => {
                    return Err(SimError::ResetNeeded { world: i, why: "its episode has ended" });
                }
                _ => world.check_actions(&actions[i * width..(i + 1) * width], &self.decoder)?,
            }
        }
        Ok(())
    }

    /// Asks drivers for plans in the active, running worlds that they drive and that did not restart in this decision.
    fn plan(&mut self, step: usize, active: Option<&[bool]>, out: &StepBuffers<'_>) -> Result<()> {
        let goes_on = |w: &&World| {
            goes(active, w.idx) && w.episode.phase == Phase::Running && !(step > 0 && out.was_reset[w.idx])
        };
        let mut made = Vec::new();
        for place in 0..self.drivers.planners.len() {
            let driver_idx = self.drivers.planners[place];
            let (driver, always) = (Driver::Model(driver_idx), self.drivers.always_plans(driver_idx));
            let drives = |w: &&World| always || w.episode.drivers.contains(&driver);
            let running = self.worlds.iter().filter(goes_on).filter(drives);
            let requests: Vec<PlanRequest<'_>> =
                running.map(|w| w.request(&self.config, driver_idx)).collect();
            if requests.is_empty() {
                continue;
            }
            let plans = self.drivers.plan(driver_idx, &requests)?;
            let plans =
                requests.iter().zip(plans).filter_map(|(r, p)| Some((r.world.world_idx, driver_idx, p?)));
            made.extend(plans);
        }
        // nothing changes before all drivers have planned
        for (world_idx, driver_idx, plan) in made {
            self.worlds[world_idx].episode.plans[usize::from(driver_idx)] = Some(plan);
        }
        Ok(())
    }
}
