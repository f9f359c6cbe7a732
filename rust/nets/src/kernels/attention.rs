//! Attention over the rows that a row sees.

use super::rows::{at_levels, exp, halves};
use super::shape::PANEL;
use super::simd::{Checked, Work, at_level};

/// Whom the rows see: pairs of a row follow each other.
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
    /// Nobody yet.
    pub fn empty() -> Self {
        Self { start: vec![0], ..Self::default() }
    }

    /// Whom the next row sees: rows and slots.
    pub fn push(&mut self, pairs: impl Iterator<Item = (usize, usize)>) {
        for (other, slot) in pairs {
            self.other.push(other);
            self.slot.push(slot);
        }
        self.start.push(self.other.len());
    }
}

/// Attention of a token, numbers of `heads` side by side, over the keys and values of pairs; `edges` holds what is added to them.
struct Mix<'a> {
    heads: usize,
    query: &'a [f32],
    key: &'a [f32],
    value: &'a [f32],
    edges: Option<(&'a [f32], &'a [f32])>,
}

impl Mix<'_> {
    /// `place(i)`: rows of the i-th pair's token and of its edge.
    #[inline(always)]
    fn run(
        &self,
        query: usize,
        count: usize,
        place: impl Fn(usize) -> (usize, usize),
        weights: &mut Vec<f32>,
        out: &mut [f32],
    ) {
        let (width, head) = (out.len(), out.len() / self.heads);
        let row = |of: usize, h: usize| of * width + h * head..of * width + (h + 1) * head;
        let scale = 1.0 / (head as f32).sqrt();
        weights.clear();
        weights.resize(count * self.heads, 0.0);
        for h in 0..self.heads {
            let q = &self.query[row(query, h)];
            let mut most = f32::NEG_INFINITY;
            for i in 0..count {
                let (token, edge) = place(i);
                let key = &self.key[row(token, h)];
                let score = match self.edges {
                    Some((added, _)) => product_of_sum(q, key, &added[row(edge, h)]),
                    None => product_of(q, key),
                } * scale;
                weights[i * self.heads + h] = score;
                most = if score > most { score } else { most };
            }
            let mut total = 0.0;
            for i in 0..count {
                let weight = exp(weights[i * self.heads + h] - most);
                weights[i * self.heads + h] = weight;
                total += weight;
            }
            let share = 1.0 / total;
            let out = &mut out[h * head..(h + 1) * head];
            out.fill(0.0);
            for i in 0..count {
                let (token, edge) = place(i);
                let weight = weights[i * self.heads + h] * share;
                weights[i * self.heads + h] = weight;
                let value = &self.value[row(token, h)];
                match self.edges {
                    Some((_, added)) => {
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
    /// Attention of every row's `tokens` over the same tokens of the rows that it sees: queries, keys and values [R, tokens, width],
    /// what is added to keys and values of each pair [pairs, tokens, width], to [R, tokens, width] and the mean weight of the
    /// heads [pairs, tokens].
    fn mix<'a>(
        seen: &'a Seen,
        tokens: usize,
        heads: usize,
        query: &'a [f32],
        key: &'a [f32],
        value: &'a [f32],
        edges: Option<(&'a [f32], &'a [f32])>,
        out: &'a mut [f32],
        attention: &'a mut [f32],
    ) {
        let rows = seen.start.len().saturating_sub(1);
        let width = out.len() / (rows * tokens).max(1);
        let mixed = Mix { heads, query, key, value, edges };
        let mut weights = Vec::new();
        for (at, out) in out.chunks_exact_mut(width.max(1)).enumerate() {
            let (row, token) = (at / tokens, at % tokens);
            let (from, to) = (seen.start[row], seen.start[row + 1]);
            let place = |i: usize| (seen.other[from + i] * tokens + token, (from + i) * tokens + token);
            mixed.run(at, to - from, place, &mut weights, out);
            for (i, weights) in weights.chunks_exact(heads).enumerate() {
                attention[(from + i) * tokens + token] = weights.iter().sum::<f32>() / heads as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::tests::{at_all, close, numbers};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn attention_over_those_that_are_seen(rows in 1usize..5, tokens in 1usize..4, head in 1usize..20, heads in 1usize..4, joined: bool) {
            let width = heads * head;
            let mut seen = Seen { start: vec![0], ..Seen::default() };
            for row in 0..rows {
                for other in (0..rows).filter(|o| *o == row || (o + row) % 2 == 1) {
                    seen.other.push(other);
                    seen.slot.push(0);
                }
                seen.start.push(seen.other.len());
            }
            let pairs = seen.other.len();
            let [q, k, v] = [11, 12, 13].map(|s| numbers(s, rows * tokens * width));
            let [ke, ve] = [14, 15].map(|s| numbers(s, pairs * tokens * width));
            let edges = joined.then_some((ke.as_slice(), ve.as_slice()));
            let got = at_all(|level| {
                let (mut out, mut attention) = (vec![0.0; q.len()], vec![0.0; pairs * tokens]);
                mix(level, &seen, tokens, heads, &q, &k, &v, edges, &mut out, &mut attention);
                out.extend(attention);
                out
            });
            let (mut want, mut mean) = (vec![0.0; q.len()], vec![0.0; pairs * tokens]);
            let added = |of: Option<&[f32]>, at: usize| of.map_or(0.0, |e| f64::from(e[at]));
            for (row, token, h) in (0..rows).flat_map(|r| (0..tokens).flat_map(move |t| (0..heads).map(move |h| (r, t, h)))) {
                let of_pairs: Vec<usize> = (seen.start[row]..seen.start[row + 1]).collect();
                let place = |row: usize, c: usize| (row * tokens + token) * width + h * head + c;
                let scores: Vec<f64> = of_pairs.iter().map(|p| (0..head).map(|c| {
                    let key = f64::from(k[place(seen.other[*p], c)]) + added(edges.map(|e| e.0), place(*p, c));
                    f64::from(q[place(row, c)]) * key
                }).sum::<f64>() / (head as f64).sqrt()).map(libm::exp).collect();
                let total: f64 = scores.iter().sum();
                for (p, score) in of_pairs.iter().zip(&scores) {
                    mean[p * tokens + token] += score / total / heads as f64;
                    for c in 0..head {
                        let value = f64::from(v[place(seen.other[*p], c)]) + added(edges.map(|e| e.1), place(*p, c));
                        want[place(row, c)] += score / total * value;
                    }
                }
            }
            want.extend(mean);
            close(&got, &want);
        }
    }
}
