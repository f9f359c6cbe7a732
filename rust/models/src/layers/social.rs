//! Attention between agents at each token, masked by the decision causal graph G (reference.md#attention-between-agents).
//!
//! Every row attends to its own slots: batched per row, identical to masking an M x M² attention. The mask is applied
//! before the softmax (reference.md#causal-mask).

use super::attention::FeedForward;
use tch::{Kind, Tensor, nn};

/// Which row sits in which slot, and who may be seen.
#[derive(Debug)]
pub(crate) struct Slots {
    /// Row of each slot, flat [R · K], int64.
    pub(crate) rows: Tensor,
    /// Others that may be seen, or the row itself (slot 0) where nobody else may be, [R, K, T].
    pub(crate) others_or_self: Tensor,
    /// Others that may be seen and the row itself, [R, K, T].
    pub(crate) with_self: Tensor,
    /// Number of slots K.
    pub(crate) num_slots: i64,
}

impl Slots {
    /// From neighbour rows [R, K], edges of G [R, K] and availability [R, K, T].
    pub(crate) fn new(neighbours: &Tensor, is_edge: &Tensor, available: &Tensor) -> Self {
        let others = available.logical_and(&is_edge.unsqueeze(2));
        let num_slots = others.size()[1];
        let rest = others.narrow(1, 1, num_slots - 1);
        let alone = others.any_dim(1, true).logical_not();
        Self {
            rows: neighbours.flatten(0, 1),
            with_self: Tensor::cat(&[alone.ones_like(), rest.shallow_clone()], 1),
            others_or_self: Tensor::cat(&[alone, rest], 1),
            num_slots,
        }
    }

    /// The same slots for N samples of the R rows, sample by sample.
    pub(crate) fn repeated(&self, samples: i64) -> Self {
        let rows = self.with_self.size()[0];
        let offsets = Tensor::arange(samples, (Kind::Int64, self.rows.device())) * rows;
        Self {
            rows: (self.rows.unsqueeze(0) + offsets.unsqueeze(1)).flatten(0, 1),
            others_or_self: self.others_or_self.repeat([samples, 1, 1]),
            with_self: self.with_self.repeat([samples, 1, 1]),
            num_slots: self.num_slots,
        }
    }

    /// The slots' rows of [R, T, d]: [R, K, T, d].
    fn gather(&self, x: &Tensor) -> Tensor {
        let size = x.size();
        if self.num_slots == 1 {
            return x.unsqueeze(1);
        }
        x.index_select(0, &self.rows).view([size[0], self.num_slots, size[1], size[2]])
    }
}

/// Attention weights [R, K, T, h] of queries [R, T, d] over keys [R, K, T, d].
fn weights(q: &Tensor, k: &Tensor, allowed: &Tensor, heads: i64) -> Tensor {
    let size = k.size();
    let head = size[3] / heads;
    let products = (q.unsqueeze(1) * k).view([size[0], size[1], size[2], heads, head]);
    let scores = products.sum_dim_intlist([-1i64].as_slice(), false, Kind::Float) * (head as f64).powf(-0.5);
    scores.masked_fill(&allowed.logical_not().unsqueeze(3), f64::NEG_INFINITY).softmax(1, Kind::Float)
}

/// Sum over slots of values [R, K, T, d] by weights [R, K, T, h].
fn mix(weights: &Tensor, v: &Tensor) -> Tensor {
    let w = weights.size();
    let v = v.view([w[0], w[1], w[2], w[3], -1]);
    (weights.unsqueeze(4) * v).sum_dim_intlist([1i64].as_slice(), false, Kind::Float).flatten(2, 3)
}

/// Gated attention over neighbours' tokens joined with the edge to them; self excluded unless alone.
#[derive(Debug)]
pub(crate) struct EdgeAwareLayer {
    query: nn::Linear,
    key: nn::Linear,
    value: nn::Linear,
    out: nn::Linear,
    own: nn::Linear,
    gate_in: nn::Linear,
    gate_own: nn::Linear,
    norm: nn::LayerNorm,
    feed: FeedForward,
    feed_norm: nn::LayerNorm,
    width: i64,
    heads: i64,
}

impl EdgeAwareLayer {
    pub(crate) fn new(p: &nn::Path, width: i64, edge_width: i64, heads: i64, hidden: i64) -> Self {
        let linear = |name: &str, inputs: i64| nn::linear(p / name, inputs, width, Default::default());
        let norm = |name: &str| nn::layer_norm(p / name, vec![width], Default::default());
        Self {
            query: linear("query", width),
            key: linear("key", width + edge_width),
            value: linear("value", width + edge_width),
            out: linear("out", width),
            own: linear("own", width),
            gate_in: linear("gate_in", width),
            gate_own: linear("gate_own", width),
            norm: norm("norm"),
            feed: FeedForward::new(&(p / "feed"), width, hidden),
            feed_norm: norm("feed_norm"),
            width,
            heads,
        }
    }

    /// A linear layer over [token, edge] split at the joint: tokens are projected once per agent, then gathered.
    fn project(&self, layer: &nn::Linear, memory: &Tensor, edges: &Tensor, slots: &Slots) -> Tensor {
        let edge_width = layer.ws.size()[1] - self.width;
        let of_token = memory.linear(&layer.ws.narrow(1, 0, self.width), layer.bs.as_ref());
        let of_edge = edges.linear(&layer.ws.narrow(1, self.width, edge_width), None::<&Tensor>);
        slots.gather(&of_token) + of_edge
    }

