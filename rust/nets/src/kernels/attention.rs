//! Attention over the rows that a row sees.

use super::rows::{at_levels, exp, halves};
use super::shape::PANEL;
use super::simd::{Vector, Work, at_level};

/// Pairs of rows and the rows that they see; pairs of a row follow each other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Seen {
    /// First pair of each row, and one past the last of all, [R + 1].
    pub start: Vec<usize>,
    /// Row that is seen, [pairs].
    pub other: Vec<usize>,
    /// Its slot, [pairs].
    pub slot: Vec<usize>,
}

impl Seen {
    /// No rows yet.
    pub fn empty() -> Self {
        Self { start: vec![0], ..Self::default() }
    }

    /// Adds a row with the rows that it sees and their slots.
    pub fn push(&mut self, pairs: impl Iterator<Item = (usize, usize)>) {
        for (other, slot) in pairs {
            self.other.push(other);
            self.slot.push(slot);
        }
        self.start.push(self.other.len());
    }
}

/// Attention of every row's tokens over the same tokens of the rows that it sees.
#[derive(Debug, Clone, Copy)]
pub struct Mix<'a> {
    /// The seen pairs.
    pub seen: &'a Seen,
    /// Tokens of a row.
    pub tokens: usize,
    /// Heads, side by side in a token.
    pub heads: usize,
    /// Queries, keys and values [R, tokens, width].
    pub rows: [&'a [f32]; 3],
    /// What is added to the keys and the values of each pair [pairs, tokens, width].
    pub edges: Option<[&'a [f32]; 2]>,
}

impl Mix<'_> {
    /// Numbers of a token.
    pub(super) fn width(&self) -> usize {
        self.rows[0].len() / ((self.seen.start.len() - 1) * self.tokens).max(1)
    }

    /// The token of row `query`; `place(i)`: rows of the i-th pair's token and of its edge.
    #[inline(always)]
    fn run(
        &self,
        query: usize,
        count: usize,
        place: impl Fn(usize) -> (usize, usize),
        weights: &mut Vec<f32>,
        out: &mut [f32],
    ) {
        let ([queries, keys, values], heads) = (self.rows, self.heads);
        let (width, head) = (out.len(), out.len() / heads);
        let row = |of: usize, h: usize| of * width + h * head..of * width + (h + 1) * head;
        let scale = 1.0 / (head as f32).sqrt();
        weights.clear();
        weights.resize(count * heads, 0.0);
        for h in 0..heads {
            let q = &queries[row(query, h)];
            let mut most = f32::NEG_INFINITY;
            for i in 0..count {
                let (token, edge) = place(i);
                let key = &keys[row(token, h)];
                let score = match self.edges {
                    Some([added, _]) => product_of_sum(q, key, &added[row(edge, h)]),
                    None => product_of(q, key),
                } * scale;
                weights[i * heads + h] = score;
                most = if score > most { score } else { most };
            }
            let mut total = 0.0;
            for i in 0..count {
                let weight = exp(weights[i * heads + h] - most);
                weights[i * heads + h] = weight;
                total += weight;
            }
            let share = 1.0 / total;
            let out = &mut out[h * head..(h + 1) * head];
            out.fill(0.0);
            for i in 0..count {
                let (token, edge) = place(i);
                let weight = weights[i * heads + h] * share;
                weights[i * heads + h] = weight;
                let value = &values[row(token, h)];
                match self.edges {
                    Some([_, added]) => {
                        for ((o, v), e) in out.iter_mut().zip(value).zip(&added[row(edge, h)]) {
                            *o += weight * (v + e);
                        }
                    }
                    None => {
                        for (o, v) in out.iter_mut().zip(value) {
                            *o += weight * v;
                        }
                    }
                }
            }
        }
    }
}

#[inline(always)]
pub(super) fn product_of(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0f32; PANEL];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<PANEL>(), b.as_chunks::<PANEL>());
    for (a, b) in a.iter().zip(b) {
        for j in 0..PANEL {
            lanes[j] += a[j] * b[j];
        }
    }
    for ((lane, a), b) in lanes.iter_mut().zip(a_rest).zip(b_rest) {
        *lane += a * b;
    }
    halves(&mut lanes)
}

#[inline(always)]
pub(super) fn product_of_sum(a: &[f32], b: &[f32], c: &[f32]) -> f32 {
    let mut lanes = [0f32; PANEL];
    let ((a, a_rest), (b, b_rest), (c, c_rest)) =
        (a.as_chunks::<PANEL>(), b.as_chunks::<PANEL>(), c.as_chunks::<PANEL>());
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        for j in 0..PANEL {
            lanes[j] += a[j] * (b[j] + c[j]);
        }
    }
    for (((lane, a), b), c) in lanes.iter_mut().zip(a_rest).zip(b_rest).zip(c_rest) {
        *lane += a * (b + c);
    }
    halves(&mut lanes)
}

at_levels! {
    /// What is mixed [R, tokens, width], and the mean weight of the heads [pairs, tokens].
    fn mix<'a>(of: Mix<'a>, out: &'a mut [f32], attention: &'a mut [f32]) {
        let Mix { seen, tokens, heads, .. } = of;
        let mut weights = Vec::new();
        for (at, out) in out.chunks_exact_mut(of.width().max(1)).enumerate() {
            let (row, token) = (at / tokens, at % tokens);
            let (from, to) = (seen.start[row], seen.start[row + 1]);
            let place = |i: usize| (seen.other[from + i] * tokens + token, (from + i) * tokens + token);
            of.run(at, to - from, place, &mut weights, out);
            for (i, weights) in weights.chunks_exact(heads).enumerate() {
                attention[(from + i) * tokens + token] = weights.iter().sum::<f32>() / heads as f32;
            }
        }
    }
}
