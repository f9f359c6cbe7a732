//! Gradients through the loops over rows and through attention, for training.

use super::attention::{Mix, product_of, product_of_sum};
use super::rows::{self, at_levels, exp, sum};
use super::shape::PANEL;
use super::simd::{Vector, Work, at_level};

/// Gradients of attention.
#[derive(Debug)]
pub struct MixBack<'a> {
    /// What was mixed.
    pub of: Mix<'a>,
    /// Gradients by its rows, added to.
    pub of_rows: [&'a mut [f32]; 3],
    /// Gradients by its edges, written; empty without them.
    pub of_edges: [&'a mut [f32]; 2],
}

#[inline(always)]
fn add_scaled(to: &mut [f32], from: &[f32], by: f32) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from * by;
    }
}

impl MixBack<'_> {
    /// One head of one token of a row, whose numbers begin at `query`; `places` are those of its pairs' tokens and edges.
    #[inline(always)]
    fn head(
        &mut self,
        query: usize,
        head: usize,
        places: impl Iterator<Item = (usize, usize)> + Clone,
        gradient: &[f32],
        weights: &mut Vec<[f32; 2]>,
    ) {
        let (Mix { rows: [q, k, v], edges, .. }, scale) = (self.of, 1.0 / (head as f32).sqrt());
        let (q, gradient) = (&q[query..query + head], &gradient[query..query + head]);
        weights.clear();
        weights.extend(places.clone().map(|(at, edge)| match edges {
            Some([key, value]) => [
                product_of_sum(q, &k[at..at + head], &key[edge..edge + head]) * scale,
                product_of_sum(gradient, &v[at..at + head], &value[edge..edge + head]),
            ],
            None => [product_of(q, &k[at..at + head]) * scale, product_of(gradient, &v[at..at + head])],
        }));
        let most = weights.iter().fold(f32::NEG_INFINITY, |m, w| if w[0] > m { w[0] } else { m });
        let mut total = 0.0;
        for [w, _] in weights.iter_mut() {
            *w = exp(*w - most);
            total += *w;
        }
        let mut shared = 0.0;
        for [w, d] in weights.iter_mut() {
            *w /= total;
            shared += *w * *d;
        }
        let [of_q, of_k, of_v] = &mut self.of_rows;
        for ((at, edge), [w, d]) in places.zip(weights.iter()) {
            let of_score = w * (d - shared) * scale;
            add_scaled(&mut of_q[query..query + head], &k[at..at + head], of_score);
            add_scaled(&mut of_k[at..at + head], q, of_score);
            add_scaled(&mut of_v[at..at + head], gradient, *w);
            if let Some([key, _]) = edges {
                let [of_key, of_value] = &mut self.of_edges;
                add_scaled(&mut of_q[query..query + head], &key[edge..edge + head], of_score);
                add_scaled(&mut of_key[edge..edge + head], q, of_score);
                add_scaled(&mut of_value[edge..edge + head], gradient, *w);
            }
        }
    }
}

