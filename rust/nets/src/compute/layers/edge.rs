//! Encoder of pairwise features (reference.md#pairwise-features): four groups of two, summed.

use crate::compute::backend::Backend;

/// Edge features [.., 8] → [.., edge width].
#[derive(Debug)]
pub struct EdgeEncoder<B: Backend> {
    groups: [(B::Linear, B::Norm, B::Linear); 4],
    norm: B::Norm,
    out: B::Linear,
    out_norm: B::Norm,
}

impl<B: Backend> EdgeEncoder<B> {
    /// An encoder to this width.
    pub fn new(p: &B::Path<'_>, width: i64) -> Self {
        let norm = |p: &B::Path<'_>, name| B::norm(&B::sub(p, name), width);
        let group = |g: &str| {
            let q = B::sub(&B::sub(p, "group"), g);
            let first = B::linear(&B::sub(&q, "in"), 2, width);
            (first, norm(&q, "norm"), B::linear(&B::sub(&q, "out"), width, width))
        };
        Self {
            groups: ["0", "1", "2", "3"].map(group),
            norm: norm(p, "norm"),
            out: B::linear(&B::sub(p, "out"), width, width),
            out_norm: norm(p, "out_norm"),
        }
    }

    /// Features to encoded edges. With `moved`, the tokens of an edge differ in its place alone.
    pub fn forward(&self, edges: &B::Tensor, moved: bool) -> B::Tensor {
        let part = |g: usize, edges: &B::Tensor| {
            let (first, norm, second) = &self.groups[g];
            B::apply(second, &B::normed(norm, &B::apply(first, &B::columns(edges, 2 * g as i64, 2)), true))
        };
        let one = moved.then(|| B::last(edges, 1));
        let rest = one.as_ref().unwrap_or(edges);
        let sum = (1..4).fold(part(0, edges), |sum, g| B::sum(sum, &part(g, rest)));
        B::normed(&self.out_norm, &B::apply(&self.out, &B::normed(&self.norm, &sum, true)), false)
    }
}
