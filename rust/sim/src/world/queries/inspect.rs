//! What can be asked of a running batch of worlds.

use crate::drivers::{Driver, PlanOverride, PlanRecord, WorldView};
use crate::dynamics::{Action, Dynamics};
use crate::error::{Result, SimError, check_length};
use crate::events::{Collisions, Contact, OffRoad, off_road};
use crate::geom::{Point2, Real};
use crate::observe::Layout;
use crate::options::{self, CRITICALITY};
use crate::scene::{AgentKind, Scene};
use crate::stage::PreparedScene;
use crate::state::AgentStates;
use crate::world::tick::{World, find_towed, straddles_lanes};
use crate::world::{ActionDecoder, Extent, Metrics, Slot, VecWorld, WorldConfig};
use serde_json::Value;
use std::ops::Deref;
use std::sync::Arc;

/// The present of a running world: what a driver sees of it, and its slots.
#[derive(Clone, Copy)]
pub struct WorldStatus<'a> {
    /// Seed that the world's generator was last started from.
    pub seed: u64,
    /// Episodes begun since that seed.
    pub episode: u64,
    /// Its slots.
    pub slots: &'a [Slot],
    view: WorldView<'a>,
}

impl<'a> Deref for WorldStatus<'a> {
    type Target = WorldView<'a>;

    fn deref(&self) -> &WorldView<'a> {
        &self.view
    }
}

/// What is wrong with an index that is not below a number.
pub(crate) fn no_index(what: &'static str, idx: usize, below: usize) -> SimError {
    SimError::unknown(what, idx, format!("an index below {below}"))
}

impl VecWorld {
    /// Puts a driver into vehicles of a world, until its episode ends. Vehicles that have left their log do not go back
    /// to it by log replay without a jump: assign at the start of an episode.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world or agent that does not exist or is no vehicle; [`SimError::Config`] for a
    /// driver that this batch has not, and for actions from outside where the vehicle has no slot.
    pub fn assign(&mut self, world_idx: usize, agents: &[usize], driver: &str) -> Result<()> {
        let world = self.begun(world_idx)?;
        let driver = self.drivers.driver("driver", driver)?;
        let kinds = &world.scene.kinds;
        if let Some(agent) = agents.iter().find(|a| kinds.get(**a) != Some(&AgentKind::Vehicle)) {
            return Err(SimError::unknown("agent", agent, "the index of a vehicle"));
        }
        if driver == Driver::External && !agents.iter().all(|a| world.episode.has_slot(*a)) {
            let expected = "a driver of this batch: actions from outside reach agents with a slot only";
            return Err(SimError::config("driver", "external", expected));
        }
        let drivers = &mut self.worlds[world_idx].episode.drivers;
        agents.iter().for_each(|a| drivers[*a] = driver);
        let world = &mut self.worlds[world_idx];
        find_towed(&mut world.episode, &world.scene);
        Ok(())
    }

    /// Says what is asked of a world's next plans to the drivers that plan.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world or agent that does not exist, or a batch without a driver that plans;
    /// [`SimError::Config`] for a criticality out of its range.
    pub fn override_plan(&mut self, world_idx: usize, wanted: PlanOverride) -> Result<()> {
        let num_agents = self.begun(world_idx)?.scene.scene.num_agents();
        if let Some(agent) = wanted.guided.iter().flatten().find(|a| **a >= num_agents) {
            return Err(no_index("agent", *agent, num_agents));
        }
        if let Some(strength) = wanted.criticality.filter(|c| !CRITICALITY.holds(f64::from(*c))) {
            return Err(SimError::config("criticality", strength, format!("a number {CRITICALITY}")));
        }
        self.planner(None)?;
        self.worlds[world_idx].episode.plan_override = wanted;
        Ok(())
    }

    /// The plan of a driver that a world follows, of the first driver that plans if none is named; `None` before the
    /// first plan of an episode.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world that does not exist, and where no such driver plans.
    pub fn explain(&self, world_idx: usize, driver: Option<&str>) -> Result<Option<&PlanRecord>> {
        let plans = &self.world(world_idx)?.episode.plans;
        let planner = self.planner(driver)?;
        Ok(plans.get(usize::from(planner)).and_then(|p| p.as_ref()).map(|p| &p.record))
    }

