//! Attention between the tokens of a row.

use super::product::{Strided, matmul};
use super::rows::{softmax_columns, transpose};
use super::shape::PANEL;

/// Sizes of attention within rows.
#[derive(Debug, Clone, Copy)]
pub struct Within {
    /// Numbers of a token.
    pub width: usize,
    /// Queries of a row.
    pub queries: usize,
    /// Keys of a row.
    pub keys: usize,
    /// Heads, side by side in a token.
    pub heads: usize,
}

impl Within {
    /// Weights of a head: keys by queries in whole panels.
    pub fn weights(self) -> usize {
        self.keys * self.wide()
    }

    fn wide(self) -> usize {
        self.queries.next_multiple_of(PANEL)
    }

    fn head(self) -> usize {
        self.width / self.heads
    }

    fn scale(self) -> f32 {
        1.0 / (self.head() as f32).sqrt()
    }

    /// Rows of queries, keys and values, one after the other.
    pub fn rows(self, [q, k, v]: [&[f32]; 3]) -> impl Iterator<Item = [&[f32]; 3]> {
        let [queries, keys] = [self.queries, self.keys].map(|tokens| (tokens * self.width).max(1));
        let rows = q.chunks_exact(queries).zip(k.chunks_exact(keys)).zip(v.chunks_exact(keys));
        rows.map(|((q, k), v)| [q, k, v])
    }

    /// What the queries of a row attend to; `weights` holds those of a head.
    pub fn forward(self, [q, k, v]: [&[f32]; 3], weights: &mut [f32], out: &mut [f32]) {
        let Self { width: d, queries, keys, heads } = self;
        let (wide, head) = (self.wide(), self.head());
        let head_wide = head.next_multiple_of(PANEL);
        let mut turned = vec![0.0; d * wide];
        transpose(q, d, &mut turned, wide);
        for h in 0..heads {
            let at = h * head;
            let key = Strided { numbers: &k[at..], row: d, step: 1 };
            matmul(key, (keys, head, wide), (&turned[at * wide..], wide), (weights, wide));
            softmax_columns(weights, wide, self.scale());
            let by = Strided { numbers: weights, row: 1, step: wide };
            if head == head_wide {
                matmul(by, (queries, keys, head), (&v[at..], d), (&mut out[at..], d));
                continue;
            }
            // values of a head in columns of their own, where they are no whole panels
            let (mut values, mut mixed) = (vec![0.0; keys * head_wide], vec![0.0; queries * head_wide]);
            for (to, from) in values.chunks_exact_mut(head_wide).zip(v.chunks_exact(d)) {
                to[..head].copy_from_slice(&from[at..at + head]);
            }
            matmul(by, (queries, keys, head_wide), (&values, head_wide), (&mut mixed, head_wide));
            for (to, from) in out.chunks_exact_mut(d).zip(mixed.chunks_exact(head_wide)) {
                to[at..at + head].copy_from_slice(&from[..head]);
            }
        }
    }
}
