//! The backend on the kernels of this crate: no torch, the same bits for every batch, number of threads and processor.

mod parts;

pub use crate::compute::numbers::{Array, Batch, Pairs};
pub use parts::{Filter, Groups, Norm, Place};

use crate::compute::backend::{Backend, KeyValue};
use crate::config::ModelConfig;
use crate::kernels::{self, Mix, Packed, Within};
use crate::sampling::plan_space::PlanSpace;
use std::ops::Range;

/// Layers on the kernels of this crate.
#[derive(Debug)]
pub struct Cpu;

impl Backend for Cpu {
    type Tensor = Array;
    type Linear = Packed;
    type Joint = [Packed; 2];
    type Norm = Norm;
    type Slots = Pairs;
    type Attention = Vec<f32>;
    type Path<'a> = Place<'a>;
    type Filter = Filter;
    type Groups = Groups;
    type Batch<'a> = Batch<'a>;

    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a> {
        p.sub(name)
    }

    fn linear(p: &Place<'_>, inputs: i64, outputs: i64) -> Packed {
        p.weights.layer(&p.name, inputs as usize, outputs as usize)
    }

    fn joint(p: &Place<'_>, token: i64, edge: i64, outputs: i64) -> [Packed; 2] {
        let [token, all, outputs] = [token, token + edge, outputs].map(|n| n as usize);
        [(0..token, true), (token..all, false)]
            .map(|(part, biased)| p.weights.columns(&p.name, (all, outputs), part, biased))
    }

    fn norm(p: &Place<'_>, width: i64) -> Norm {
        let numbers = |name| p.take(name, &[width]).unwrap_or(&[]).to_vec();
        Norm { weight: numbers("weight"), bias: numbers("bias") }
    }

    fn table(_: &Place<'_>, numbers: &[f32], width: i64) -> Array {
        Array::new(numbers.len() / width as usize, width as usize, numbers.to_vec())
    }

    fn numbers(x: &Array) -> Vec<f32> {
        x.numbers.clone()
    }

    fn layer(layer: &Packed, x: &Array, relu: bool) -> Array {
        let mut numbers = Vec::new();
        kernels::linear(&x.numbers, layer, relu, &mut numbers);
        Array::new(x.tokens, layer.columns, numbers)
    }

    fn apply_joint(layer: &[Packed; 2], tokens: &Array, edges: &Array) -> KeyValue<Self> {
        (Self::apply(&layer[0], tokens), Self::apply(&layer[1], edges))
    }

    fn normed(norm: &Norm, x: &Array, relu: bool) -> Array {
        let mut numbers = x.numbers.clone();
        kernels::norm(&mut numbers, &norm.weight, &norm.bias, relu);
        x.like(numbers)
    }

    fn sum_normed(norm: &Norm, x: &Array, mut y: Array) -> Array {
        kernels::add_norm(&mut y.numbers, &x.numbers, &norm.weight, &norm.bias);
        y
    }

    fn sum(mut x: Array, y: &Array) -> Array {
        if y.tokens == x.tokens {
            kernels::add_cycle(&mut x.numbers, &y.numbers);
            return x;
        }
        let row = x.row();
        for (x, y) in x.numbers.chunks_exact_mut(row).zip(y.numbers.chunks_exact(x.width.max(1))) {
            kernels::add_cycle(x, y);
        }
        x
    }

    fn cut(x: &Array, width: i64) -> Array {
        Array::new(x.row() / width as usize, width as usize, x.numbers.clone())
    }

    fn columns(x: &Array, from: i64, count: i64) -> Array {
        let (from, count) = (from as usize, count as usize);
        let rows = x.numbers.chunks_exact(x.width.max(1));
        Array::new(x.tokens, count, rows.flat_map(|row| &row[from..from + count]).copied().collect())
    }

    fn beside(x: &Array, y: &Array) -> Array {
        let rows = x.numbers.chunks_exact(x.width.max(1)).zip(y.numbers.chunks_exact(y.width.max(1)));
        Array::new(x.tokens, x.width + y.width, rows.flat_map(|(x, y)| [x, y]).flatten().copied().collect())
    }

    fn scaled(x: &Array, factor: &Array) -> Array {
        let rows = x.numbers.chunks_exact(x.row()).zip(&factor.numbers);
        x.like(rows.flat_map(|(row, f)| row.iter().map(move |v| v * f)).collect())
    }

    fn greatest(x: &Array) -> Array {
        let mut numbers = vec![0.0; x.rows() * x.width];
        for (row, out) in x.numbers.chunks_exact(x.row()).zip(numbers.chunks_exact_mut(x.width.max(1))) {
            kernels::most(row, out);
        }
        Array::new(1, x.width, numbers)
    }

    fn rows_of(table: &Array, steps: &[usize]) -> Array {
        let row = |step: &usize| &table.numbers[step * table.width..(step + 1) * table.width];
        Array::new(1, table.width, steps.iter().flat_map(row).copied().collect())
    }

    fn mish(x: &Array) -> Array {
        let mish = |v: &f32| {
            let v = f64::from(*v);
            (v * libm::tanh(libm::log1p(libm::exp(v)))) as f32
        };
        x.like(x.numbers.iter().map(mish).collect())
    }

    fn attend(q: &Array, (k, v): (&Array, &Array), heads: i64, _: Option<&Pairs>) -> Array {
        let of = Within { width: q.width, queries: q.tokens, keys: k.tokens, heads: heads as usize };
        let (mut out, mut weights) = (vec![0.0; q.numbers.len()], vec![0.0; of.weights()]);
        for (row, out) in of.rows([&q.numbers, &k.numbers, &v.numbers]).zip(out.chunks_exact_mut(q.row())) {
            of.forward(row, &mut weights, out);
        }
        q.like(out)
    }