    /// Attention of `x` [R, T, d] over `memory` [R, T, d] with `edges` [R, K, T, e]: result and weights [R, K, T, h].
    fn attend(&self, x: &Tensor, memory: &Tensor, edges: &Tensor, slots: &Slots) -> (Tensor, Tensor) {
        let q = x.apply(&self.norm).apply(&self.query);
        let k = self.project(&self.key, memory, edges, slots);
        let v = self.project(&self.value, memory, edges, slots);
        let attention = weights(&q, &k, &slots.others_or_self, self.heads);
        (mix(&attention, &v).apply(&self.out), attention)
    }

    /// `x` [R, T, d] → x and the attention weights [R, K, T, h]; the memory is that of the first layer's input.
    pub(crate) fn forward(
        &self,
        x: &Tensor,
        memory: &Tensor,
        edges: &Tensor,
        slots: &Slots,
    ) -> (Tensor, Tensor) {
        let (a, attention) = self.attend(x, memory, edges, slots);
        let gate = (a.apply(&self.gate_in) + x.apply(&self.gate_own)).sigmoid();
        let x = &a + gate * (x.apply(&self.own) - &a);
        let x = &x + self.feed.forward(&x.apply(&self.feed_norm));
        (x, attention)
    }
}

/// A plain encoder layer across agents, masked by G with self.
#[derive(Debug)]
pub(crate) struct PlainLayer {
    query: nn::Linear,
    key: nn::Linear,
    value: nn::Linear,
    out: nn::Linear,
    norm: nn::LayerNorm,
    feed: FeedForward,
    feed_norm: nn::LayerNorm,
    heads: i64,
}

impl PlainLayer {
    pub(crate) fn new(p: &nn::Path, width: i64, heads: i64, hidden: i64) -> Self {
        let linear = |name: &str| nn::linear(p / name, width, width, Default::default());
        let norm = |name: &str| nn::layer_norm(p / name, vec![width], Default::default());
        Self {
            query: linear("query"),
            key: linear("key"),
            value: linear("value"),
            out: linear("out"),
            norm: norm("norm"),
            feed: FeedForward::new(&(p / "feed"), width, hidden),
            feed_norm: norm("feed_norm"),
            heads,
        }
    }

    pub(crate) fn forward(&self, x: &Tensor, slots: &Slots) -> Tensor {
        let k = slots.gather(&x.apply(&self.key));
        let v = slots.gather(&x.apply(&self.value));
        let attention = weights(&x.apply(&self.query), &k, &slots.with_self, self.heads);
        let x = (x + mix(&attention, &v).apply(&self.out)).apply(&self.norm);
        (&x + self.feed.forward(&x)).apply(&self.feed_norm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::Device;

    /// The M x M² form: all edges flattened as keys, a block mask per row.
    fn block_masked(layer: &EdgeAwareLayer, x: &Tensor, edges: &Tensor, graph: &[bool]) -> Tensor {
        let (m, d) = (x.size()[0], layer.width);
        let memory = Tensor::cat(&[x.unsqueeze(0).expand([m, m, d], false), edges.shallow_clone()], 2);
        let memory = memory.view([m * m, -1]);
        let (h, e) = (layer.heads, d / layer.heads);
        let heads = |t: Tensor| t.view([-1, h, e]).transpose(0, 1);
        let q = heads(x.apply(&layer.norm).apply(&layer.query));
        let (k, v) = (heads(memory.apply(&layer.key)), heads(memory.apply(&layer.value)));
        let size = m as usize;
        let mut mask = vec![false; size * size * size];
        for i in 0..size {
            let row: Vec<bool> = (0..size).map(|j| j != i && graph[i * size + j]).collect();
            let alone = !row.iter().any(|s| *s);
            for j in 0..size {
                mask[i * size * size + i * size + j] = row[j] || (alone && i == j);
            }
        }
        let mask = Tensor::from_slice(&mask).view([1, m, m * m]);
        let scores = q.matmul(&k.transpose(1, 2)) / (e as f64).sqrt();
        let w = scores.masked_fill(&mask.logical_not(), f64::NEG_INFINITY).softmax(2, Kind::Float);
        w.matmul(&v).transpose(0, 1).reshape([m, d]).apply(&layer.out)
    }

    #[test]
    fn attention_per_row_equals_the_block_masked_form() {
        tch::manual_seed(3);
        let vs = nn::VarStore::new(Device::Cpu);
        let layer = EdgeAwareLayer::new(&vs.root(), 16, 8, 4, 32);
        let m = 5i64;
        let options = (Kind::Float, Device::Cpu);
        let (x, edges) = (Tensor::randn([m, 16], options), Tensor::randn([m, m, 8], options));
        let graph: Vec<bool> = (0..25).map(|i| i % 3 != 0 && i / 5 != 2).collect();
        // slot 0 is the row itself, then the others in order
        let order: Vec<i64> =
            (0..m).flat_map(|i| std::iter::once(i).chain((0..m).filter(move |j| *j != i))).collect();
        let is_edge: Vec<bool> =
            order.iter().enumerate().map(|(at, j)| at % 5 != 0 && graph[at / 5 * 5 + *j as usize]).collect();
        let neighbours = Tensor::from_slice(&order).view([m, m]);
        let slots = Slots::new(
            &neighbours,
            &Tensor::from_slice(&is_edge).view([m, m]),
            &Tensor::ones([m, m, 1], (Kind::Bool, Device::Cpu)),
        );
        let index = neighbours.unsqueeze(2).expand([m, m, 8], false);
        let slot_edges = edges.gather(1, &index, false).unsqueeze(2);
        let x3 = x.unsqueeze(1);
        let (got, _) = layer.attend(&x3, &x3, &slot_edges, &slots);
        let want = block_masked(&layer, &x, &edges, &graph);
        assert!(got.squeeze_dim(1).allclose(&want, 1e-5, 1e-5, false));
    }
}
