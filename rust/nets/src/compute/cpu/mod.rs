//! The backend on the kernels of this crate: no torch, the same bits for every batch, number of threads and processor.

mod attention;
mod parts;

pub use parts::{Array, Batch, Filter, Groups, Norm, Pairs, Place};

use crate::compute::backend::{Inputs, KeyValue, Ops};
use crate::compute::layers::embed::ROUTE_SCALE_M;
use crate::config::ModelConfig;
use crate::inputs::features::{EDGE_FEATURES, HISTORY_FEATURES};
use crate::inputs::segments::{NUM_SEGMENTS, SEGMENT_FEATURES};
use crate::inputs::tokens::{NEAR, NEAR_NUMBERS};
use crate::kernels::{self, How, Packed, Seen};
use crate::sampling::plan_space::PlanSpace;
use attention::{attended, mixed};
use parts::packed;
use std::convert::Infallible;
use std::ops::Range;
use std::rc::Rc;

/// Layers on the kernels of this crate.
#[derive(Debug)]
pub struct Cpu;

impl Ops for Cpu {
    type Tensor = Array;
    type Linear = Packed;
    type Joint = [Packed; 2];
    type Norm = Norm;
    type Filter = Filter;
    type Groups = Groups;
    type Slots = Pairs;
    type Mask = Infallible;
    type Attention = Vec<f32>;
    type Path<'a> = Place<'a>;

    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a> {
        let dot = if p.name.is_empty() { "" } else { "." };
        Place { weights: p.weights, name: format!("{}{dot}{name}", p.name) }
    }

    fn linear(p: &Place<'_>, inputs: i64, outputs: i64) -> Packed {
        packed(p.take("weight", &[outputs, inputs]), p.take("bias", &[outputs]), outputs, inputs, 0, inputs)
    }

    fn joint(p: &Place<'_>, token: i64, edge: i64, outputs: i64) -> [Packed; 2] {
        let all = token + edge;
        let (rows, bias) = (p.take("weight", &[outputs, all]), p.take("bias", &[outputs]));
        [packed(rows, bias, outputs, all, 0, token), packed(rows, None, outputs, all, token, all)]
    }

    fn norm(p: &Place<'_>, width: i64) -> Norm {
        let numbers = |name| p.take(name, &[width]).unwrap_or(&[]).to_vec();
        Norm { weight: numbers("weight"), bias: numbers("bias") }
    }

    fn filter(p: &Place<'_>, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> Filter {
        let stored = p.take("weight", &[outputs, inputs, kernel]);
        let turned = stored.map(|w| turned(w, inputs as usize, kernel as usize));
        let all = inputs * kernel;
        let weights = packed(turned.as_deref(), p.take("bias", &[outputs]), outputs, all, 0, all);
        Filter { weights, kernel: kernel as usize, stride: stride as usize }
    }

    fn groups(p: &Place<'_>, groups: i64, width: i64) -> Groups {
        Groups { norm: Self::norm(p, width), groups: groups as usize }
    }

    fn table(_: &Place<'_>, numbers: &[f32], width: i64) -> Array {
        Array::new(numbers.len() / width as usize, width as usize, numbers.to_vec())
    }

    fn numbers(x: &Array) -> Vec<f32> {
        x.numbers.clone()
    }

    fn layer(layer: &Packed, x: &Array, relu: bool) -> Array {
        let mut numbers = Vec::new();
        kernels::linear(&x.numbers, layer, relu, How::Exact, &mut numbers);
        Array::new(x.tokens, layer.columns, numbers)
    }

    fn apply_joint(layer: &[Packed; 2], tokens: &Array, edges: &Array) -> KeyValue<Self> {
        (Self::apply(&layer[0], tokens), Self::apply(&layer[1], edges))
    }

    fn normed(norm: &Norm, x: &Array) -> Array {
        let mut numbers = x.numbers.clone();
        kernels::norm(&mut numbers, &norm.weight, &norm.bias, false);
        x.like(numbers)
    }

