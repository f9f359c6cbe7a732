//! From the numbers handed to `step` to physical actions.

use crate::dynamics::{Action, ActionGrid, Dynamics};
use crate::geom::Real;
use crate::world::config::ActionConfig;

/// Decodes actions of one configuration.
#[derive(Debug, Clone)]
pub struct ActionDecoder {
    dynamics: Dynamics,
    grid: Option<ActionGrid>,
    low: Action,
    high: Action,
}

impl ActionDecoder {
    /// Decoder of a checked configuration.
    pub fn new(config: &ActionConfig) -> Self {
        let c = config;
        let (mut low, mut high) = match c.dynamics {
            Dynamics::Unicycle(_) => (
                [-c.max_deceleration_mps2, -c.max_yaw_rate_radps, 0.0],
                [c.max_acceleration_mps2, c.max_yaw_rate_radps, 0.0],
            ),
            Dynamics::Bicycle(_) => (
                [-c.max_deceleration_mps2, -c.max_steering_rad, 0.0],
                [c.max_acceleration_mps2, c.max_steering_rad, 0.0],
            ),
            Dynamics::DeltaPose(_) => (
                [-c.max_displacement_m, -c.max_displacement_m, -c.max_turn_rad],
                [c.max_displacement_m, c.max_displacement_m, c.max_turn_rad],
            ),
            Dynamics::Assisted(_) => c.dynamics.action_bounds(),
        };
        let (least, greatest) = c.dynamics.action_bounds();
        for i in 0..3 {
            low[i] = low[i].max(least[i]).min(0.0);
            high[i] = high[i].min(greatest[i]).max(0.0);
        }
        let grid = c.discrete.then(|| c.grid.clone().unwrap_or_else(|| ActionGrid::default_for(&c.dynamics)));
        Self { dynamics: c.dynamics, grid, low, high }
    }

    /// Numbers per agent: 1 for a grid, else the columns of the dynamics.
    pub fn width(&self) -> usize {
        if self.grid.is_some() { 1 } else { self.dynamics.columns().len() }
    }

    /// Number of discrete actions, `None` for continuous ones.
    pub fn num_actions(&self) -> Option<usize> {
        self.grid.as_ref().map(ActionGrid::num_actions)
    }

    /// The model of motion.
    pub fn dynamics(&self) -> &Dynamics {
        &self.dynamics
    }

    /// Physical values at −1 and +1 of each column.
    pub fn physical_bounds(&self) -> (Action, Action) {
        (self.low, self.high)
    }

    /// Tells what is wrong with an action: (what was given, what was expected).
    ///
    /// # Errors
    /// For numbers that are not finite, and for indices that are not whole or not of the grid.
    pub fn check(&self, action: &[Real]) -> Result<(), (String, String)> {
        match &self.grid {
            Some(grid) => {
                let index = action[0];
                let ok = index >= 0.0 && index.fract() == 0.0 && (index as usize) < grid.num_actions();
                let expected = || format!("an index of the action grid, 0 to {}", grid.num_actions() - 1);
                if ok { Ok(()) } else { Err((index.to_string(), expected())) }
            }
            None if action.iter().all(|v| v.is_finite()) => Ok(()),
            None => Err((format!("{action:?}"), "finite numbers".into())),
        }
    }

    /// Physical action of a checked action; continuous columns are clipped to [-1, 1] first.
    pub fn decode(&self, action: &[Real]) -> Action {
        if let Some(grid) = &self.grid {
            return grid.action(&self.dynamics, action[0] as usize).unwrap_or_default();
        }
        let mut physical = [0.0; 3];
        for (i, value) in action.iter().enumerate() {
            let v = value.clamp(-1.0, 1.0);
            physical[i] = v * self.range(i, v);
        }
        physical
    }

    /// How far a column goes to the side of a number; no branch to guess.
    #[inline]
    fn range(&self, column: usize, number: Real) -> Real {
        [-self.low[column], self.high[column]][usize::from(number >= 0.0)]
    }

    /// Normalised form of a physical action, clipped to [-1, 1]; zero where a column has no range.
    pub fn normalise(&self, physical: &Action) -> Action {
        std::array::from_fn(|i| {
            let (v, scale) = (physical[i], self.range(i, physical[i]));
            if scale > 0.0 { (v / scale).clamp(-1.0, 1.0) } else { 0.0 }
        })
    }

    /// The action of `step` that comes nearest to a physical one.
    pub fn encode(&self, physical: &Action) -> Action {
        let Some(grid) = &self.grid else { return self.normalise(physical) };
        let mut best = (Real::MAX, 0);
        for index in 0..grid.num_actions() {
            let candidate = grid.action(&self.dynamics, index).unwrap_or_default();
            let distance: Real = (0..3)
                .map(|i| (candidate[i] - physical[i]) / (self.high[i] - self.low[i]).max(1e-3))
                .map(|d| d * d)
                .sum();
            if distance < best.0 {
                best = (distance, index);
            }
        }
        [best.1 as Real, 0.0, 0.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_means_zero_and_one_means_the_bound() {
        let decoder = ActionDecoder::new(&ActionConfig::default());
        assert_eq!(decoder.decode(&[0.0, 0.0]), [0.0; 3]);
        assert_eq!(decoder.decode(&[1.0, -1.0]), [4.0, -1.0, 0.0]);
        assert_eq!(decoder.decode(&[-1.0, 7.0]), [-8.0, 1.0, 0.0]);
    }

    #[test]
    fn encoding_a_grid_action_finds_it_again() {
        let config = ActionConfig { discrete: true, ..ActionConfig::default() };
        let decoder = ActionDecoder::new(&config);
        for index in 0..decoder.num_actions().unwrap() {
            let physical = decoder.decode(&[index as f32]);
            assert_eq!(decoder.encode(&physical)[0] as usize, index);
        }
    }
}
