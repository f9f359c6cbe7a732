//! What choosing adversaries is rewarded for: the options of the environments that learn it.

use crate::options::within;
use crate::{choices, options};

choices! {
    /// Which collisions of the ego with vehicles that were adversaries in the episode count.
    #[derive(Clone, Copy, Eq)]
    pub enum CountedCollisions {
        /// All of them (paper).
        All = "all",
        /// Those that the ego is at fault for.
        EgoAtFault = "ego_at_fault",
        /// Those that another plan of the ego would have avoided (`counterfactual.rollout_avoidability`, up to a second each).
        Avoidable = "avoidable",
    }
}

options! {
    /// Reward of one decision about adversaries: collisions that count, less the cost of the guidance.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct SelectionReward {
        /// Per collision that counts.
        collision: f64 = 1.0, range within(0.0, 1e6);
        /// Which collisions count.
        counts: CountedCollisions = CountedCollisions::All;
        /// Cost per standard deviation by which guidance moves the adversary's plan (`shift_sigmas`). Learning finds
        /// nobody worth it where it is high from the beginning: start low, then raise it.
        shift_cost: f64 = 0.03, range within(0.0, 1e6);
    }
}