    /// Place in the table of the driver of a name that plans, or of the first one.
    fn planner(&self, driver: Option<&str>) -> Result<u16> {
        let planners = &self.drivers.planners;
        let is_it = |i: &&u16| driver.is_none_or(|name| self.drivers.name_of(Driver::Model(**i)) == name);
        planners.iter().find(is_it).copied().ok_or_else(|| {
            let names: Vec<&str> = self.planner_names().collect();
            let got = driver.map_or_else(|| "that plans".into(), |name| format!("{name:?}"));
            let expected = match names[..] {
                [] => "a batch with a driver that plans".to_owned(),
                _ => format!("one that plans: {}", names.join(", ")),
            };
            SimError::unknown("driver", got, expected)
        })
    }

    /// Names of the drivers that plan.
    pub fn planner_names(&self) -> impl Iterator<Item = &str> {
        self.drivers.planners.iter().map(|i| self.drivers.name_of(Driver::Model(*i)))
    }

    /// Names of the drivers, in the order of the table, each with its kind.
    pub fn driver_table(&self) -> impl Iterator<Item = (&str, &str)> {
        (0..self.drivers.len() as u16).map(|i| self.driver_name(Driver::Model(i)))
    }

    /// Name of a driver, and its kind.
    pub fn driver_name(&self, driver: Driver) -> (&str, &str) {
        let name = self.drivers.name_of(driver);
        match driver {
            Driver::External | Driver::Towed => (name, name),
            Driver::Model(i) => (name, self.drivers.get(i).name()),
        }
    }

    /// Configuration.
    pub fn config(&self) -> &WorldConfig {
        &self.config
    }

    /// Schema of the observation row.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Decoder of actions.
    pub fn decoder(&self) -> &ActionDecoder {
        &self.decoder
    }

    /// Number of worlds E.
    pub fn num_worlds(&self) -> usize {
        self.worlds.len()
    }

    /// Sizes of each world's part of the buffers.
    pub fn extent(&self) -> Extent {
        Extent::new(&self.config, &self.layout)
    }

    /// Number of scenes.
    pub fn num_scenes(&self) -> usize {
        self.scenes.list.len()
    }

    /// A scene of the list.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for an index out of range.
    pub fn scene(&self, scene_idx: usize) -> Result<&Arc<Scene>> {
        let known = self.scenes.list.get(scene_idx).map(|(scene, _)| scene);
        known.ok_or_else(|| no_index("scene", scene_idx, self.num_scenes()))
    }

    /// A scene made ready.
    ///
    /// # Errors
    /// As [`VecWorld::scene`].
    pub fn prepared(&self, scene_idx: usize) -> Result<Arc<PreparedScene>> {
        self.scene(scene_idx)?;
        Ok(self.scenes.prepared(scene_idx))
    }

    pub(crate) fn scene_name(&self, scene_idx: usize) -> &str {
        &self.scenes.list[scene_idx].0.name
    }

    /// What snapshots are checked against: non-default configuration that states depend on, and names of drivers.
    pub(crate) fn config_fingerprint(&self) -> Value {
        let config = WorldConfig { decision_steps: 1, ..self.config.clone() };
        let mut changed = options::to_value(&config);
        options::without_defaults(&WorldConfig::TABLE, &mut changed);
        changed["names of drivers"] = self.drivers.names().collect();
        changed
    }

    pub(crate) fn world(&self, world_idx: usize) -> Result<&World> {
        self.worlds.get(world_idx).ok_or_else(|| no_index("world", world_idx, self.worlds.len()))
    }

    pub(crate) fn begun(&self, world_idx: usize) -> Result<&World> {
        let world = self.world(world_idx)?;
        if world.episode.begun() {
            Ok(world)
        } else {
            Err(SimError::ResetNeeded { world: world_idx, why: "it was never reset" })
        }
    }

