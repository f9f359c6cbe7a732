//! Linear layers with ReLUs between them.

use tch::{Tensor, nn};

/// A multi-layer perceptron without an activation at its end.
#[derive(Debug)]
pub(crate) struct Perceptron(Vec<nn::Linear>);

impl Perceptron {
    /// Layers between these widths.
    pub(crate) fn new(p: &nn::Path, widths: &[i64]) -> Self {
        let layer = |(i, w): (usize, &[i64])| nn::linear(p / i, w[0], w[1], Default::default());
        Self(widths.windows(2).enumerate().map(layer).collect())
    }

    pub(crate) fn forward(&self, x: &Tensor) -> Tensor {
        let last = self.0.len().saturating_sub(1);
        self.0.iter().enumerate().fold(x.shallow_clone(), |x, (i, layer)| {
            let y = x.apply(layer);
            if i < last { y.relu() } else { y }
        })
    }
}
