//! Attention over the rows in slots, as tensors.

use crate::batch::Neighbourhood;
use crate::config::ModelConfig;
use tch::{Kind, Tensor};

/// The row in each slot, and which slots may be seen.
#[derive(Debug)]
pub struct Slots {
    /// Row of each slot, flat [R · K], int64.
    pub(crate) rows: Tensor,
    /// Others that may be seen, or the row itself (slot 0) where no other may be, [R, K, T].
    pub(crate) others_or_self: Tensor,
    /// Others that may be seen and the row itself, [R, K, T].
    pub(crate) with_self: Tensor,
    /// Number of slots K.
    pub(crate) num_slots: i64,
    /// Tokens of histories and plans that are there, [R, 1, 1, T], where histories have a token per step.
    pub(crate) tokens: Option<Tensor>,
}

impl Slots {
    /// The edges of all tokens, normalised, [R, K, T, 8], or those of now alone; and the slots. History tokens have the edge of
    /// their step; future ones that of now, moved on at constant relative velocity.
    pub(crate) fn at_tokens(of: &Neighbourhood, config: &ModelConfig, moved: bool) -> (Tensor, Self) {
        let n = &config.normalisation;
        let (pos, vel, edges) = (&n.edge_position_std, n.edge_velocity_std, &of.edges);
        let mut all = edges.shallow_clone();
        if moved {
            let now = edges.narrow(2, edges.size()[2] - 1, 1);
            let times: Vec<f32> = config.future_token_times_s().iter().map(|t| *t as f32).collect();
            let tokens = times.len() as i64;
            let times = Tensor::from_slice(&times).view([1, 1, tokens, 1]).to_device(edges.device());
            let places = now.narrow(3, 0, 2) + now.narrow(3, 4, 2) * times;
            let rest = now.narrow(3, 2, 7).expand([-1, -1, tokens, -1], false);
            all = Tensor::cat(&[all, Tensor::cat(&[places, rest], 3)], 2);
        }
        let scale = [pos[0], pos[1], 1.0, 1.0, vel, vel, 1.0, 1.0].map(|s| (1.0 / s) as f32);
        let scaled = all.narrow(3, 0, 8) * Tensor::from_slice(&scale).to_device(edges.device());
        let others = all.select(3, 8).gt(0.5).logical_and(&of.is_edge.unsqueeze(2));
        let num_slots = others.size()[1];
        let rest = others.narrow(1, 1, num_slots - 1);
        let alone = others.any_dim(1, true).logical_not();
        let slots = Self {
            rows: of.rows.flatten(0, 1),
            with_self: Tensor::cat(&[alone.ones_like(), rest.shallow_clone()], 1),
            others_or_self: Tensor::cat(&[alone, rest], 1),
            num_slots,
            tokens: None,
        };
        (scaled, slots)
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