    fn normed_relu(norm: &Norm, mut x: Array) -> Array {
        kernels::norm(&mut x.numbers, &norm.weight, &norm.bias, true);
        x
    }

    fn sum_normed(norm: &Norm, x: &Array, mut y: Array) -> Array {
        kernels::add_norm(&mut y.numbers, &x.numbers, &norm.weight, &norm.bias);
        y
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
        kernels::linear(&windows, &filter.weights, false, How::Exact, &mut numbers);
        Array::new(tokens, filter.weights.columns, numbers)
    }

    fn groups_mish(Groups { norm, groups }: &Groups, mut x: Array) -> Array {
        let row = x.row();
        kernels::groups_mish(&mut x.numbers, row, *groups, &norm.weight, &norm.bias);
        x
    }

    fn sum(x: &Array, mut y: Array) -> Array {
        kernels::add(&mut y.numbers, &x.numbers);
        y
    }

    fn sum_shared(mut x: Array, y: &Array) -> Array {
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

    fn attend(q: &Array, (k, v): &KeyValue<Self>, heads: i64, _: Option<&Infallible>) -> Array {
        attended(q, k, v, heads)
    }

    fn pool(q: &Array, elements: &Array, heads: i64) -> Array {
        // a head is a query of its own
        let heads = heads as usize;
        let queries = Array::new(heads, q.width / heads.max(1), q.numbers.clone());
        q.like(attended(&queries, elements, elements, 1).numbers)
    }

    fn attend_others(
        q: &Array,
        kv: &KeyValue<Self>,
        edges: &KeyValue<Self>,
        slots: &Pairs,
        heads: i64,
    ) -> (Array, Vec<f32>) {
        mixed(q, kv, Some(edges), &slots.others, heads)
    }

    fn attend_all(q: &Array, kv: &KeyValue<Self>, slots: &Pairs, heads: i64) -> Array {
        mixed(q, kv, None, &slots.all, heads).0
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
}

impl Inputs for Cpu {
    type Batch<'a> = Batch<'a>;

    fn alone<'a>(batch: &Self::Batch<'a>) -> Self::Batch<'a> {
        Batch { alone: true, ..*batch }
    }

    fn placed(_: &Batch<'_>, numbers: Vec<f32>, tokens: usize, width: usize) -> Array {
        Array::new(tokens, width, numbers)
    }

    fn history(batch: &Batch<'_>, config: &ModelConfig) -> Array {
        let n = &config.normalisation;
        let (mean, std) = (n.history_mean.map(|v| v as f32), n.history_std.map(|v| v as f32));
        let mut numbers = batch.numbers(|s| &s.history);
        for x in numbers.as_chunks_mut::<HISTORY_FEATURES>().0 {
            for (at, j) in [(0, 0), (1, 1), (4, 2), (5, 3), (6, 4)] {
                x[at] = (x[at] - mean[j]) / std[j];
            }
            let available = x[7];
            for v in x {
                *v *= available;
            }
        }
        Array::new(config.history_steps, HISTORY_FEATURES, numbers)
    }

    fn mask(_: &Batch<'_>, _: &ModelConfig) -> Option<Infallible> {
        None
    }

    fn route(batch: &Batch<'_>) -> Option<(Array, Array)> {
        let mut numbers = batch.numbers(|s| &s.route);
        let width = numbers.len().checked_div(batch.num_rows()).filter(|width| *width > 0)?;
        let told = numbers.iter().step_by(width).copied().collect();
        for row in numbers.chunks_exact_mut(width) {
            for place in &mut row[1..] {
                *place /= ROUTE_SCALE_M as f32;
            }
        }
        Some((Array::new(1, width, numbers), Array::new(1, 1, told)))
    }

    fn edges(batch: &Batch<'_>, config: &ModelConfig) -> (Array, Pairs) {
        let future = config.future_token_times_s().into_iter().map(|t| t as f32);
        edges_at(batch, config, &std::iter::once(0.0).chain(future).collect::<Vec<_>>())
    }

