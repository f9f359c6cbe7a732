//! From the lines of the map that agents see to map tokens.

use crate::compute::backend::Backend;
use crate::inputs::segments::SEGMENT_FEATURES;

/// A perceptron for each line, then a layer that also sees what stands out among all of them.
#[derive(Debug)]
pub struct LineEncoder<B: Backend> {
    line: [B::Linear; 2],
    among_all: B::Joint,
    norm: B::Norm,
}

impl<B: Backend> LineEncoder<B> {
    /// An encoder to tokens of a width.
    pub fn new(p: &B::Path<'_>, width: i64) -> Self {
        let line = |name, inputs| B::linear(&B::sub(&B::sub(p, "line"), name), inputs, width);
        Self {
            line: [line("0", SEGMENT_FEATURES as i64), line("1", width)],
            among_all: B::joint(&B::sub(&B::sub(p, "among_all"), "0"), width, width, width),
            norm: B::norm(&B::sub(p, "norm"), width),
        }
    }

    /// Tokens [R, lines, width]; `None` where the batch has no lines.
    pub fn forward(&self, batch: &B::Batch<'_>) -> Option<B::Tensor> {
        let x = B::apply_relu(
            &self.line[1],
            &B::apply_relu(&self.line[0], &B::placed(batch, B::plain(batch).lines()?)),
        );
        let (own, greatest) = B::apply_joint(&self.among_all, &x, &B::greatest(&x));
        Some(B::normed(&self.norm, &B::sum(own, &greatest), false))
    }
}
