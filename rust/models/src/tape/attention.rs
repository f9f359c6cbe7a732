//! Attention within rows and between them.

use super::Var;
use ccdiff_nets::kernels::{self, Checked, MixBack, PANEL, Seen, Strided};
use std::rc::Rc;

/// Whom rows see: others, or themselves where there are none; and themselves with the others.
#[derive(Debug)]
pub struct Pairs {
    pub(super) others: Rc<Seen>,
    pub(super) all: Rc<Seen>,
}

/// Softmax attention of the queries of a row to its keys; heads are as wide as whole panels.
pub(super) fn attended(q: &Var, k: &Var, v: &Var, heads: usize) -> Var {
    let shape = Shape { width: q.width, queries: q.tokens, keys: k.tokens, heads };
    let mut numbers = vec![0.0; q.numbers.len()];
    let mut weights = vec![0.0; q.rows() * heads * shape.keys * shape.wide()];
    shape.forward([&q.numbers, &k.numbers, &v.numbers], &mut weights, &mut numbers);
    let (q, k, v) = (q.clone(), k.clone(), v.clone());
    let learns = q.learns || k.learns || v.learns;
    Var::made(q.like(numbers), learns, move |_, gradient| {
        let mut of = [&q, &k, &v].map(|x| vec![0.0; x.numbers.len()]);
        shape.back([&q.numbers, &k.numbers, &v.numbers], &weights, &gradient, &mut of);
        let [of_q, of_k, of_v] = of;
        q.learn(of_q);
        k.learn(of_k);
        v.learn(of_v);
    })
}

/// Sizes of attention within rows.
#[derive(Debug, Clone, Copy)]
struct Shape {
    width: usize,
    queries: usize,
    keys: usize,
    heads: usize,
}

impl Shape {
    /// Queries in whole panels.
    fn wide(self) -> usize {
        self.queries.next_multiple_of(PANEL)
    }

    fn scale(self) -> f32 {
        1.0 / ((self.width / self.heads) as f32).sqrt()
    }

    /// Rows of queries, keys and values, one after the other.
    fn rows(self, [q, k, v]: [&[f32]; 3]) -> impl Iterator<Item = [&[f32]; 3]> {
        let [queries, keys] = [self.queries, self.keys].map(|tokens| tokens * self.width);
        let rows = q.chunks_exact(queries).zip(k.chunks_exact(keys)).zip(v.chunks_exact(keys));
        rows.map(|((q, k), v)| [q, k, v])
    }

    fn forward(self, numbers: [&[f32]; 3], weights: &mut [f32], out: &mut [f32]) {
        let (level, d, wide, head) = (Checked::now(), self.width, self.wide(), self.width / self.heads);
        let mut turned = vec![0.0; d * wide];
        let outs = out.chunks_exact_mut(self.queries * d);
        let weights = weights.chunks_exact_mut(self.heads * self.keys * wide);
        for (([q, k, v], weights), out) in self.rows(numbers).zip(weights).zip(outs) {
            kernels::transpose(level, q, d, &mut turned, wide);
            for (h, weights) in weights.chunks_exact_mut(self.keys * wide).enumerate() {
                let key = Strided { numbers: &k[h * head..], row: d, step: 1 };
                let of = (&turned[h * head * wide..], wide);
                kernels::trained_matmul(key, (self.keys, head, wide), of, weights, wide);
                kernels::softmax_columns(level, weights, wide, self.scale());
                let weights = Strided { numbers: weights, row: 1, step: wide };
                let shape = (self.queries, self.keys, head);
                kernels::trained_matmul(weights, shape, (&v[h * head..], d), &mut out[h * head..], d);
            }
        }
    }

