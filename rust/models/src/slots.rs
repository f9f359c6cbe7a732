//! Attention over the rows in slots, as tensors.

use crate::batch::Neighbourhood;
use crate::config::ModelConfig;
use tch::{Kind, Tensor};

/// Which row sits in which slot, and who may be seen.
#[derive(Debug)]
pub struct Slots {
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
    /// The edges of all tokens, normalised, [R, K, T, 8], and who may be seen. History tokens have the edge of their step; future ones
    /// that of now, moved on at constant relative velocity.
    pub(crate) fn at_tokens(of: &Neighbourhood, config: &ModelConfig) -> (Tensor, Self) {
        let n = &config.normalisation;
        let (pos, vel, edges) = (&n.edge_position_std, n.edge_velocity_std, &of.edges);
        let now = edges.narrow(2, edges.size()[2] - 1, 1);
        let times: Vec<f32> = config.future_token_times_s().iter().map(|t| *t as f32).collect();
        let tokens = times.len() as i64;
        let times = Tensor::from_slice(&times).view([1, 1, tokens, 1]).to_device(edges.device());
        let moved = now.narrow(3, 0, 2) + now.narrow(3, 4, 2) * times;
        let rest = now.narrow(3, 2, 7).expand([-1, -1, tokens, -1], false);
        let all = Tensor::cat(&[edges.shallow_clone(), Tensor::cat(&[moved, rest], 3)], 2);
        let scale = [pos[0], pos[1], 1.0, 1.0, vel, vel, 1.0, 1.0].map(|s| (1.0 / s) as f32);
        let scaled = all.narrow(3, 0, 8) * Tensor::from_slice(&scale).to_device(edges.device());
        (scaled, Self::new(&of.rows, &of.is_edge, &all.select(3, 8).gt(0.5)))
    }

    /// The edges of now as a single token, and who may be seen.
    pub(crate) fn now(of: &Neighbourhood, config: &ModelConfig) -> (Tensor, Self) {
        let (edges, slots) = Self::at_tokens(of, config);
        let [others_or_self, with_self] =
            [&slots.others_or_self, &slots.with_self].map(|seen| seen.narrow(2, 0, 1));
        // the first token's edges are those of now
        (edges.narrow(2, 0, 1), Self { others_or_self, with_self, ..slots })
    }

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

    /// The slots' rows of [R, T, d]: [R, K, T, d].
    pub(crate) fn gather(&self, x: &Tensor) -> Tensor {
        let size = x.size();
        if self.num_slots == 1 {
            return x.unsqueeze(1);
        }
        x.index_select(0, &self.rows).view([size[0], self.num_slots, size[1], size[2]])
    }
}

/// Attention weights [R, K, T, h] of queries [R, T, d] over keys [R, K, T, d].
pub(crate) fn weights(q: &Tensor, k: &Tensor, allowed: &Tensor, heads: i64) -> Tensor {
    let size = k.size();
    let head = size[3] / heads;
    let products = (q.unsqueeze(1) * k).view([size[0], size[1], size[2], heads, head]);
    let scores = products.sum_dim_intlist([-1i64].as_slice(), false, Kind::Float) * (head as f64).powf(-0.5);
    scores.masked_fill(&allowed.logical_not().unsqueeze(3), f64::NEG_INFINITY).softmax(1, Kind::Float)
}

/// Sum over slots of values [R, K, T, d] by weights [R, K, T, h].
pub(crate) fn mix(weights: &Tensor, v: &Tensor) -> Tensor {
    let w = weights.size();
    let v = v.view([w[0], w[1], w[2], w[3], -1]);
    (weights.unsqueeze(4) * v).sum_dim_intlist([1i64].as_slice(), false, Kind::Float).flatten(2, 3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::torch::Torch;
    use tch::{Device, nn};

    type EdgeAwareLayer = ccdiff_nets::compute::layers::social::EdgeAwareLayer<Torch>;
    const HEADS: i64 = 4;

    /// The M x M² form: all edges flattened as keys, a block mask per row.
    fn block_masked(layer: &EdgeAwareLayer, x: &Tensor, edges: &Tensor, graph: &[bool]) -> Tensor {
        let (m, d) = (x.size()[0], x.size()[1]);
        let memory = Tensor::cat(&[x.unsqueeze(0).expand([m, m, d], false), edges.shallow_clone()], 2);
        let memory = memory.view([m * m, -1]);
        let (h, e) = (HEADS, d / HEADS);
        let heads = |t: Tensor| t.view([-1, h, e]).transpose(0, 1);
        let q = heads(x.apply(&layer.norm).apply(&layer.query));
        let (k, v) = (heads(memory.apply(&layer.key.0)), heads(memory.apply(&layer.value.0)));
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
        let layer = EdgeAwareLayer::new(&vs.root(), 16, 8, HEADS, 32);
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