at_levels! {
    /// Gradients in front of a ReLU, in place of those behind it.
    fn relu_back<'a>(gradient: &'a mut [f32], made: &'a [f32]) {
        for (g, y) in gradient.iter_mut().zip(made) {
            *g = if *y > 0.0 { *g } else { 0.0 };
        }
    }

    /// Adds rows as wide as `out` to it.
    fn add_rows<'a>(rows: &'a [f32], out: &'a mut [f32]) {
        for row in rows.chunks_exact(out.len().max(1)) {
            for (o, x) in out.iter_mut().zip(row) {
                *o += x;
            }
        }
    }

    /// Gradients by rows x that were normed, in place of those by what they became; adds those of weight and bias.
    fn norm_back<'a>(
        x: &'a [f32],
        weight: &'a [f32],
        gradient: &'a mut [f32],
        of_weight: &'a mut [f32],
        of_bias: &'a mut [f32],
    ) {
        let (width, share) = (weight.len().max(1), 1.0 / weight.len() as f32);
        let mut normed = vec![0f32; width];
        for (x, g) in x.chunks_exact(width).zip(gradient.chunks_exact_mut(width)) {
            let mean = sum(x, |x| x) * share;
            let variance = sum(x, |x| (x - mean) * (x - mean)) * share;
            let scale = 1.0 / (variance + 1e-5).sqrt();
            for (n, x) in normed.iter_mut().zip(x) {
                *n = (x - mean) * scale;
            }
            for ((((g, n), w), dw), db) in
                g.iter_mut().zip(&normed).zip(weight).zip(&mut *of_weight).zip(&mut *of_bias)
            {
                *dw += *g * n;
                *db += *g;
                *g *= w;
            }
            let (shift, turn) = (sum(g, |g| g) * share, product_of(g, &normed) * share);
            for (g, n) in g.iter_mut().zip(&normed) {
                *g = scale * (*g - shift - n * turn);
            }
        }
    }

    /// Gradients by numbers whose softmax of scale · x went down columns, in place of those by the weights.
    fn softmax_columns_back<'a>(weights: &'a [f32], gradient: &'a mut [f32], wide: usize, scale: f32) {
        for from in (0..wide).step_by(PANEL) {
            let mut shared = [0f32; PANEL];
            for (w, g) in weights.chunks_exact(wide).zip(gradient.chunks_exact(wide)) {
                for ((s, w), g) in shared.iter_mut().zip(&w[from..from + PANEL]).zip(&g[from..from + PANEL]) {
                    *s += w * g;
                }
            }
            for (w, g) in weights.chunks_exact(wide).zip(gradient.chunks_exact_mut(wide)) {
                let (w, g) = (&w[from..from + PANEL], &mut g[from..from + PANEL]);
                for ((g, w), s) in g.iter_mut().zip(w).zip(&shared) {
                    *g = w * (*g - s) * scale;
                }
            }
        }
    }

    /// Gradients by a, by g and h alike, and by x of a + sigmoid(g + h) · (x - a), in their place.
    fn gate_back<'a>(gradient: &'a [f32], a: &'a mut [f32], g: &'a mut [f32], h: &'a [f32], x: &'a mut [f32]) {
        for ((((d, a), g), h), x) in gradient.iter().zip(a).zip(g).zip(h).zip(x) {
            let gate = 1.0 / (1.0 + exp(-(*g + h).clamp(-87.0, 87.0)));
            *g = d * (*x - *a) * gate * (1.0 - gate);
            *x = d * gate;
            *a = d - *x;
        }
    }

    /// Mish, in place.
    fn mish<'a>(x: &'a mut [f32]) {
        for x in x {
            *x = rows::mish(*x);
        }
    }

    /// Gradients in front of Mish of x, in place of those behind it.
    fn mish_back<'a>(gradient: &'a mut [f32], x: &'a [f32]) {
        for (g, x) in gradient.iter_mut().zip(x) {
            let e = exp(if *x > 20.0 { 20.0 } else { *x });
            let n = e * (e + 2.0);
            let gate = n / (n + 2.0);
            *g *= gate + x * (1.0 - gate * gate) * (e / (1.0 + e));
        }
    }

    /// Gradients through attention from those of what it gave [R, tokens, width].
    fn mix_back<'a>(gradient: &'a [f32], back: MixBack<'a>) {
        let mut back = back;
        let Mix { seen, tokens, heads, .. } = back.of;
        let (width, mut weights) = (back.of.width(), Vec::new());
        let head = width / heads;
        for (row, pairs) in seen.start.windows(2).enumerate() {
            for token in 0..tokens {
                for from in (0..width).step_by(head) {
                    let place = |row: usize| (row * tokens + token) * width + from;
                    let places = (pairs[0]..pairs[1]).map(|pair| (place(seen.other[pair]), place(pair)));
                    back.head(place(row), head, places, gradient, &mut weights);
                }
            }
        }
    }
}
