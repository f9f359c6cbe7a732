//! Linear layers with ReLUs between them.

use crate::compute::backend::Backend;

/// A multi-layer perceptron without an activation at its end.
#[derive(Debug)]
pub struct Perceptron<B: Backend>(pub(crate) Vec<B::Linear>);

impl<B: Backend> Perceptron<B> {
    /// Layers by number between these widths.
    pub fn new(p: &B::Path<'_>, widths: &[i64]) -> Self {
        let names: Vec<String> = (1..widths.len()).map(|i| (i - 1).to_string()).collect();
        Self::named(p, &names, widths)
    }

    /// Layers of these names between these widths.
    pub fn named(p: &B::Path<'_>, names: &[impl AsRef<str>], widths: &[i64]) -> Self {
        let layers = names.iter().zip(widths.windows(2));
        Self(layers.map(|(name, w)| B::linear(&B::sub(p, name.as_ref()), w[0], w[1])).collect())
    }

    /// Layers `up` to a hidden width and `down` from it.
    pub fn feed(p: &B::Path<'_>, width: i64, hidden: i64) -> Self {
        Self::named(p, &["up", "down"], &[width, hidden, width])
    }

    /// Tokens of the first width to tokens of the last.
    pub fn forward(&self, x: &B::Tensor) -> B::Tensor {
        let Some((first, rest)) = self.0.split_first() else { return B::columns(x, 0, 0) };
        let Some((last, hidden)) = rest.split_last() else { return B::apply(first, x) };
        let x = hidden.iter().fold(B::apply_relu(first, x), |x, layer| B::apply_relu(layer, &x));
        B::apply(last, &x)
    }
}
