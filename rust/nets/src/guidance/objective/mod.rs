//! The losses of guidance, one file each. All see rolled-out plans in the scene frame and give a loss per agent and its
//! gradient with respect to all states.

mod agent_collision;
mod approach;
mod comfort;
mod disks;
mod goal;
mod map_collision;
mod over_speed;
mod target_distance;
mod target_speed;

pub use agent_collision::AgentCollision;
pub use approach::Approach;
pub use comfort::Comfort;
pub use goal::Goal;
pub use map_collision::MapCollision;
pub use over_speed::OverSpeed;
pub use target_distance::TargetDistance;
pub use target_speed::TargetSpeed;

use super::config::Objective;
use super::context::GuidanceContext;
use super::rollout::{Rollout, StateGradient};

/// Where an objective writes to.
#[derive(Debug)]
pub struct Evaluation<'e> {
    /// Takes the loss of each agent, [M], added; right for the wanted agents only.
    pub losses: &'e mut [f32],
    /// Takes `scale` times the gradient of the sum of all agents' losses, added; right for the wanted agents only.
    pub gradient: &'e mut StateGradient,
    /// Agents whose loss and gradient are of interest, [M].
    pub wanted: &'e [bool],
    /// Factor of the gradient.
    pub scale: f32,
}

impl Objective {
    /// Adds losses and gradients of all agents of a world.
    pub fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        match self {
            Self::AgentCollision(o) => o.evaluate(context, plan, out),
            Self::MapCollision(o) => o.evaluate(context, plan, out),
            Self::OverSpeed(o) => o.evaluate(context, plan, out),
            Self::TargetSpeed(o) => o.evaluate(context, plan, out),
            Self::Goal(o) => o.evaluate(context, plan, out),
            Self::Approach(o) => o.evaluate(context, plan, out),
            Self::TargetDistance(o) => o.evaluate(context, plan, out),
            Self::Comfort(o) => o.evaluate(context, plan, out),
        }
    }
}
