//! Attention and transformer encoder layers over the tokens of each agent, post-norm as in PyTorch.

use tch::{Tensor, nn};

/// Multi-head attention with separate projections.
#[derive(Debug)]
pub(crate) struct Attention {
    query: nn::Linear,
    key: nn::Linear,
    value: nn::Linear,
    out: nn::Linear,
    heads: i64,
}

impl Attention {
    /// Queries of `width`, keys and values from `memory_width`.
    pub(crate) fn new(p: &nn::Path, width: i64, memory_width: i64, heads: i64) -> Self {
        Self {
            query: nn::linear(p / "query", width, width, Default::default()),
            key: nn::linear(p / "key", memory_width, width, Default::default()),
            value: nn::linear(p / "value", memory_width, width, Default::default()),
            out: nn::linear(p / "out", width, width, Default::default()),
            heads,
        }
    }

    fn split(&self, x: &Tensor) -> Tensor {
        let size = x.size();
        x.view([size[0], size[1], self.heads, -1]).transpose(1, 2)
    }

    /// Keys and values [R, h, S, d/h] of a memory [R, S, width].
    pub(crate) fn memory(&self, memory: &Tensor) -> (Tensor, Tensor) {
        (self.split(&memory.apply(&self.key)), self.split(&memory.apply(&self.value)))
    }

    /// `x` [R, T, width] attends to keys and values; `mask` [R, 1, 1, S] is true where a key may be seen.
    pub(crate) fn forward(&self, x: &Tensor, kv: &(Tensor, Tensor), mask: Option<&Tensor>) -> Tensor {
        let q = self.split(&x.apply(&self.query));
        let y = Tensor::scaled_dot_product_attention(&q, &kv.0, &kv.1, mask, 0.0, false, None, false);
        y.transpose(1, 2).flatten(2, 3).apply(&self.out)
    }
}

/// Two linear layers with a ReLU between them.
#[derive(Debug)]
pub(crate) struct FeedForward(nn::Linear, nn::Linear);

impl FeedForward {
    pub(crate) fn new(p: &nn::Path, width: i64, hidden: i64) -> Self {
        Self(
            nn::linear(p / "up", width, hidden, Default::default()),
            nn::linear(p / "down", hidden, width, Default::default()),
        )
    }

    pub(crate) fn forward(&self, x: &Tensor) -> Tensor {
        x.apply(&self.0).relu().apply(&self.1)
    }
}

/// One encoder layer: x ← LN(x + attention(x)), x ← LN(x + W2 ReLU(W1 x)).
#[derive(Debug)]
pub(crate) struct TemporalLayer {
    attention: Attention,
    norm: nn::LayerNorm,
    feed: FeedForward,
    feed_norm: nn::LayerNorm,
}

impl TemporalLayer {
    pub(crate) fn new(p: &nn::Path, width: i64, heads: i64, hidden: i64) -> Self {
        let norm = |p: nn::Path| nn::layer_norm(p, vec![width], Default::default());
        Self {
            attention: Attention::new(&(p / "attention"), width, width, heads),
            norm: norm(p / "norm"),
            feed: FeedForward::new(&(p / "feed"), width, hidden),
            feed_norm: norm(p / "feed_norm"),
        }
    }

    /// [R, T, d] → [R, T, d]; `mask` [R, 1, 1, T] is true where a token may be seen.
    pub(crate) fn forward(&self, x: &Tensor, mask: Option<&Tensor>) -> Tensor {
        let kv = self.attention.memory(x);
        let x = (x + self.attention.forward(x, &kv, mask)).apply(&self.norm);
        (&x + self.feed.forward(&x)).apply(&self.feed_norm)
    }
}
