//! The table of a batch's drivers, and which of them each agent has.

use crate::drivers::{Driver, DriverModel, KINDS, Kind, PEDESTRIANS, PlanRequest, PlanState};
use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::stage::hitches;
use crate::world::config::{Controlled, EXTERNAL, WorldConfig};
use crate::world::rng::Rng;
use std::sync::Arc;

/// Stream of a world's generator from which mixed traffic is drawn.
const MIX_STREAM: u64 = u64::MAX - 1;

/// Drivers by name, and the configuration's choice among them.
pub(crate) struct DriverTable {
    table: Vec<(String, Box<dyn DriverModel>)>,
    /// Places in the table of those that make plans.
    pub(crate) planners: Vec<u16>,
    /// States that the driver with the longest history looks back at; 0: none.
    pub(crate) history_states: usize,
    pub(crate) slots: Driver,
    /// Drivers of the other vehicles, each with the sum of the shares up to its own.
    traffic: Vec<(Real, Driver)>,
    pub(crate) pedestrians: Driver,
    pub(crate) by_id: Vec<(String, Driver)>,
}

impl DriverTable {
    /// The drivers that every batch has, then `more`, then what moves pedestrians.
    pub(crate) fn new(
        config: &WorldConfig,
        scenes: &[Arc<Scene>],
        more: Vec<(String, Box<dyn DriverModel>)>,
    ) -> Result<Self> {
        // what is in every batch has its options in the configuration of the worlds itself
        let whole = serde_json::to_value(config).unwrap_or_default();
        let made = |kind: &Kind| {
            let make = kind.make?;
            let driver = make(kind.name, &whole[kind.name].to_string());
            Some(driver.map(|driver| (kind.name.to_owned(), driver)))
        };
        let mut table =
            KINDS.iter().filter(|kind| kind.always).filter_map(made).collect::<Result<Vec<_>>>()?;
        let walks = PEDESTRIANS.iter().find(|kind| kind.name == config.pedestrians.name());
        for (name, driver) in more.into_iter().chain(walks.and_then(made).transpose()?) {
            if name == EXTERNAL || table.iter().any(|(known, _)| *known == name) {
                return Err(SimError::config("named_drivers", name, "a name that nobody else has"));
            }
            let (least, has) = (driver.least_history_states(), config.history_steps.saturating_add(1));
            if has < least {
                let expected = format!(
                    "at least {}: {name:?} looks back at {least} states or more, the present one included",
                    least - 1
                );
                return Err(SimError::config("history_steps", config.history_steps, expected));
            }
            table.push((name, driver));
        }
        let planners = (0..table.len()).filter(|i| table[*i].1.history_states() > 0);
        let mut made = Self {
            planners: planners.map(|i| i as u16).collect(),
            history_states: table.iter().map(|(_, p)| p.history_states()).max().unwrap_or(0),
            slots: Driver::External,
            traffic: Vec::new(),
            pedestrians: Driver::REPLAY,
            by_id: Vec::new(),
            table,
        };
        made.slots = made.driver("driver", &config.driver)?;
        if let Some(kind) = walks {
            made.pedestrians = made.driver("pedestrians", kind.name)?;
        }
        let mut sum = 0.0;
        for (name, share) in config.traffic.shares() {
            sum += share;
            made.traffic.push((sum, made.driver("traffic", name)?));
        }
        for (id, name) in &config.drivers {
            let known = scenes.iter().filter_map(|s| Some(s.agents[s.agent_index(id)?].kind));
            if !known.clone().any(|kind| kind == AgentKind::Vehicle) {
                return Err(SimError::unknown("agent of drivers", format!("{id:?}"), "the id of a vehicle"));
            }
            let is_towed = |s: &Arc<Scene>| {
                let agent = s.agent_index(id).filter(|_| id != EGO_ID);
                agent.is_some_and(|a| hitches(s).iter().any(|(towed, _)| *towed == a))
            };
            let is_named = matches!(config.controlled, Controlled::Ids(_) | Controlled::PerScene(_));
            if !is_named && scenes.iter().any(is_towed) {
                let expected =
                    "the id of a vehicle that no other one tows: those follow the one that tows them";
                return Err(SimError::config("drivers", format!("{id:?}"), expected));
            }
            made.by_id.push((id.clone(), made.driver("drivers", name)?));
        }
        Ok(made)
    }

    /// Names of the drivers, in the order of the table.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.table.iter().map(|(name, _)| name.as_str())
    }

    pub(crate) fn name_of(&self, driver: Driver) -> &str {
        match driver {
            Driver::External => EXTERNAL,
            Driver::Towed => "towed",
            Driver::Model(i) => &self.table[usize::from(i)].0,
        }
    }

    pub(crate) fn driver(&self, field: &'static str, name: &str) -> Result<Driver> {
        if name == EXTERNAL {
            return Ok(Driver::External);
        }
        let found = self.table.iter().position(|(known, _)| known == name);
        found.map(|i| Driver::Model(i as u16)).ok_or_else(|| {
            let names: Vec<&str> = self.names().collect();
            let expected = format!("a driver of this batch: {}", names.join(", "));
            SimError::config(field, format!("{name:?}"), expected)
        })
    }

    /// Whether a driver is one of this table.
    pub(crate) fn has(&self, driver: Driver) -> bool {
        !matches!(driver, Driver::Model(i) if usize::from(i) >= self.table.len())
    }

    pub(crate) fn get(&self, driver_idx: u16) -> &dyn DriverModel {
        &*self.table[usize::from(driver_idx)].1
    }

    pub(crate) fn len(&self) -> usize {
        self.table.len()
    }

    /// Whether a driver plans for every world, or only for those where an agent was assigned to it.
    pub(crate) fn always_plans(&self, driver_idx: u16) -> bool {
        let driver = Driver::Model(driver_idx);
        self.slots == driver || self.traffic.iter().any(|(_, d)| *d == driver)
    }

    /// One entry for each request, checked.
    pub(crate) fn plan(
        &mut self,
        driver_idx: u16,
        requests: &[PlanRequest<'_>],
    ) -> Result<Vec<Option<PlanState>>> {
        let (name, driver) = &mut self.table[usize::from(driver_idx)];
        let plans = driver.plan(requests)?;
        let fits = |(plan, request): (&Option<PlanState>, &PlanRequest<'_>)| {
            plan.as_ref().is_none_or(|p| p.fits(request.world.states.len()))
        };
        if plans.len() != requests.len() || !plans.iter().zip(requests).all(fits) {
            let message = "its plans do not fit the worlds that it was asked for".into();
            return Err(SimError::Driver { driver: name.clone(), message });
        }
        Ok(plans)
    }

    /// Driver of a vehicle without a slot in the episode of a seed.
    pub(crate) fn of_vehicle(&self, seed: u64, episode: u64, agent_idx: usize) -> Driver {
        if let [(_, only)] = self.traffic[..] {
            return only;
        }
        let mut rng = Rng::of_episode(seed, episode).split(MIX_STREAM).split(agent_idx as u64);
        let drawn = (rng.next_u64() >> 40) as Real / (1u64 << 24) as Real;
        let found = self.traffic.iter().find(|(up_to, _)| drawn < *up_to);
        found.or(self.traffic.last()).map_or(Driver::REPLAY, |(_, driver)| *driver)
    }
}
