//! Gradient steps on the plan of one agent.

const BETA: (f32, f32) = (0.9, 0.999);
const EPSILON: f32 = 1e-8;

/// A plan on its way down: Adam's moments.
#[derive(Debug)]
pub(super) struct Descent {
    rate: f32,
    moments: Vec<(f32, f32)>,
    num_steps: i32,
}

impl Descent {
    pub(super) fn new(rate: f32, width: usize) -> Self {
        Self { rate, moments: vec![(0.0, 0.0); width], num_steps: 0 }
    }

    /// One step along a gradient. Coordinates with zero gradient throughout keep their bits.
    pub(super) fn step(&mut self, gradient: &[f32], x: &mut [f32]) {
        self.num_steps += 1;
        let unbias = |beta: f32| 1.0 - beta.powi(self.num_steps);
        let (unbias_1, unbias_2) = (unbias(BETA.0), unbias(BETA.1));
        for ((x, g), (m, v)) in x.iter_mut().zip(gradient).zip(&mut self.moments) {
            *m = BETA.0 * *m + (1.0 - BETA.0) * g;
            *v = BETA.1 * *v + (1.0 - BETA.1) * g * g;
            let step = (*m / unbias_1) / ((*v / unbias_2).sqrt() + EPSILON);
            if step != 0.0 {
                *x -= self.rate * step;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_of_adam_moves_by_the_learning_rate_against_the_gradients_sign() {
        let start = [1.0, -2.0, 0.5];
        let mut x = start;
        Descent::new(0.3, 3).step(&[4.0, -0.03, 0.0], &mut x);
        assert!((x[0] - 0.7).abs() < 1e-5 && (x[1] + 1.7).abs() < 1e-5);
        assert_eq!(x[2].to_bits(), start[2].to_bits());
    }
}
