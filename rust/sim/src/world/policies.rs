//! The background policies of a batch of worlds, one for each driver.

use crate::error::{Result, SimError};
use crate::policy::{BackgroundPolicy, Command, ConstantVelocity, Explanation, Idm, Replay, WorldView};
use crate::world::config::Driver;

fn no_planner() -> SimError {
    let expected = "a batch with a policy that plans".into();
    SimError::Unknown { what: "policy", got: "ccdiff".into(), expected }
}

/// One policy for each [`Driver`].
pub(crate) struct Policies {
    replay: Replay,
    constant_velocity: ConstantVelocity,
    idm: Idm,
    planned: Option<Box<dyn BackgroundPolicy>>,
    /// Steps of history that the planned policy looks back, the present one included.
    history_len: usize,
}

impl Policies {
    pub(crate) fn new(planned: Option<Box<dyn BackgroundPolicy>>, history_len: usize) -> Self {
        Self { replay: Replay, constant_velocity: ConstantVelocity, idm: Idm, planned, history_len }
    }

    /// The policy of a driver. Agents driven from outside never ask; they would replay their log.
    pub(crate) fn get(&self, driver: Driver) -> &dyn BackgroundPolicy {
        match driver {
            Driver::ConstantVelocity => &self.constant_velocity,
            Driver::Idm => &self.idm,
            Driver::Ccdiff => self.planned.as_deref().unwrap_or(&self.replay),
            Driver::External | Driver::Replay => &self.replay,
        }
    }

    pub(crate) fn has_planned(&self) -> bool {
        self.planned.is_some()
    }

    pub(crate) fn history_len(&self) -> Option<usize> {
        self.planned.as_ref().is_some_and(|p| p.needs_history()).then_some(self.history_len)
    }

    pub(crate) fn plans(&self) -> bool {
        self.planned.as_ref().is_some_and(|p| p.plans())
    }

    pub(crate) fn plan(&mut self, worlds: &[WorldView<'_>]) -> Result<()> {
        self.planned.as_mut().map_or(Ok(()), |p| p.plan(worlds))
    }

    pub(crate) fn command(&mut self, world_idx: usize, command: Command) -> Result<()> {
        self.planned.as_mut().map_or_else(|| Err(no_planner()), |p| p.command(world_idx, command))
    }

    pub(crate) fn explain(&self, world_idx: usize) -> Result<Option<&Explanation>> {
        self.planned.as_ref().map(|p| p.explain(world_idx)).ok_or_else(no_planner)
    }

    pub(crate) fn reset_world(&mut self, world_idx: usize) {
        if let Some(p) = &mut self.planned {
            p.reset_world(world_idx);
        }
    }

    pub(crate) fn save_world(&self, world_idx: usize) -> Vec<u8> {
        self.planned.as_ref().map(|p| p.save_world(world_idx)).unwrap_or_default()
    }

    pub(crate) fn load_world(&mut self, world_idx: usize, bytes: &[u8]) -> Result<()> {
        self.planned.as_mut().map_or(Ok(()), |p| p.load_world(world_idx, bytes))
    }
}
