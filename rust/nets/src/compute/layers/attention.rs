//! Attention and transformer encoder layers over the tokens of each agent, post-norm as in PyTorch.

use super::perceptron::Perceptron;
use crate::compute::backend::{Backend, KeyValue};

/// Multi-head attention with separate projections.
#[derive(Debug)]
pub struct Attention<B: Backend> {
    query: B::Linear,
    key: B::Linear,
    value: B::Linear,
    out: B::Linear,
    heads: i64,
}

impl<B: Backend> Attention<B> {
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

    /// `x` [R, T, width] attends to keys and values, with slots to those of the tokens that may be seen.
    pub fn forward(&self, x: &B::Tensor, (k, v): &KeyValue<B>, slots: Option<&B::Slots>) -> B::Tensor {
        B::apply(&self.out, &B::attend(&B::apply(&self.query, x), (k, v), self.heads, slots))
    }
}

/// An encoder layer: x ← LN(x + attention(x)), x ← LN(x + W2 ReLU(W1 x)).
#[derive(Debug)]
pub struct EncoderLayer<B: Backend> {
    attention: Attention<B>,
    norm: B::Norm,
    feed: Perceptron<B>,
    feed_norm: B::Norm,
}

impl<B: Backend> EncoderLayer<B> {
    /// A layer with so many heads and hidden numbers, its attention at a place of its own.
    pub fn new(p: &B::Path<'_>, attention: &B::Path<'_>, width: i64, heads: i64, hidden: i64) -> Self {
        Self {
            attention: Attention::new(attention, width, width, heads),
            norm: B::norm(&B::sub(p, "norm"), width),
            feed: Perceptron::feed(&B::sub(p, "feed"), width, hidden),
            feed_norm: B::norm(&B::sub(p, "feed_norm"), width),
        }
    }

    /// [R, T, d] → [R, T, d]: attention between the tokens of a row.
    pub fn within(&self, x: &B::Tensor, slots: &B::Slots) -> B::Tensor {
        let kv = self.attention.memory(x);
        self.fed(x, self.attention.forward(x, &kv, Some(slots)))
    }

    /// [R, T, d] → [R, T, d]: attention between rows, masked by G with self.
    pub fn across(&self, x: &B::Tensor, slots: &B::Slots) -> B::Tensor {
        let Attention { query, out, heads, .. } = &self.attention;
        let (q, kv) = (B::apply(query, x), self.attention.memory(x));
        self.fed(x, B::apply(out, &B::attend_across(&q, &kv, None, slots, *heads).0))
    }

    fn fed(&self, x: &B::Tensor, attended: B::Tensor) -> B::Tensor {
        let x = B::sum_normed(&self.norm, x, attended);
        B::sum_normed(&self.feed_norm, &x, self.feed.forward(&x))
    }
}
