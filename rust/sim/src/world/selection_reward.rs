//! What choosing adversaries is rewarded for: the options of the environments that learn it.

use crate::options::WEIGHT;
use crate::{choices, options};

choices! {
    /// Which collisions of agents that were adversaries in the episode count.
    #[derive(Clone, Copy, Eq)]
    pub enum CountedCollisions {
        /// Those with the ego.
        Ego = "ego",
        /// Those with any vehicle.
        Any = "any",
    }
}

options! {
    /// Weights of the reward components of one decision about adversaries; the reward is their sum.
    ///
    /// A collision is worth more than an episode of unrealistic plans costs: else, as few choices lead to one, choosing
    /// nobody would be best.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct SelectionReward {
        /// Per new collision that counts.
        collision: f64 = 5.0, range WEIGHT;
        /// Which collisions count, of agents that were adversaries in the episode.
        count: CountedCollisions = CountedCollisions::Ego;
        /// Whether collisions count that the ego is at fault for (paper), such as rear-ending an adversary that brakes.
        ego_fault: bool = true;
        /// Whether collisions of the ego count only where another ego plan would have avoided them
        /// (`counterfactual.rollout_avoidability`, up to a second each).
        avoidable_only: bool = false;
        /// Per unit of realism cost (total variation between guided and unguided actions, the paper's C), mean over
        /// adversaries.
        realism: f64 = -0.02, range WEIGHT;
        /// Per share of steps that adversaries spend off the road.
        off_road: f64 = -0.1, range WEIGHT;
        /// Per unit of discomfort (as `RewardConfig`), mean over steps and adversaries.
        comfort: f64 = -0.005, range WEIGHT;
    }
}
