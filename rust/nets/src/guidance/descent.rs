//! Gradient steps within a bound, on the plan of one agent.

use super::config::{Clip, GuidanceConfig};

const BETA: (f32, f32) = (0.9, 0.999);
const EPSILON: f32 = 1e-8;

/// A plan on its way down, with its start and Adam's moments.
#[derive(Debug)]
pub(super) struct Descent<'c> {
    config: &'c GuidanceConfig,
    start: Vec<f32>,
    moments: Vec<(f32, f32)>,
    num_steps: i32,
    /// Largest move of a coordinate or, for [`Clip::Norm`], of the plan.
    limit: f32,
}

impl<'c> Descent<'c> {
    pub(super) fn new(config: &'c GuidanceConfig, start: &[f32], limit: f32) -> Self {
        Self { config, start: start.to_vec(), moments: vec![(0.0, 0.0); start.len()], num_steps: 0, limit }
    }

    /// One step along a gradient. Coordinates with zero gradient throughout keep their bits.
    pub(super) fn step(&mut self, gradient: &[f32], x: &mut [f32]) {
        self.num_steps += 1;
        let unbias = |beta: f32| 1.0 - beta.powi(self.num_steps);
        let (unbias_1, unbias_2) = (unbias(BETA.0), unbias(BETA.1));
        let rate = self.config.learning_rate;
        for ((x, g), (m, v)) in x.iter_mut().zip(gradient).zip(&mut self.moments) {
            *m = BETA.0 * *m + (1.0 - BETA.0) * g;
            *v = BETA.1 * *v + (1.0 - BETA.1) * g * g;
            let step = (*m / unbias_1) / ((*v / unbias_2).sqrt() + EPSILON);
            if step != 0.0 {
                *x -= rate * step;
            }
        }
        self.clip(x);
    }

    fn clip(&self, x: &mut [f32]) {
        let moved = || self.start.iter();
        match self.config.clip {
            Clip::Sigma => {
                for (x, start) in x.iter_mut().zip(moved()) {
                    let by = *x - start;
                    if by.abs() > self.limit {
                        *x = start + self.limit.copysign(by);
                    }
                }
            }
            Clip::Norm => {
                let squared: f32 = x.iter().zip(moved()).map(|(x, s)| (x - s) * (x - s)).sum();
                let norm = squared.sqrt();
                if norm > self.limit {
                    let share = self.limit / norm;
                    for (x, start) in x.iter_mut().zip(moved()).filter(|(x, s)| *x != *s) {
                        *x = start + share * (*x - start);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_of_adam_moves_by_the_learning_rate_against_the_gradients_sign() {
        let config = GuidanceConfig::released();
        let start = [1.0, -2.0, 0.5];
        let mut x = start;
        Descent::new(&config, &start, 10.0).step(&[4.0, -0.03, 0.0], &mut x);
        assert!((x[0] - 0.7).abs() < 1e-5 && (x[1] + 1.7).abs() < 1e-5);
        assert_eq!(x[2].to_bits(), start[2].to_bits());
    }

    #[test]
    fn both_clips_hold_the_move_within_their_limit() {
        let start = [0.0, 0.0];
        for (clip, limit) in [(Clip::Sigma, 0.5), (Clip::Norm, 0.5)] {
            let config = GuidanceConfig { clip, learning_rate: 1.0, ..GuidanceConfig::released() };
            let mut x = start;
            let mut descent = Descent::new(&config, &start, limit);
            for _ in 0..5 {
                descent.step(&[-3.0, -4.0], &mut x);
            }
            // Adam moves both alike
            let expected = if clip == Clip::Sigma { 0.5 } else { 0.125f32.sqrt() };
            assert!(x.iter().all(|x| (x - expected).abs() < 1e-5), "{x:?}");
        }
    }
}