    fn edges_now(batch: &Batch<'_>, config: &ModelConfig) -> (Array, Pairs) {
        edges_at(batch, config, &[0.0])
    }

    fn standard_speed(batch: &Batch<'_>, config: &ModelConfig) -> Array {
        let n = &config.normalisation;
        let (mean, std) = (n.trajectory_mean[2] as f32, n.trajectory_std[2] as f32);
        let speeds = batch.numbers(|s| &s.speed_mps);
        Array::new(1, 1, speeds.into_iter().map(|v| (v - mean) / std).collect())
    }

    fn speed(batch: &Batch<'_>) -> Array {
        Array::new(1, 1, batch.numbers(|s| &s.speed_mps))
    }

    fn lines(batch: &Batch<'_>) -> Option<Array> {
        let numbers = batch.numbers(|s| &s.segments);
        (!numbers.is_empty()).then(|| Array::new(NUM_SEGMENTS, SEGMENT_FEATURES, numbers))
    }

    fn tokens(batch: &Batch<'_>) -> (Array, Array, Vec<f32>) {
        let own = batch.numbers(|s| &s.tokens.own);
        let own = Array::new(1, own.len() / batch.num_rows().max(1), own);
        let near = Array::new(NEAR, NEAR_NUMBERS, batch.numbers(|s| &s.tokens.near));
        (own, near, batch.numbers(|s| &s.tokens.yaw_rate_radps))
    }
}

/// Weights [outputs, inputs, places] as [outputs, places, inputs].
fn turned(weights: &[f32], inputs: usize, places: usize) -> Vec<f32> {
    let turn = |row: &[f32]| -> Vec<f32> {
        (0..row.len()).map(|at| row[at % inputs * places + at / inputs]).collect()
    };
    weights.chunks_exact(places * inputs).flat_map(turn).collect()
}

/// Edges at times from now on, and who is seen.
fn edges_at(batch: &Batch<'_>, config: &ModelConfig, times: &[f32]) -> (Array, Pairs) {
    let n = &config.normalisation;
    let (pos, vel) = (&n.edge_position_std, n.edge_velocity_std);
    let scale = [pos[0], pos[1], 1.0, 1.0, vel, vel, 1.0, 1.0].map(|s| (1.0 / s) as f32);
    let (mut others_of, mut all_of, mut numbers) = (Seen::empty(), Seen::empty(), Vec::new());
    let mut offset = 0;
    for scene in batch.scenes {
        let k = scene.num_slots;
        for row in 0..scene.agents.len() {
            let edge = |slot: usize| &scene.edges[(row * k + slot) * EDGE_FEATURES..][..EDGE_FEATURES];
            let sees = |slot: &usize| !batch.alone && scene.is_edge[row * k + slot] && edge(*slot)[8] > 0.5;
            let others: Vec<usize> = (1..k).filter(sees).collect();
            let other = |slot: usize| offset + scene.neighbours[row * k + slot];
            all_of.push(std::iter::once(0).chain(others.iter().copied()).map(|s| (other(s), s)));
            // alone: its own slot
            let of = if others.is_empty() { vec![0] } else { others };
            others_of.push(of.iter().map(|s| (other(*s), *s)));
            for x in of.into_iter().map(edge) {
                for time in times {
                    numbers.extend([(x[0] + x[4] * time) * scale[0], (x[1] + x[5] * time) * scale[1]]);
                    numbers.extend((2..8).map(|c| x[c] * scale[c]));
                }
            }
        }
        offset += scene.agents.len();
    }
    let slots = batch.scenes.iter().map(|s| s.num_slots).max().unwrap_or(1);
    let pairs = Pairs { others: Rc::new(others_of), all: Rc::new(all_of), slots };
    (Array::new(times.len(), EDGE_FEATURES - 1, numbers), pairs)
}
