//! Attention of arrays on the kernels.

use super::{Array, Cpu};
use crate::compute::backend::KeyValue;
use crate::kernels::{self, Checked, PANEL, Seen, Strided};

/// Attention over pairs, and the mean weight of the heads [pairs, tokens].
pub(super) fn mixed(
    q: &Array,
    (k, v): &KeyValue<Cpu>,
    edges: Option<&KeyValue<Cpu>>,
    seen: &Seen,
    heads: i64,
) -> (Array, Vec<f32>) {
    let (mut out, mut attention) = (vec![0.0; q.numbers.len()], vec![0.0; seen.other.len() * q.tokens]);
    let edges = edges.map(|(k, v)| (k.numbers.as_slice(), v.numbers.as_slice()));
    let (k, v) = (&k.numbers, &v.numbers);
    kernels::mix(
        Checked::now(),
        seen,
        q.tokens,
        heads as usize,
        &q.numbers,
        k,
        v,
        edges,
        &mut out,
        &mut attention,
    );
    (q.like(out), attention)
}

/// Softmax attention of the queries of a row to its keys.
pub(super) fn attended(q: &Array, k: &Array, v: &Array, heads: i64) -> Array {
    let (level, heads, d, queries, keys) = (Checked::now(), heads as usize, q.width, q.tokens, k.tokens);
    let head = d / heads;
    let wide = queries.next_multiple_of(PANEL);
    let head_wide = head.next_multiple_of(PANEL);
    let (mut turned, mut scores) = (vec![0.0; d * wide], vec![0.0; keys * wide]);
    // values of a head in columns of their own, where they are no whole panels
    let (mut values, mut mixed) = (vec![0.0; keys * head_wide], vec![0.0; queries * head_wide]);
    let mut out = vec![0.0; q.numbers.len()];
    let rows = q.numbers.chunks_exact(q.row()).zip(k.numbers.chunks_exact(k.row()));
    let rows = rows.zip(v.numbers.chunks_exact(v.row())).zip(out.chunks_exact_mut(q.row()));
    for (((q, k), v), out) in rows {
        kernels::transpose(level, q, d, &mut turned, wide);
        for h in 0..heads {
            let key = Strided { numbers: &k[h * head..], row: d, step: 1 };
            kernels::matmul(
                level,
                key,
                (keys, head, wide),
                (&turned[h * head * wide..], wide),
                &mut scores,
                wide,
            );
            kernels::softmax_columns(level, &mut scores, wide, 1.0 / (head as f32).sqrt());
            let weights = Strided { numbers: &scores, row: 1, step: wide };
            if head == head_wide {
                kernels::matmul(
                    level,
                    weights,
                    (queries, keys, head),
                    (&v[h * head..], d),
                    &mut out[h * head..],
                    d,
                );
                continue;
            }
            for (to, from) in values.chunks_exact_mut(head_wide).zip(v.chunks_exact(d)) {
                to[..head].copy_from_slice(&from[h * head..(h + 1) * head]);
            }
            let shape = (queries, keys, head_wide);
            kernels::matmul(level, weights, shape, (&values, head_wide), &mut mixed, head_wide);
            for (to, from) in out.chunks_exact_mut(d).zip(mixed.chunks_exact(head_wide)) {
                to[h * head..(h + 1) * head].copy_from_slice(&from[..head]);
            }
        }
    }
    q.like(out)
}
