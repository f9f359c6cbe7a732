//! Driver models: what moves the agents that take no actions from outside.
//!
//! A batch of worlds is handed a table of drivers under names of their own ([`crate::world::VecWorld::new`]); each agent
//! holds the place of its driver in that table ([`Driver`]). A driver first plans for all worlds at once
//! ([`DriverModel::plan`], the one place where a network runs), then moves single agents from that plan
//! ([`DriverModel::act`], inside each world's own tick). What a driver remembers of a world is in the world's
//! [`PlanState`], so that snapshots and resets need no code in a driver. Drivers without a plan (log replay, constant
//! velocity, IDM) implement `act` alone.

mod constant_velocity;
mod idm;
mod plan;
mod replay;
mod social_force;

pub use constant_velocity::ConstantVelocity;
pub use idm::{Idm, IdmConfig, braking_at_light, idm_acceleration, idm_towards};
pub(crate) use idm::{braking, idm_with, share_of};
pub use plan::{
    Axis, PLAN_FIELDS, PlanField, PlanFieldSchema, PlanOverride, PlanRecord, PlanRequest, PlanState,
};
pub use replay::Replay;
pub use social_force::SocialForce;

use crate::error::Result;
use crate::geom::{Pose2, Real, Vector2};
use crate::options::Table;
use crate::stage::{History, PreparedScene};
use crate::state::AgentStates;
use serde::{Deserialize, Serialize};

/// What drives an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Driver {
    /// Actions handed to `step`.
    External,
    /// The driver at this place of the batch's table.
    Model(u16),
    /// None: it is towed by the vehicle that it is hitched to.
    Towed,
}

impl Driver {
    /// Log replay: the first driver of every table.
    pub const REPLAY: Self = Self::Model(0);
}

/// Makes a driver from its options as JSON, found at a path of the configuration.
pub type Make = fn(path: &str, options: &str) -> Result<Box<dyn DriverModel>>;

/// A kind of driver: its file declares one, a list names it, and configurations, images, tables and help texts read it.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Name in configurations.
    pub name: &'static str,
    /// Name in legends and tables.
    pub title: &'static str,
    /// Whose colour it has in images: a driver that images tell apart, or `"other"`.
    pub style: &'static str,
    /// Its options; `None`: it takes none.
    pub options: Option<&'static Table>,
    /// Whether every batch has it under this name; others are made where an agent has them.
    pub always: bool,
    /// How it is made; `None`: not from options alone.
    pub make: Option<Make>,
}

/// The kinds of the simulator: a new one is a line here.
pub const KINDS: &[Kind] = &[replay::KIND, constant_velocity::KIND, idm::KIND];

/// Those that move pedestrians alone, by the names of [`crate::world::Pedestrians`].
pub const PEDESTRIANS: &[Kind] = &[social_force::KIND];

/// What a driver may see of a world before a step.
#[derive(Clone, Copy)]
pub struct WorldView<'a> {
    /// Index of the world among the E of its batch.
    pub world_idx: usize,
    /// Index of the scene in the batch's list.
    pub scene_idx: usize,
    /// The scene.
    pub scene: &'a PreparedScene,
    /// States before the step.
    pub states: &'a AgentStates,
    /// Position of each agent along its route, metres, kept for route followers.
    pub route_s_m: &'a [f32],
    /// The ego.
    pub ego: Option<usize>,
    /// Driver of each agent.
    pub drivers: &'a [Driver],
    /// Whether a contact has stopped an agent for the rest of the episode.
    pub halted: &'a [bool],
    /// Past states, where a driver of the batch asked for them: as many as the one that looks back farthest wants.
    pub history: Option<&'a History>,
    /// Step of the log that belongs to the states.
    pub step_idx: usize,
    /// Steps since the episode began.
    pub elapsed_steps: usize,
    /// Steps of an episode at most.
    pub horizon_steps: usize,
    /// A number that depends on nothing but the world's seed, its episode and the step: the seed of noise.
    pub noise_seed: u64,
    /// Step, seconds.
    pub dt_s: Real,
    /// Speed limit where the map has none, m/s.
    pub speed_limit_mps: Real,
    /// Options of the intelligent driver model that the world has.
    pub idm: &'a IdmConfig,
}

impl WorldView<'_> {
    /// Whether an agent backs up in the log, or stands before it does.
    pub fn backs_up(&self, agent_idx: usize) -> bool {
        self.scene.routes[agent_idx].backs_up(self.step_idx)
    }

    /// Whether it did at any step since a plan was made.
    pub(crate) fn backed_up_since(&self, plan: Option<&PlanState>, agent_idx: usize) -> bool {
        let since = plan.map_or(0, |plan| self.elapsed_steps.saturating_sub(plan.record.made_at));
        let route = &self.scene.routes[agent_idx];
        (self.step_idx.saturating_sub(since)..=self.step_idx).any(|step_idx| route.backs_up(step_idx))
    }
}

/// What an agent does in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AgentMotion {
    /// It is there after the step, with this velocity in the scene frame.
    Place(Pose2, Vector2),
    /// It leaves the world.
    Leave,
}

/// A driver of background agents, batched over worlds.
pub trait DriverModel: Send + Sync {
    /// Kind of driver, as in reports; its name in a batch is that of the table.
    fn name(&self) -> &str;

    /// States of each agent that it looks back at, the present one included; 0: it makes no plans.
    fn history_states(&self) -> usize {
        0
    }

    /// Fewest logged states, the present one included, that it needs at a start; earlier ones are not valid then.
    fn least_history_states(&self) -> usize {
        1
    }

    /// Plans for the worlds about to be stepped, before any `act`: one entry for each request, `None` to keep its plan.
    ///
    /// # Errors
    /// Whatever stops the driver; the tick is then not executed.
    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> Result<Vec<Option<PlanState>>> {
        Ok(vec![None; requests.len()])
    }

    /// Whether an agent is driven along its route. Where its log backs up, the world moves it as IDM does, until the driver has
    /// made a plan since: it goes back with the log, or waits. IDM itself needs no word of this.
    fn follows_route(&self, _plan: Option<&PlanState>, _agent_idx: usize) -> bool {
        false
    }

    /// How one agent moves in this step: by default that of its plan, and of its log where it has none.
    fn act(&self, world: &WorldView<'_>, plan: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        match plan.and_then(|p| p.follow(world, agent_idx)) {
            Some((pose, velocity)) => AgentMotion::Place(pose, velocity),
            None => Replay.act(world, None, agent_idx),
        }
    }
}
