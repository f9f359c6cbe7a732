//! Attention between the tokens of a row.

use super::back::softmax_columns_back;
use super::product::{Strided, matmul};
use super::rows::{softmax_columns, transpose};
use super::shape::PANEL;
use super::tile::How;

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

    /// What the queries of a row attend to. The weights of each head stay where there is room for all, else those of the last.
    pub fn forward(self, [q, k, v]: [&[f32]; 3], weights: &mut [f32], out: &mut [f32], how: How) {
        let Self { width: d, queries, keys, heads } = self;
        let (wide, head, one) = (self.wide(), self.head(), self.weights());
        let head_wide = head.next_multiple_of(PANEL);
        let mut turned = vec![0.0; d * wide];
        transpose(q, d, &mut turned, wide);
        for h in 0..heads {
            let (at, from) = (h * head, h * one % weights.len());
            let weights = &mut weights[from..from + one];
            let key = Strided { numbers: &k[at..], row: d, step: 1 };
            matmul(key, (keys, head, wide), (&turned[at * wide..], wide), (weights, wide), how);
            softmax_columns(weights, wide, self.scale());
            let by = Strided { numbers: weights, row: 1, step: wide };
            if head == head_wide {
                matmul(by, (queries, keys, head), (&v[at..], d), (&mut out[at..], d), how);
                continue;
            }
            // values of a head in columns of their own, where they are no whole panels
            let (mut values, mut mixed) = (vec![0.0; keys * head_wide], vec![0.0; queries * head_wide]);
            for (to, from) in values.chunks_exact_mut(head_wide).zip(v.chunks_exact(d)) {
                to[..head].copy_from_slice(&from[at..at + head]);
            }
            matmul(by, (queries, keys, head_wide), (&values, head_wide), (&mut mixed, head_wide), how);
            for (to, from) in out.chunks_exact_mut(d).zip(mixed.chunks_exact(head_wide)) {
                to[at..at + head].copy_from_slice(&from[..head]);
            }
        }
    }

    /// Gradients by queries, keys and values of a row from those of what it attended to; heads are as wide as whole panels.
    pub fn back(self, [q, k, v]: [&[f32]; 3], weights: &[f32], gradient: &[f32], of: [&mut [f32]; 3]) {
        let Self { width: d, queries, keys, .. } = self;
        let (wide, head, how, [of_q, of_k, of_v]) = (self.wide(), self.head(), How::Fused, of);
        let (mut turned, mut scores) = (vec![0.0; d * wide], vec![0.0; self.weights()]);
        transpose(gradient, d, &mut turned, wide);
        for (h, weights) in weights.chunks_exact(self.weights()).enumerate() {
            let at = h * head;
            let value = Strided { numbers: &v[at..], row: d, step: 1 };
            matmul(value, (keys, head, wide), (&turned[at * wide..], wide), (&mut scores, wide), how);
            softmax_columns_back(weights, &mut scores, wide, self.scale());
            let by_key = |numbers| Strided { numbers, row: wide, step: 1 };
            matmul(by_key(weights), (keys, queries, head), (&gradient[at..], d), (&mut of_v[at..], d), how);
            matmul(by_key(&scores), (keys, queries, head), (&q[at..], d), (&mut of_k[at..], d), how);
            let by_query = Strided { numbers: &scores, row: 1, step: wide };
            matmul(by_query, (queries, keys, head), (&k[at..], d), (&mut of_q[at..], d), how);
        }
    }
}