    /// Gradients by queries, keys and values.
    fn back(self, numbers: [&[f32]; 3], weights: &[f32], gradient: &[f32], of: &mut [Vec<f32>; 3]) {
        let (level, d, wide, head) = (Checked::now(), self.width, self.wide(), self.width / self.heads);
        let (mut turned, mut scores) = (vec![0.0; d * wide], vec![0.0; self.keys * wide]);
        let [of_q, of_k, of_v] = of;
        let ofs = of_q.chunks_exact_mut(self.queries * d).zip(of_k.chunks_exact_mut(self.keys * d));
        let ofs = ofs.zip(of_v.chunks_exact_mut(self.keys * d));
        let weights = weights.chunks_exact(self.heads * self.keys * wide);
        let gradients = gradient.chunks_exact(self.queries * d);
        for ((([q, k, v], weights), gradient), ((of_q, of_k), of_v)) in
            self.rows(numbers).zip(weights).zip(gradients).zip(ofs)
        {
            kernels::transpose(level, gradient, d, &mut turned, wide);
            for (h, weights) in weights.chunks_exact(self.keys * wide).enumerate() {
                let at = h * head;
                let value = Strided { numbers: &v[at..], row: d, step: 1 };
                let of = (&turned[at * wide..], wide);
                kernels::trained_matmul(value, (self.keys, head, wide), of, &mut scores, wide);
                kernels::softmax_columns_back(level, weights, &mut scores, wide, self.scale());
                let shape = (self.keys, self.queries, head);
                let [by_key, of_scores] =
                    [weights, &scores].map(|numbers| Strided { numbers, row: wide, step: 1 });
                kernels::trained_matmul(by_key, shape, (&gradient[at..], d), &mut of_v[at..], d);
                kernels::trained_matmul(of_scores, shape, (&q[at..], d), &mut of_k[at..], d);
                let by_query = Strided { numbers: &scores, row: 1, step: wide };
                let shape = (self.queries, self.keys, head);
                kernels::trained_matmul(by_query, shape, (&k[at..], d), &mut of_q[at..], d);
            }
        }
    }
}

/// Attention over pairs, with what edges add to keys and values.
pub(super) fn mixed(
    q: &Var,
    (k, v): (&Var, &Var),
    edges: Option<(&Var, &Var)>,
    seen: &Rc<Seen>,
    heads: usize,
) -> (Var, Vec<f32>) {
    let (mut out, mut attention) = (vec![0.0; q.numbers.len()], vec![0.0; seen.other.len() * q.tokens]);
    let added = edges.map(|(k, v)| (k.numbers.as_slice(), v.numbers.as_slice()));
    let numbers = (&q.numbers, &k.numbers, &v.numbers);
    let tokens = q.tokens;
    kernels::mix(
        Checked::now(),
        seen,
        tokens,
        heads,
        numbers.0,
        numbers.1,
        numbers.2,
        added,
        &mut out,
        &mut attention,
    );
    let (rows, edges) = ([q, k, v].map(Var::clone), edges.map(|(k, v)| [k.clone(), v.clone()]));
    let seen = Rc::clone(seen);
    let made = Var::made(q.like(out), true, move |_, gradient| {
        let mut of_rows = rows.each_ref().map(|x| vec![0.0; x.numbers.len()]);
        let mut of_edges = [Vec::new(), Vec::new()];
        if let Some(edges) = &edges {
            of_edges = edges.each_ref().map(|x| vec![0.0; x.numbers.len()]);
        }
        let of = MixBack {
            rows: rows.each_ref().map(|x| x.numbers.as_slice()),
            edges: edges.as_ref().map(|edges| edges.each_ref().map(|x| x.numbers.as_slice())),
            of_rows: of_rows.each_mut().map(Vec::as_mut_slice),
            of_edges: of_edges.each_mut().map(Vec::as_mut_slice),
        };
        kernels::mix_back(Checked::now(), &seen, tokens, heads, &gradient, of);
        for (x, of) in rows.iter().zip(of_rows).chain(edges.iter().flatten().zip(of_edges)) {
            x.learn(of);
        }
    });
    (made, attention)
}
