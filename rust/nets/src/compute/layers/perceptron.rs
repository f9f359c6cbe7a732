//! Linear layers with ReLUs between them.

use crate::compute::backend::Ops;

/// A multi-layer perceptron without an activation at its end.
#[derive(Debug)]
pub struct Perceptron<B: Ops>(pub(crate) Vec<B::Linear>);

impl<B: Ops> Perceptron<B> {
    /// Layers between these widths.
    pub fn new(p: &B::Path<'_>, widths: &[i64]) -> Self {
        let layer = |(i, w): (usize, &[i64])| B::linear(&B::sub(p, &i.to_string()), w[0], w[1]);
        Self(widths.windows(2).enumerate().map(layer).collect())
    }

    /// Tokens of the first width to tokens of the last.
    pub fn forward(&self, x: &B::Tensor) -> B::Tensor {
        let Some((first, rest)) = self.0.split_first() else { return B::columns(x, 0, 0) };
        let Some((last, hidden)) = rest.split_last() else { return B::apply(first, x) };
        let x = hidden.iter().fold(B::apply_relu(first, x), |x, layer| B::apply_relu(layer, &x));
        B::apply(last, &x)
    }
}
