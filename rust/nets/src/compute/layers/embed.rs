//! Embeddings of positions, diffusion steps, histories and routes.

use super::perceptron::Perceptron;
use crate::compute::backend::Backend;
use crate::config::{HistoryTokens, ModelConfig};
use crate::inputs::features::HISTORY_FEATURES;

/// Sinusoidal table [positions, width], sine and cosine interleaved, base 10⁴.
pub fn positions(positions: usize, width: i64) -> Vec<f32> {
    let half = width / 2;
    let angle = |p: usize, i: i64| p as f64 * libm::exp(-(2.0 * i as f64) / width as f64 * libm::log(1e4));
    let angles = (0..positions).flat_map(|p| (0..half).map(move |i| angle(p, i)));
    angles.flat_map(|a| [libm::sin(a) as f32, libm::cos(a) as f32]).collect()
}

/// Sinusoidal table [steps, width] of the diffusion steps: a sine block, then a cosine block.
pub fn diffusion_steps(steps: usize, width: i64) -> Vec<f32> {
    let half = width / 2;
    let rate = libm::log(1e4) / (half - 1).max(1) as f64;
    let mut table = Vec::with_capacity(steps * width as usize);
    for k in 0..steps {
        let angle = |i: i64| k as f64 * libm::exp(-(i as f64) * rate);
        table.extend((0..half).map(|i| libm::sin(angle(i)) as f32));
        table.extend((0..half).map(|i| libm::cos(angle(i)) as f32));
    }
    table
}

/// Diffusion step → width: sinusoid, Linear, Mish, Linear.
#[derive(Debug)]
pub struct StepEmbedding<B: Backend> {
    table: B::Tensor,
    up: B::Linear,
    down: B::Linear,
}

impl<B: Backend> StepEmbedding<B> {
    /// An embedding of so many steps.
    pub fn new(p: &B::Path<'_>, steps: usize, d: i64) -> Self {
        Self {
            table: B::table(p, &diffusion_steps(steps, d), d),
            up: B::linear(&B::sub(p, "up"), d, 4 * d),
            down: B::linear(&B::sub(p, "down"), 4 * d, d),
        }
    }

    /// Steps of the rows to a token of each, [R, 1, d].
    pub fn forward(&self, steps: &[usize]) -> B::Tensor {
        B::apply(&self.down, &B::mish(&B::apply(&self.up, &B::rows_of(&self.table, steps))))
    }
}

/// Histories → tokens.
#[derive(Debug)]
pub enum HistoryEmbedding<B: Backend> {
    /// A token per step.
    PerStep(B::Linear),
    /// One token of so many numbers.
    Summary(i64, Perceptron<B>),
}

impl<B: Backend> HistoryEmbedding<B> {
    /// As the configuration says.
    pub fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let d = config.width;
        match config.history {
            HistoryTokens::PerStep => {
                Self::PerStep(B::linear(&B::sub(p, "step"), HISTORY_FEATURES as i64 - 1, d))
            }
            HistoryTokens::Summary => {
                let inputs = (config.history_steps * HISTORY_FEATURES) as i64;
                Self::Summary(inputs, Perceptron::named(p, &["in", "out"], &[inputs, 4 * d, d]))
            }
        }
    }

    /// Normalised histories [R, H, 8] → tokens [R, H or 1, d].
    pub fn forward(&self, history: &B::Tensor) -> B::Tensor {
        match self {
            Self::PerStep(step) => B::apply(step, &B::columns(history, 0, HISTORY_FEATURES as i64 - 1)),
            Self::Summary(inputs, layers) => layers.forward(&B::cut(history, *inputs)),
        }
    }
}

/// Routes ahead → a part of the history's tokens, at first none.
#[derive(Debug)]
pub struct RouteEmbedding<B: Backend>(Perceptron<B>);

impl<B: Backend> RouteEmbedding<B> {
    /// An embedding of the places that the configuration names.
    pub fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (inputs, d) = (1 + 2 * config.route_points_m.len() as i64, config.width);
        let up = B::linear(&B::sub(p, "up"), inputs, 4 * d);
        Self(Perceptron(vec![up, B::zero_linear(&B::sub(p, "down"), 4 * d, d)]))
    }

    /// Routes [R, 1, 1 + 2 P] and whether they are told [R, 1, 1] → [R, 1, d].
    pub fn forward(&self, route: &B::Tensor, told: &B::Tensor) -> B::Tensor {
        B::scaled(&self.0.forward(route), told)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures were computed in numpy from the definition, apart from this code.
    #[test]
    fn a_diffusion_step_is_embedded_as_tabulated() {
        let table = diffusion_steps(11, 32);
        for (at, want) in
            [(0, -0.5440), (1, -0.7653), (2, 0.2113), (15, 0.0010), (16, -0.8391), (17, 0.6437), (31, 1.0)]
        {
            assert!((table[320 + at] - want).abs() < 1e-4, "{at}: {}", table[320 + at]);
        }
    }
}
