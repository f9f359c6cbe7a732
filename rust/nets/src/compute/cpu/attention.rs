//! Attention of arrays on the kernels.

use super::{Array, Cpu};
use crate::compute::backend::KeyValue;
use crate::kernels::{self, How, Mix, Seen, Within};

/// Attention over pairs, and the mean weight of the heads [pairs, tokens].
pub(super) fn mixed(
    q: &Array,
    (k, v): &KeyValue<Cpu>,
    edges: Option<&KeyValue<Cpu>>,
    seen: &Seen,
    heads: i64,
) -> (Array, Vec<f32>) {
    let (mut out, mut attention) = (vec![0.0; q.numbers.len()], vec![0.0; seen.other.len() * q.tokens]);
    let rows = [&*q.numbers, &*k.numbers, &*v.numbers];
    let edges = edges.map(|(k, v)| [&*k.numbers, &*v.numbers]);
    kernels::mix(
        Mix { seen, tokens: q.tokens, heads: heads as usize, rows, edges },
        &mut out,
        &mut attention,
    );
    (q.like(out), attention)
}

/// Softmax attention of the queries of a row to its keys.
pub(super) fn attended(q: &Array, k: &Array, v: &Array, heads: i64) -> Array {
    let of = Within { width: q.width, queries: q.tokens, keys: k.tokens, heads: heads as usize };
    let (mut out, mut weights) = (vec![0.0; q.numbers.len()], vec![0.0; of.weights()]);
    for (row, out) in of.rows([&q.numbers, &k.numbers, &v.numbers]).zip(out.chunks_exact_mut(q.row())) {
        of.forward(row, &mut weights, out, How::Exact);
    }
    q.like(out)
}
