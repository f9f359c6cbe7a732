//! Attention within rows and between them.

use super::Var;
use ccdiff_nets::kernels::{self, How, Mix, MixBack, Seen, Within};
use std::rc::Rc;

/// Softmax attention of the queries of a row to its keys; heads are as wide as whole panels.
pub(super) fn attended(q: &Var, k: &Var, v: &Var, heads: usize) -> Var {
    let of = Within { width: q.width, queries: q.tokens, keys: k.tokens, heads };
    let (part, per_row) = (heads * of.weights(), q.row());
    let (mut out, mut weights) = (vec![0.0; q.numbers.len()], vec![0.0; q.rows() * part]);
    let outs = out.chunks_exact_mut(per_row).zip(weights.chunks_exact_mut(part));
    for (row, (out, weights)) in of.rows([&q.numbers, &k.numbers, &v.numbers]).zip(outs) {
        of.forward(row, weights, out, How::Fused);
    }
    let (q, k, v) = (q.clone(), k.clone(), v.clone());
    let learns = q.learns || k.learns || v.learns;
    Var::made(q.like(out), learns, move |_, gradient| {
        let [mut of_q, mut of_k, mut of_v] = [&q, &k, &v].map(|x| vec![0.0; x.numbers.len()]);
        let ofs = of_q.chunks_exact_mut(per_row).zip(of_k.chunks_exact_mut(k.row()));
        let ofs = ofs.zip(of_v.chunks_exact_mut(v.row()));
        let given = weights.chunks_exact(part).zip(gradient.chunks_exact(per_row));
        let rows = of.rows([&q.numbers, &k.numbers, &v.numbers]).zip(given);
        for ((row, (weights, gradient)), ((of_q, of_k), of_v)) in rows.zip(ofs) {
            of.back(row, weights, gradient, [of_q, of_k, of_v]);
        }
        q.learn(of_q);
        k.learn(of_k);
        v.learn(of_v);
    })
}

/// Attention over pairs, with what edges add to keys and values.
pub(super) struct Mixed {
    pub(super) seen: Rc<Seen>,
    pub(super) heads: usize,
    pub(super) rows: [Var; 3],
    pub(super) edges: Option<[Var; 2]>,
}

impl Mixed {
    fn mix(&self) -> Mix<'_> {
        Mix {
            seen: &self.seen,
            tokens: self.rows[0].tokens,
            heads: self.heads,
            rows: self.rows.each_ref().map(|x| x.numbers.as_slice()),
            edges: self.edges.as_ref().map(|edges| edges.each_ref().map(|x| x.numbers.as_slice())),
        }
    }

    /// What is mixed, and the mean weight of the heads [pairs, tokens].
    pub(super) fn made(self) -> (Var, Vec<f32>) {
        let q = &self.rows[0];
        let mut out = vec![0.0; q.numbers.len()];
        let mut attention = vec![0.0; self.seen.other.len() * q.tokens];
        kernels::mix(self.mix(), &mut out, &mut attention);
        let made = Var::made(q.like(out), true, move |_, gradient| {
            let zeros = |x: &Var| vec![0.0; x.numbers.len()];
            let mut of_rows = self.rows.each_ref().map(zeros);
            let mut of_edges = self.edges.as_ref().map_or_else(Default::default, |e| e.each_ref().map(zeros));
            let back = MixBack {
                of: self.mix(),
                of_rows: of_rows.each_mut().map(Vec::as_mut_slice),
                of_edges: of_edges.each_mut().map(Vec::as_mut_slice),
            };
            kernels::mix_back(&gradient, back);
            let edges = self.edges.iter().flatten().zip(of_edges);
            self.rows.iter().zip(of_rows).chain(edges).for_each(|(x, of)| x.learn(of));
        });
        (made, attention)
    }
}
