//! The losses of guidance, one file each. All see rolled-out plans in the scene frame and give a loss per agent and its
//! gradient with respect to all states.

mod agent_collision;
mod approach;
mod disks;
mod map_collision;
mod over_speed;
mod python;

pub use agent_collision::AgentCollision;
pub use approach::Approach;
pub use map_collision::MapCollision;
pub use over_speed::OverSpeed;
pub use python::{Called, Caller, PythonCost, connect};

use super::context::GuidanceContext;
use super::rollout::{Rollout, StateGradient};
use ccdiff_sim::choices;

choices! {
    /// One term of the guidance loss. Its signed weight w enters total = Σ w · mean loss, which is minimised: a negative
    /// weight on a collision loss seeks collisions.
    #[derive(Clone)]
    #[serde(tag = "kind")]
    pub enum Objective {
        /// Overlap of the vehicles' disks.
        AgentCollision(AgentCollision) = "agent_collision",
        /// Parts of the body off the road.
        MapCollision(MapCollision) = "map_collision",
        /// Speed above a limit.
        OverSpeed(OverSpeed) = "over_speed",
        /// Closeness of vehicles, with a gradient before contact (ours).
        Approach(Approach) = "approach",
        /// A loss of one's own.
        Python(PythonCost) = "python",
    }
}

impl Objective {
    /// The signed weight.
    pub fn weight(&self) -> f32 {
        match self {
            Self::AgentCollision(o) => o.weight,
            Self::MapCollision(o) => o.weight,
            Self::OverSpeed(o) => o.weight,
            Self::Approach(o) => o.weight,
            Self::Python(o) => o.weight,
        }
    }

    /// Whether the loss of an agent depends on where the others go.
    pub fn is_joint(&self) -> bool {
        matches!(self, Self::AgentCollision(_) | Self::Approach(_) | Self::Python(_))
    }
}

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
    /// Adds losses and gradients of all agents of a world, in each of its samples.
    pub fn evaluate(&self, context: &GuidanceContext<'_>, plans: &[&Rollout], out: &mut [Evaluation<'_>]) {
        if let Self::Python(o) = self {
            return o.evaluate(context, plans, out);
        }
        for (plan, out) in plans.iter().zip(out) {
            match self {
                Self::AgentCollision(o) => o.evaluate(context, plan, out),
                Self::MapCollision(o) => o.evaluate(context, plan, out),
                Self::OverSpeed(o) => o.evaluate(context, plan, out),
                Self::Approach(o) => o.evaluate(context, plan, out),
                Self::Python(_) => {}
            }
        }
    }
}
