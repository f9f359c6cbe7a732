//! Attention and transformer encoder layers over the tokens of each agent, post-norm as in PyTorch.

use crate::compute::backend::{KeyValue, Ops};

/// Multi-head attention with separate projections.
#[derive(Debug)]
pub struct Attention<B: Ops> {
    query: B::Linear,
    key: B::Linear,
    value: B::Linear,
    out: B::Linear,
    heads: i64,
}

impl<B: Ops> Attention<B> {
    /// Queries of `width`, keys and values from `memory_width`.
    pub fn new(p: &B::Path<'_>, width: i64, memory_width: i64, heads: i64) -> Self {
        let linear = |name, inputs| B::linear(&B::sub(p, name), inputs, width);
        Self {
            query: linear("query", width),
            key: linear("key", memory_width),
            value: linear("value", memory_width),
            out: linear("out", width),
            heads,
        }
    }

    /// Keys and values of a memory [R, S, width].
    pub fn memory(&self, memory: &B::Tensor) -> KeyValue<B> {
        (B::apply(&self.key, memory), B::apply(&self.value, memory))
    }

    /// `x` [R, T, width] attends to keys and values that the mask lets be seen.
    pub fn forward(&self, x: &B::Tensor, kv: &KeyValue<B>, mask: Option<&B::Mask>) -> B::Tensor {
        B::apply(&self.out, &B::attend(&B::apply(&self.query, x), kv, self.heads, mask))
    }
}

/// Two linear layers with a ReLU between them.
#[derive(Debug)]
pub struct FeedForward<B: Ops>(pub(crate) B::Linear, pub(crate) B::Linear);

impl<B: Ops> FeedForward<B> {
    /// Layers `up` to the hidden width and `down` from it.
    pub fn new(p: &B::Path<'_>, width: i64, hidden: i64) -> Self {
        Self(B::linear(&B::sub(p, "up"), width, hidden), B::linear(&B::sub(p, "down"), hidden, width))
    }

    /// Tokens of the width to tokens of the width.
    pub fn forward(&self, x: &B::Tensor) -> B::Tensor {
        B::apply(&self.1, &B::apply_relu(&self.0, x))
    }
}

/// One encoder layer: x ← LN(x + attention(x)), x ← LN(x + W2 ReLU(W1 x)).
#[derive(Debug)]
pub struct TemporalLayer<B: Ops> {
    attention: Attention<B>,
    norm: B::Norm,
    feed: FeedForward<B>,
    feed_norm: B::Norm,
}

impl<B: Ops> TemporalLayer<B> {
    /// A layer with so many heads and hidden numbers.
    pub fn new(p: &B::Path<'_>, width: i64, heads: i64, hidden: i64) -> Self {
        Self {
            attention: Attention::new(&B::sub(p, "attention"), width, width, heads),
            norm: B::norm(&B::sub(p, "norm"), width),
            feed: FeedForward::new(&B::sub(p, "feed"), width, hidden),
            feed_norm: B::norm(&B::sub(p, "feed_norm"), width),
        }
    }

    /// [R, T, d] → [R, T, d].
    pub fn forward(&self, x: &B::Tensor, mask: Option<&B::Mask>) -> B::Tensor {
        let kv = self.attention.memory(x);
        let x = B::sum_normed(&self.norm, x, self.attention.forward(x, &kv, mask));
        B::sum_normed(&self.feed_norm, &x, self.feed.forward(&x))
    }
}
