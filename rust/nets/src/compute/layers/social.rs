//! Attention between agents at each token, masked by the decision causal graph G (reference.md#attention-between-agents).
//!
//! Every row attends to its own slots: batched per row, identical to masking an M x M² attention. The mask is applied
//! before the softmax (reference.md#causal-mask).

use super::perceptron::Perceptron;
use crate::compute::backend::Backend;

/// Gated attention over neighbours' tokens joined with the edge to them; self excluded unless alone.
#[derive(Debug)]
pub struct EdgeAwareLayer<B: Backend> {
    /// Queries.
    pub query: B::Linear,
    /// Keys.
    pub key: B::Joint,
    /// Values.
    pub value: B::Joint,
    /// From what was attended to.
    pub out: B::Linear,
    pub(crate) own: B::Linear,
    pub(crate) gate_in: B::Linear,
    pub(crate) gate_own: B::Linear,
    /// Before the queries.
    pub norm: B::Norm,
    pub(crate) feed: Perceptron<B>,
    pub(crate) feed_norm: B::Norm,
    pub(crate) heads: i64,
}

impl<B: Backend> EdgeAwareLayer<B> {
    /// A layer with so many heads and hidden numbers.
    pub fn new(p: &B::Path<'_>, width: i64, edge_width: i64, heads: i64, hidden: i64) -> Self {
        let linear = |name| B::linear(&B::sub(p, name), width, width);
        let joint = |name| B::joint(&B::sub(p, name), width, edge_width, width);
        let norm = |name| B::norm(&B::sub(p, name), width);
        Self {
            query: linear("query"),
            key: joint("key"),
            value: joint("value"),
            out: linear("out"),
            own: linear("own"),
            gate_in: linear("gate_in"),
            gate_own: linear("gate_own"),
            norm: norm("norm"),
            feed: Perceptron::feed(&B::sub(p, "feed"), width, hidden),
            feed_norm: norm("feed_norm"),
            heads,
        }
    }

    /// Attention of `x` [R, T, d] over `memory` [R, T, d] with `edges`: result and weights.
    pub fn attend(
        &self,
        x: &B::Tensor,
        memory: &B::Tensor,
        edges: &B::Tensor,
        slots: &B::Slots,
    ) -> (B::Tensor, B::Attention) {
        let q = B::apply(&self.query, &B::normed(&self.norm, x, false));
        // tokens are projected once per agent
        let (key, key_edge) = B::apply_joint(&self.key, memory, edges);
        let (value, value_edge) = B::apply_joint(&self.value, memory, edges);
        let (kv, edges) = ((key, value), (key_edge, value_edge));
        let (mixed, attention) = B::attend_across(&q, &kv, Some(&edges), slots, self.heads);
        (B::apply(&self.out, &mixed), attention)
    }

    /// `x` [R, T, d] → x and the attention weights; the memory is that of the first layer's input.
    pub fn forward(
        &self,
        x: &B::Tensor,
        memory: &B::Tensor,
        edges: &B::Tensor,
        slots: &B::Slots,
    ) -> (B::Tensor, B::Attention) {
        let (a, attention) = self.attend(x, memory, edges, slots);
        let (g, h) = (B::apply(&self.gate_in, &a), B::apply(&self.gate_own, x));
        let x = B::gated(&a, &g, &h, B::apply(&self.own, x));
        let fed = self.feed.forward(&B::normed(&self.feed_norm, &x, false));
        (B::sum(fed, &x), attention)
    }
}