    fn attend_across(
        q: &Array,
        (k, v): &KeyValue<Self>,
        edges: Option<&KeyValue<Self>>,
        slots: &Pairs,
        heads: i64,
    ) -> (Array, Vec<f32>) {
        let seen = if edges.is_some() { &slots.others } else { &slots.all };
        let (mut out, mut attention) = (vec![0.0; q.numbers.len()], vec![0.0; seen.other.len() * q.tokens]);
        let rows = [&*q.numbers, &*k.numbers, &*v.numbers];
        let edges = edges.map(|(k, v)| [&*k.numbers, &*v.numbers]);
        let mix = Mix { seen, tokens: q.tokens, heads: heads as usize, rows, edges };
        kernels::mix(mix, &mut out, &mut attention);
        (q.like(out), attention)
    }

    fn gated(a: &Array, g: &Array, h: &Array, mut own: Array) -> Array {
        kernels::gate(&mut own.numbers, &a.numbers, &g.numbers, &h.numbers);
        own
    }

    fn plan(space: &PlanSpace, noisy: &Array, speed: &Array) -> Array {
        let mut states = space.states(&space.actions(&noisy.numbers), &speed.numbers);
        space.standardised(&mut states);
        let rows = (noisy.numbers.len() / noisy.row()).max(1);
        Array::new(noisy.tokens, states.len() / rows / noisy.tokens, states)
    }

    fn stream(history: &Array, plan: Array, _: bool, steps: Array) -> Array {
        let (width, row) = (plan.width, plan.row());
        let mut numbers = Vec::with_capacity(plan.numbers.len() + history.numbers.len());
        for (own, plan) in history.numbers.chunks_exact(width).zip(plan.numbers.chunks_exact(row)) {
            numbers.extend(own.iter().zip(&steps.numbers).map(|(h, s)| h + s));
            for token in plan.chunks_exact(width) {
                numbers.extend(token.iter().zip(own).zip(&steps.numbers).map(|((p, h), s)| (p + h) + s));
            }
        }
        Array::new(1 + plan.tokens, width, numbers)
    }

    fn last(x: &Array, count: i64) -> Array {
        let count = count as usize;
        let from = (x.tokens - count) * x.width;
        let rows = x.numbers.chunks_exact(x.row());
        Array::new(count, x.width, rows.flat_map(|row| &row[from..]).copied().collect())
    }

    fn mean_attention(samples: &[Vec<f32>], slots: &Pairs, tokens: Range<usize>) -> Vec<f32> {
        slots.mean(samples, tokens)
    }

    fn plain<'a>(batch: &'a Batch<'_>) -> Batch<'a> {
        *batch
    }

    fn alone<'a>(batch: &Self::Batch<'a>) -> Self::Batch<'a> {
        Batch { alone: true, ..*batch }
    }

    fn placed(_: &Batch<'_>, x: Array) -> Array {
        x
    }

    fn edges(batch: &Batch<'_>, config: &ModelConfig, moved: bool) -> (Array, Pairs) {
        batch.edges(config, moved)
    }

    fn filter(p: &Place<'_>, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> Filter {
        let stored = p.take("weight", &[outputs, inputs, kernel]).unwrap_or_default();
        let bias = p.take("bias", &[outputs]).unwrap_or_default();
        let [inputs, outputs, kernel, stride] = [inputs, outputs, kernel, stride].map(|n| n as usize);
        let weights = Packed::new(&turned(stored, inputs, kernel), bias, outputs, inputs * kernel);
        Filter { weights, kernel, stride }
    }

    fn groups(p: &Place<'_>, groups: i64, width: i64) -> Groups {
        Groups { norm: Self::norm(p, width), groups: groups as usize }
    }

    fn filtered(filter: &Filter, x: &Array) -> Array {
        let (width, row, pad) = (x.width, x.row(), filter.kernel / 2);
        let padded = (x.tokens + 2 * pad) * width;
        let mut lines = vec![0.0; x.numbers.len() / row * padded];
        for (line, row) in lines.chunks_exact_mut(padded).zip(x.numbers.chunks_exact(row)) {
            line[pad * width..][..row.len()].copy_from_slice(row);
        }
        let tokens = (x.tokens + 2 * pad - filter.kernel) / filter.stride + 1;
        let (length, step) = (filter.kernel * width, filter.stride * width);
        let (mut windows, mut numbers) = (Vec::new(), Vec::new());
        for line in lines.chunks_exact(padded) {
            (0..tokens).for_each(|t| windows.extend_from_slice(&line[t * step..][..length]));
        }
        kernels::linear(&windows, &filter.weights, false, &mut numbers);
        Array::new(tokens, filter.weights.columns, numbers)
    }

    fn groups_mish(Groups { norm, groups }: &Groups, mut x: Array) -> Array {
        let row = x.row();
        kernels::groups_mish(&mut x.numbers, row, *groups, &norm.weight, &norm.bias);
        x
    }
}

/// Weights [outputs, inputs, places] as [outputs, places, inputs].
fn turned(weights: &[f32], inputs: usize, places: usize) -> Vec<f32> {
    let turn = |row: &[f32]| -> Vec<f32> {
        (0..row.len()).map(|at| row[at % inputs * places + at / inputs]).collect()
    };
    weights.chunks_exact(places * inputs).flat_map(turn).collect()
}