    /// The present of a world.
    ///
    /// # Errors
    /// [`SimError::Unknown`], and [`SimError::ResetNeeded`] before the first reset.
    pub fn status(&self, world_idx: usize) -> Result<WorldStatus<'_>> {
        let world = self.begun(world_idx)?;
        let (e, view) = (&world.episode, world.view(&self.config));
        Ok(WorldStatus { seed: e.seed, episode: e.number, slots: &e.slots, view })
    }

    /// Actions that bring each slot's agent from where it is towards its logged state at the next decision, in the form that
    /// [`VecWorld::step`] takes; zeros where there is no log.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Config`] for assisted dynamics, whose steps are not inverted.
    pub fn expert_actions(&self, world_idx: usize) -> Result<Vec<Action>> {
        let world = self.begun(world_idx)?;
        self.decoder.dynamics().check_moves_by_itself()?;
        let (e, scene) = (&world.episode, &world.scene);
        let action = |agent: Option<usize>| {
            let a = agent?;
            let logged = |steps: usize| Some((steps, scene.log.at(a, e.step_idx + steps)?));
            let (steps, (pose, velocity)) = (1..=self.config.decision_steps).rev().find_map(logged)?;
            let mut next = AgentStates::new(1);
            next.set_pose(0, pose, velocity);
            let (from, to) = (e.states.kin_state(a), next.kin_state(0));
            let (dynamics, steps) = (self.decoder.dynamics(), steps as Real);
            let whole = dynamics.inverse(&from, &to, self.config.dt_s * steps, &scene.footprints[a]);
            let is_pose = matches!(dynamics, Dynamics::DeltaPose(_));
            Some(self.decoder.encode(&if is_pose { whole.map(|part| part / steps) } else { whole }))
        };
        Ok(e.slots.iter().map(|s| action(s.agent_idx).unwrap_or_default()).collect())
    }

    /// Metrics of a world's slots in its last episode that ended; empty before.
    ///
    /// # Errors
    /// [`SimError::Unknown`] for a world that does not exist.
    pub fn ended_metrics(&self, world_idx: usize) -> Result<&[Metrics]> {
        Ok(&self.world(world_idx)?.ended)
    }

    /// Writes the present observations [C, D] and rasters [C, B] of one world once more.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Length`] for a buffer of another size.
    pub fn observe(&mut self, world_idx: usize, obs: &mut [Real], bev: &mut [u8]) -> Result<()> {
        self.begun(world_idx)?;
        let extent = self.extent();
        check_length("obs", obs.len(), extent.slots * extent.row)?;
        check_length("bev", bev.len(), extent.slots * extent.raster.iter().product::<usize>())?;
        let now = self.worlds[world_idx].episode.elapsed_steps;
        self.worlds[world_idx].observe(&self.config, extent, now, obs, bev);
        Ok(())
    }
}

impl WorldStatus<'_> {
    /// Agent of each slot.
    pub fn slot_agents(&self) -> Vec<Option<usize>> {
        self.slots.iter().map(|slot| slot.agent_idx).collect()
    }

    /// Route of a slot's agent, points about a metre apart, and the goal: the logged place at the end of the episode.
    pub fn slot_route(&self, slot_idx: usize) -> Option<(Vec<Point2>, Point2)> {
        let slot = self.slots.get(slot_idx)?;
        Some((self.scene.routes[slot.agent_idx?].path.points().to_vec(), slot.progress.goal))
    }

    /// All pairs of agents (i < j) that touch now, each with the contact as seen by `i` and by `j`.
    pub fn contacts(&self) -> Vec<(Contact, Contact)> {
        let (states, scene) = (self.states, self.scene);
        let mut collisions = Collisions::new();
        collisions.find(states, &scene.footprints, &scene.kinds);
        let seen = |i: u32, j: u32| {
            let (i, j) = (i as usize, j as usize);
            Contact::between(states, &scene.footprints, i, j, || straddles_lanes(states, scene, i))
        };
        collisions.pairs().iter().map(|(i, j)| (seen(*i, *j), seen(*j, *i))).collect()
    }

    /// Whether each agent is off the road now; never where the map has no road.
    pub fn off_road(&self) -> Vec<OffRoad> {
        let (states, scene) = (self.states, self.scene);
        let fact = |a: usize| match &scene.at(states.elevation_m(a)).road {
            Some(road) if states.active[a] => off_road(states, a, &scene.footprints[a], road),
            _ => OffRoad::default(),
        };
        (0..states.len()).map(fact).collect()
    }

    /// How far the farthest corner of each slot's agent is off the road, metres; 0 on it and where the map has no road.
    pub fn off_road_m(&self) -> Vec<Real> {
        let (states, scene) = (self.states, self.scene);
        let off_m = |a: usize| {
            let corners = states.oriented_box(a, &scene.footprints[a]).corners();
            let of_level = |c: &Point2| scene.road_distance_m(*c, states.elevation_m(a));
            corners.iter().filter_map(of_level).map(|d| -d).fold(0.0, Real::max)
        };
        self.slots.iter().map(|s| s.agent_idx.map_or(0.0, off_m)).collect()
    }
}
