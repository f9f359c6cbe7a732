//! The diffusion schedule in f64, without tensors (reference.md#schedule).

/// Cosine schedule of K diffusion steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// Variance added by each step, [K].
    pub beta: Vec<f64>,
    /// Share of signal variance left after each step, [K].
    pub alpha_bar: Vec<f64>,
}

/// Mean of a step from x_k, `from_x0` x_0 + `from_xk` x_k, and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posterior {
    /// Coefficient of the clean sample.
    pub from_x0: f64,
    /// Coefficient of the noisy sample.
    pub from_xk: f64,
    /// Standard deviation.
    pub sigma: f64,
}

impl Schedule {
    /// Cosine schedule with offset s = 0.008, on K points over 0..=K+1 (reference.md#schedule), betas at most 0.999. K is 2 at least.
    pub fn cosine(num_steps: usize) -> Self {
        let (s, steps) = (0.008, num_steps as f64 + 1.0);
        // the released code spaces K+1 points over 0..=K+1
        let f = |i: usize| {
            let x = i as f64 * steps / num_steps as f64;
            libm::cos((x / steps + s) / (1.0 + s) * std::f64::consts::FRAC_PI_2).powi(2)
        };
        let beta: Vec<f64> = (0..num_steps).map(|k| (1.0 - f(k + 1) / f(k)).clamp(0.0, 0.999)).collect();
        let alpha_bar = beta
            .iter()
            .scan(1.0, |product, b| {
                *product *= 1.0 - b;
                Some(*product)
            })
            .collect();
        Self { beta, alpha_bar }
    }

    /// Number of steps K.
    pub fn num_steps(&self) -> usize {
        self.beta.len()
    }

    /// Posterior q(x_{k-1} | x_k, x_0) of step k (k < K).
    pub fn posterior(&self, k: usize) -> Posterior {
        let (beta, now) = (self.beta[k], self.alpha_bar[k]);
        let before = if k == 0 { 1.0 } else { self.alpha_bar[k - 1] };
        Posterior {
            from_x0: beta * before.sqrt() / (1.0 - now),
            from_xk: (1.0 - before) * (1.0 - beta).sqrt() / (1.0 - now),
            sigma: if k == 0 { 0.0 } else { (beta * (1.0 - before) / (1.0 - now)).max(1e-20).sqrt() },
        }
    }

    /// The deterministic DDIM update from step k to step `to`; `None` is the clean end.
    pub fn ddim(&self, k: usize, to: Option<usize>) -> Posterior {
        let now = self.alpha_bar[k];
        let next = to.map_or(1.0, |t| self.alpha_bar[t]);
        let from_xk = ((1.0 - next) / (1.0 - now)).sqrt();
        Posterior { from_x0: next.sqrt() - from_xk * now.sqrt(), from_xk, sigma: 0.0 }
    }

    /// `count` steps from K-1 down to 0, evenly spaced, for a sampler that skips.
    pub fn timesteps(&self, count: usize) -> Vec<usize> {
        let last = self.num_steps() - 1;
        let count = count.clamp(1, self.num_steps());
        if count == 1 {
            return vec![last];
        }
        (0..count).map(|i| (last * (count - 1 - i) + (count - 1) / 2) / (count - 1)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(got: f64, want: f64, relative: f64) {
        assert!((got - want).abs() <= relative * want.abs(), "got {got}, want {want}");
    }

    #[test]
    fn the_cosine_schedule_has_the_tabulated_values() {
        let s = Schedule::cosine(100);
        for (k, beta) in [
            (0, 6.312816e-4),
            (1, 1.116937e-3),
            (10, 5.530370e-3),
            (49, 3.059312e-2),
            (50, 3.154634e-2),
            (90, 0.188751),
            (98, 0.749939),
            (99, 0.999),
        ] {
            close(s.beta[k], beta, 3e-6);
        }
        for (k, alpha_bar) in [
            (0, 0.9993687),
            (1, 0.9982525),
            (10, 0.9667167),
            (49, 0.4938436),
            (50, 0.4782646),
            (99, 2.42857e-7),
        ] {
            close(s.alpha_bar[k], alpha_bar, 3e-6);
        }
    }

    #[test]
    fn the_posterior_has_the_tabulated_coefficients() {
        let s = Schedule::cosine(100);
        for (k, c0, c1) in [(50, 0.0424907, 0.9547153), (99, 0.0155683, 0.0316151)] {
            close(s.posterior(k).from_x0, c0, 3e-6);
            close(s.posterior(k).from_xk, c1, 3e-6);
        }
        let first = s.posterior(0);
        assert!((first.from_x0 - 1.0).abs() < 1e-12 && first.from_xk.abs() < 1e-12 && first.sigma == 0.0);
    }

    #[test]
    fn spaced_steps_start_at_the_noisiest_and_end_at_zero() {
        let s = Schedule::cosine(100);
        for n in 2..=100 {
            let steps = s.timesteps(n);
            assert_eq!((steps[0], steps[n - 1], steps.len()), (99, 0, n));
            assert!(steps.windows(2).all(|w| w[0] > w[1]));
        }
        assert_eq!(s.timesteps(1), [99]);
    }

    #[test]
    fn ddim_keeps_the_signal_to_noise_ratio_of_its_target_step() {
        let s = Schedule::cosine(100);
        // x_k = √ᾱ_k x0 + √(1-ᾱ_k) ε must map to √ᾱ_t x0 + √(1-ᾱ_t) ε
        let step = s.ddim(60, Some(20));
        close(step.from_x0 + step.from_xk * s.alpha_bar[60].sqrt(), s.alpha_bar[20].sqrt(), 1e-12);
        close(step.from_xk * (1.0 - s.alpha_bar[60]).sqrt(), (1.0 - s.alpha_bar[20]).sqrt(), 1e-12);
        assert_eq!(s.ddim(30, None).from_xk, 0.0);
    }
}
