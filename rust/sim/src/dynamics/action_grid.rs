//! Discrete actions: a grid over two columns of a model's actions.

use super::{Action, Dynamics};
use crate::geom::Real;
use crate::options;
use crate::options::MOTION;

options! {
    /// Physical actions to choose from: every value of one axis with every value of the other.
    ///
    /// The action of an index is `first[index // len(second)]`, `second[index % len(second)]`. The first axis is column 0
    /// (acceleration, its change, or dx). The second is the turning column: 2 (dψ) for delta pose, whose dy is 0, else 1.
    #[derive(Clone)]
    #[serde(deny_unknown_fields)]
    pub struct ActionGrid {
        /// Accelerations, m/s² (delta pose: dx, m).
        first: Vec<Real>, range MOTION;
        /// Yaw rates, rad/s (bicycle: steering angles, rad; delta pose: turns, rad; assisted: distances, m).
        second: Vec<Real>, range MOTION;
    }
}

impl ActionGrid {
    /// The default 7 x 9 grid of a model; index 31 is "straight on": zero acceleration (0.5 m forward for delta
    /// pose) and zero turn.
    ///
    /// Denser near zero, where driving mostly happens, and with one braking value beyond comfort.
    pub fn default_for(dynamics: &Dynamics) -> Self {
        let (first, second) = match dynamics {
            Dynamics::Unicycle(_) => (
                [-6.0, -3.0, -1.0, 0.0, 1.0, 2.0, 4.0],
                [-0.9, -0.45, -0.2, -0.07, 0.0, 0.07, 0.2, 0.45, 0.9],
            ),
            Dynamics::Bicycle(_) => (
                [-6.0, -3.0, -1.0, 0.0, 1.0, 2.0, 4.0],
                [-0.5, -0.25, -0.1, -0.03, 0.0, 0.03, 0.1, 0.25, 0.5],
            ),
            Dynamics::DeltaPose(_) => (
                [0.0, 0.1, 0.3, 0.5, 0.8, 1.2, 1.8],
                [-0.09, -0.045, -0.02, -0.007, 0.0, 0.007, 0.02, 0.045, 0.09],
            ),
            Dynamics::Assisted(_) => {
                ([-6.0, -3.0, -1.0, 0.0, 0.5, 1.0, 2.0], [-1.5, -1.0, -0.6, -0.3, 0.0, 0.3, 0.6, 1.0, 1.5])
            }
        };
        Self { first: first.to_vec(), second: second.to_vec() }
    }

    /// Number of actions F x S.
    pub fn num_actions(&self) -> usize {
        self.first.len() * self.second.len()
    }

    /// Action of an index; `None` out of range.
    #[inline]
    pub fn action(&self, dynamics: &Dynamics, index: usize) -> Option<Action> {
        let num_second = self.second.len();
        let (first, second) =
            (*self.first.get(index.checked_div(num_second)?)?, self.second[index % num_second]);
        Some(match dynamics {
            Dynamics::DeltaPose(_) => [first, 0.0, second],
            Dynamics::Unicycle(_) | Dynamics::Bicycle(_) | Dynamics::Assisted(_) => [first, second, 0.0],
        })
    }
}
