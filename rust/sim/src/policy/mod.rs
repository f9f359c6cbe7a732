//! Who drives the agents that nobody drives from outside.
//!
//! A policy first plans for all worlds at once ([`BackgroundPolicy::plan`], the one place where a network runs),
//! then moves single agents from that plan ([`BackgroundPolicy::act`], inside each world's own tick). What has no
//! plan — log replay, constant velocity, IDM — implements `act` alone.

mod constant_velocity;
mod explanation;
mod idm;
mod replay;

pub use constant_velocity::ConstantVelocity;
pub use explanation::{Command, Explanation};
pub use idm::{Idm, idm_acceleration};
pub use replay::Replay;

use crate::error::Result;
use crate::geom::{Pose2, Vector2};
use crate::state::AgentStates;
use crate::world::{Driver, History, PreparedScene, WorldConfig};

/// What a policy may see of a world before a step.
#[derive(Clone, Copy)]
pub struct WorldView<'a> {
    /// Index of the world among the E of its batch.
    pub world_idx: usize,
    /// The scene.
    pub scene: &'a PreparedScene,
    /// States before the step.
    pub states: &'a AgentStates,
    /// Position of each agent along its route, metres, kept for route followers.
    pub route_s_m: &'a [f32],
    /// Who drives each agent.
    pub drivers: &'a [Driver],
    /// Past states, where the policy asked for them.
    pub history: Option<&'a History>,
    /// Step of the log that the states stand at.
    pub step_idx: usize,
    /// Steps since the episode began.
    pub elapsed_steps: usize,
    /// A number that depends on nothing but the world's seed, its episode and the step: the seed of noise.
    pub noise_seed: u64,
    /// Configuration of the world.
    pub config: &'a WorldConfig,
}

/// What an agent does in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// It is there after the step, with this velocity in the scene frame.
    Place(Pose2, Vector2),
    /// It leaves the world.
    Leave,
}

/// A driver of background agents, batched over worlds.
pub trait BackgroundPolicy: Send + Sync {
    /// Name, as in configurations and reports.
    fn name(&self) -> &'static str;

    /// Whether [`WorldView::history`] is to be kept.
    fn needs_history(&self) -> bool {
        false
    }

    /// Plans for all worlds about to be stepped. Called once a tick, before any `act`.
    ///
    /// # Errors
    /// Whatever stops the policy; the tick is then not executed.
    fn plan(&mut self, _worlds: &[WorldView<'_>]) -> Result<()> {
        Ok(())
    }

    /// Whether `plan` has anything to do; batches without a planner skip the phase.
    fn plans(&self) -> bool {
        false
    }

    /// Motion of one agent over the step.
    fn act(&self, world: &WorldView<'_>, agent_idx: usize) -> Motion;

    /// Takes wishes for a world's next plans.
    ///
    /// # Errors
    /// [`crate::SimError::Unknown`] for agents or wishes that the policy does not know.
    fn command(&mut self, _world_idx: usize, _command: Command) -> Result<()> {
        let expected = "a policy that takes commands".into();
        Err(crate::SimError::Unknown { what: "command of policy", got: self.name().into(), expected })
    }

    /// The plan that a world follows, with what it was made from; `None` before the first one.
    fn explain(&self, _world_idx: usize) -> Option<&Explanation> {
        None
    }

    /// Forgets the plan of a world that begins a new episode.
    fn reset_world(&mut self, _world_idx: usize) {}

    /// Plan of a world as bytes, for snapshots.
    fn save_world(&self, _world_idx: usize) -> Vec<u8> {
        Vec::new()
    }

    /// Takes a plan back.
    ///
    /// # Errors
    /// [`crate::SimError::Snapshot`] when the bytes are not a plan of this policy.
    fn load_world(&mut self, _world_idx: usize, _bytes: &[u8]) -> Result<()> {
        Ok(())
    }
}
