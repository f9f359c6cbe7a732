//! The operations with their gradients, and the inputs of networks.

use super::attention::{Pairs, attended, mixed};
use super::layers::{Linear, Norm, Place};
use super::{Tape, Var, data};
use crate::batch::Batch;
use crate::config::ModelConfig;
use crate::layers::inputs;
use crate::torch::to_vec;
use ccdiff_nets::compute::backend::{Inputs, KeyValue, Ops};
use ccdiff_nets::compute::cpu::{Array, Cpu};
use ccdiff_nets::compute::layers::embed::ROUTE_SCALE_M;
use ccdiff_nets::inputs::features::EDGE_FEATURES;
use ccdiff_nets::inputs::segments::{NUM_SEGMENTS, SEGMENT_FEATURES};
use ccdiff_nets::inputs::tokens::{NEAR, NEAR_NUMBERS};
use ccdiff_nets::kernels::{self, Checked, Seen};
use ccdiff_nets::sampling::plan_space::PlanSpace;
use std::convert::Infallible;
use std::rc::Rc;

/// A convolution over tokens: its weights, its kernel and its stride.
#[derive(Debug)]
pub struct Filter(Linear, usize, usize);

/// Gradients of the tokens of every row in one.
fn over_tokens(gradient: &[f32], tokens: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; gradient.len() / tokens];
    for (row, out) in gradient.chunks_exact(tokens * width).zip(out.chunks_exact_mut(width)) {
        kernels::add_rows(Checked::now(), row, out);
    }
    out
}

/// Numbers whose places in x are listed, and zeros where the place is none.
fn gathered(x: &Var, tokens: usize, width: usize, places: Vec<u32>) -> Var {
    let numbers = places.iter().map(|at| x.numbers.get(*at as usize).copied().unwrap_or(0.0)).collect();
    let count = x.numbers.len();
    x.through(Array::new(tokens, width, numbers), move |_, gradient| {
        let mut of = vec![0.0; count];
        for (at, g) in places.iter().zip(gradient) {
            if let Some(of) = of.get_mut(*at as usize) {
                *of += g;
            }
        }
        of
    })
}

impl Ops for Tape {
    type Tensor = Var;
    type Linear = Linear;
    type Joint = [Linear; 2];
    type Norm = Norm;
    type Filter = Filter;
    type Groups = (Norm, usize);
    type Space = PlanSpace;
    type Slots = Pairs;
    type Mask = Infallible;
    type Attention = Vec<f32>;
    type Steps = Vec<usize>;
    type Path<'a> = Place<'a>;

    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a> {
        p.sub(name)
    }

    fn linear(p: &Place<'_>, inputs: i64, outputs: i64) -> Linear {
        Linear::new(p, inputs, outputs)
    }

    fn zero_linear(p: &Place<'_>, inputs: i64, outputs: i64) -> Linear {
        Linear::new(p, inputs, outputs)
    }

    fn joint(p: &Place<'_>, token: i64, edge: i64, outputs: i64) -> [Linear; 2] {
        let (token, all, outputs) = (token as usize, (token + edge) as usize, outputs as usize);
        [Linear::part(p, (all, 0, token), outputs, true), Linear::part(p, (all, token, all), outputs, false)]
    }

    fn norm(p: &Place<'_>, width: i64) -> Norm {
        Norm::new(p, width)
    }

    fn filter(p: &Place<'_>, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> Filter {
        Filter(Linear::new(p, inputs * kernel, outputs), kernel as usize, stride as usize)
    }

    fn groups(p: &Place<'_>, groups: i64, width: i64) -> (Norm, usize) {
        (Norm::new(p, width), groups as usize)
    }

    fn space(_: &Place<'_>, config: &ModelConfig) -> PlanSpace {
        PlanSpace::new(config)
    }

    fn table(_: &Place<'_>, numbers: &[f32], width: i64) -> Var {
        Var::data(1, width as usize, numbers.to_vec())
    }

    fn numbers(x: &Var) -> Vec<f32> {
        x.numbers.clone()
    }

    fn placed(_: &Var, numbers: Vec<f32>, tokens: usize, width: usize) -> Var {
        Var::data(tokens, width, numbers)
    }

    fn apply(layer: &Linear, x: &Var) -> Var {
        layer.apply(x, false)
    }

    fn apply_relu(layer: &Linear, x: &Var) -> Var {
        layer.apply(x, true)
    }

    fn apply_joint(layer: &[Linear; 2], tokens: &Var, edges: &Var) -> KeyValue<Self> {
        (layer[0].apply(tokens, false), layer[1].apply(edges, false))
    }

    fn normed(norm: &Norm, x: &Var) -> Var {
        norm.apply(x, false)
    }

    fn normed_relu(norm: &Norm, x: Var) -> Var {
        norm.apply(&x, true)
    }

    fn sum_normed(norm: &Norm, x: &Var, y: Var) -> Var {
        norm.of_sum(x, &y)
    }

    fn filtered(Filter(layer, kernel, stride): &Filter, x: &Var) -> Var {
        let pad = kernel / 2;
        let tokens = (x.tokens + 2 * pad - kernel) / stride + 1;
        let mut places = Vec::with_capacity(x.rows() * tokens * x.width * kernel);
        for (row, token) in (0..x.rows()).flat_map(|row| (0..tokens).map(move |token| (row, token))) {
            for (c, k) in (0..x.width).flat_map(|c| (0..*kernel).map(move |k| (c, k))) {
                let from = (token * stride + k).checked_sub(pad).filter(|from| *from < x.tokens);
                places.push(from.map_or(u32::MAX, |from| ((row * x.tokens + from) * x.width + c) as u32));
            }
        }
        layer.apply(&gathered(x, tokens, x.width * kernel, places), false)
    }

    fn groups_mish((norm, groups): &(Norm, usize), x: Var) -> Var {
        Self::mish(&norm.of_groups(&x, *groups))
    }

    fn sum(x: &Var, y: Var) -> Var {
        let (made, of_x) = (Cpu::sum(x, Array::clone(&y)), x.clone());
        Var::made(made, x.learns || y.learns, move |_, gradient| {
            of_x.learn(gradient.clone());
            y.learn(gradient);
        })
    }

    fn sum_table(x: Var, table: &Var) -> Var {
        let (made, table) = (Cpu::sum_table(Array::clone(&x), table), table.clone());
        Var::made(made, x.learns || table.learns, move |_, gradient| {
            if table.learns {
                let mut of = vec![0.0; table.numbers.len()];
                kernels::add_rows(Checked::now(), &gradient, &mut of);
                table.learn(of);
            }
            x.learn(gradient);
        })
    }

    fn sum_token(x: Var, y: &Var) -> Var {
        let (made, y) = (Cpu::sum_token(Array::clone(&x), y), y.clone());
        Var::made(made, x.learns || y.learns, move |_, gradient| {
            y.learn(over_tokens(&gradient, x.tokens, x.width));
            x.learn(gradient);
        })
    }

    fn cut(x: Var, width: i64) -> Var {
        x.shaped(x.row() / width as usize, width as usize)
    }

    fn columns(x: &Var, from: i64, count: i64) -> Var {
        let made = Cpu::columns(x, from, count);
        let (from, count, width) = (from as usize, count as usize, x.width);
        x.through(made, move |_, gradient| {
            let mut of = vec![0.0; gradient.len() / count * width];
            for (of, g) in of.chunks_exact_mut(width).zip(gradient.chunks_exact(count)) {
                of[from..from + count].copy_from_slice(g);
            }
            of
        })
    }

    fn beside(x: &Var, y: &Var) -> Var {
        let (made, m, x, y) = (Cpu::beside(x, y), x.width, x.clone(), y.clone());
        Var::made(made, x.learns || y.learns, move |made, gradient| {
            let rows = || gradient.chunks_exact(made.width);
            x.learn(rows().flat_map(|row| &row[..m]).copied().collect());
            y.learn(rows().flat_map(|row| &row[m..]).copied().collect());
        })
    }

    fn joined(x: &Var) -> Var {
        x.shaped(1, x.row())
    }

    fn scaled(x: &Var, factor: &Var) -> Var {
        let (row, factor) = (x.row(), factor.clone());
        let scale = move |numbers: &[f32]| -> Vec<f32> {
            let rows = numbers.chunks_exact(row).zip(&factor.numbers);
            rows.flat_map(|(row, f)| row.iter().map(move |v| v * f)).collect()
        };
        x.through(x.like(scale(&x.numbers)), move |_, gradient| scale(&gradient))
    }

    fn greatest(x: &Var) -> Var {
        let (row, width) = (x.row(), x.width);
        let mut places = Vec::with_capacity(x.rows() * width);
        for (at, row) in (0..).step_by(row).zip(x.numbers.chunks_exact(row)) {
            let (mut most, mut place) = (row[..width].to_vec(), vec![0u32; width]);
            for (token, numbers) in row.chunks_exact(width).enumerate() {
                for ((most, place), x) in most.iter_mut().zip(&mut place).zip(numbers) {
                    let above = *x > *most;
                    *most = if above { *x } else { *most };
                    *place = if above { token as u32 } else { *place };
                }
            }
            places.extend(place.iter().zip(0..).map(|(token, c)| at + token * width as u32 + c));
        }
        gathered(x, 1, width, places)
    }

    fn at_step(_: &Var, rows: usize, step: usize) -> Vec<usize> {
        vec![step; rows]
    }

    fn rows_of(table: &Var, steps: &Vec<usize>) -> Var {
        let numbers = steps.iter().flat_map(|s| &table.numbers[s * table.width..(s + 1) * table.width]);
        Var::data(1, table.width, numbers.copied().collect())
    }

    fn mish(x: &Var) -> Var {
        let (mut numbers, from) = (x.numbers.clone(), x.clone());
        kernels::mish(Checked::now(), &mut numbers);
        x.through(x.like(numbers), move |_, mut gradient| {
            kernels::mish_back(Checked::now(), &mut gradient, &from.numbers);
            gradient
        })
    }

    fn attend(q: &Var, (k, v): &KeyValue<Self>, heads: i64, _: Option<&Infallible>) -> Var {
        attended(q, k, v, heads as usize)
    }

    fn pool(q: &Var, elements: &Var, heads: i64) -> Var {
        // a head is a query of its own
        let (heads, width) = (heads as usize, q.width);
        attended(&q.shaped(heads, width / heads), elements, elements, 1).shaped(1, width)
    }

    fn attend_others(
        q: &Var,
        (k, v): &KeyValue<Self>,
        (k_edge, v_edge): &KeyValue<Self>,
        slots: &Pairs,
        heads: i64,
    ) -> (Var, Vec<f32>) {
        mixed(q, (k, v), Some((k_edge, v_edge)), &slots.others, heads as usize)
    }

    fn attend_all(q: &Var, (k, v): &KeyValue<Self>, slots: &Pairs, heads: i64) -> Var {
        mixed(q, (k, v), None, &slots.all, heads as usize).0
    }

    fn gated(a: &Var, g: &Var, h: &Var, own: Var) -> Var {
        let made = Cpu::gated(a, g, h, Array::clone(&own));
        let (a, g, h) = (a.clone(), g.clone(), h.clone());
        Var::made(made, true, move |_, gradient| {
            let [mut of_a, mut of_g, mut of_own] = [&a, &g, &own].map(|x| x.numbers.clone());
            kernels::gate_back(Checked::now(), &gradient, &mut of_a, &mut of_g, &h.numbers, &mut of_own);
            a.learn(of_a);
            h.learn(of_g.clone());
            g.learn(of_g);
            own.learn(of_own);
        })
    }

    /// Noisy knots depend on no weight.
    fn plan(space: &PlanSpace, noisy: &Var, speed: &Var) -> Var {
        Var::of(Cpu::plan(space, noisy, speed))
    }

    fn stream(history: &Var, plan: Var, carried: bool, steps: Var) -> Var {
        let (width, tokens, level) = (plan.width, plan.tokens, Checked::now());
        let mut numbers = Vec::with_capacity(plan.numbers.len() + history.numbers.len());
        for (own, plan) in history.numbers.chunks_exact(width).zip(plan.numbers.chunks_exact(plan.row())) {
            let from = numbers.len();
            numbers.extend_from_slice(own);
            numbers.extend_from_slice(plan);
            if carried {
                kernels::add_cycle(level, &mut numbers[from + width..], own);
            }
        }
        let row = (1 + tokens) * width;
        for (numbers, steps) in numbers.chunks_exact_mut(row).zip(steps.numbers.chunks_exact(width)) {
            kernels::add_cycle(level, numbers, steps);
        }
        let history = history.clone();
        Var::made(Array::new(1 + tokens, width, numbers), true, move |_, gradient| {
            let all = over_tokens(&gradient, 1 + tokens, width);
            let rows = || gradient.chunks_exact(row);
            plan.learn(rows().flat_map(|row| &row[width..]).copied().collect());
            let first = || rows().flat_map(|row| &row[..width]).copied().collect();
            history.learn(if carried { all.clone() } else { first() });
            steps.learn(all);
        })
    }

    fn last(x: &Var, count: i64) -> Var {
        let (made, row) = (Cpu::last(x, count), x.row());
        let from = row - made.row();
        x.through(made, move |_, gradient| {
            let mut of = vec![0.0; gradient.len() / (row - from) * row];
            for (of, g) in of.chunks_exact_mut(row).zip(gradient.chunks_exact(row - from)) {
                of[from..].copy_from_slice(g);
            }
            of
        })
    }
}

impl Inputs for Tape {
    type Batch<'a> = Batch;

    fn history(batch: &Batch, config: &ModelConfig) -> Var {
        data(&inputs::standardised_history(&batch.history, config), config.history_steps)
    }

    fn mask(_: &Batch, _: &ModelConfig) -> Option<Infallible> {
        None
    }

    fn route(batch: &Batch) -> Option<(Var, Var)> {
        let mut numbers = to_vec(batch.route.as_ref()?);
        let width = numbers.len() / batch.num_rows() as usize;
        let told = numbers.iter().step_by(width).copied().collect();
        for row in numbers.chunks_exact_mut(width) {
            row[1..].iter_mut().for_each(|place| *place /= ROUTE_SCALE_M as f32);
        }
        Some((Var::data(1, width, numbers), Var::data(1, 1, told)))
    }

    fn edges(batch: &Batch, config: &ModelConfig) -> (Var, Pairs) {
        seen(batch, config, 1 + config.num_knots())
    }

    fn edges_now(batch: &Batch, config: &ModelConfig) -> (Var, Pairs) {
        seen(batch, config, 1)
    }

    fn standard_speed(batch: &Batch, config: &ModelConfig) -> Var {
        let n = &config.normalisation;
        let (mean, std) = (n.trajectory_mean[2] as f32, n.trajectory_std[2] as f32);
        Var::data(1, 1, to_vec(&batch.speed_mps).into_iter().map(|v| (v - mean) / std).collect())
    }

    fn speed(batch: &Batch) -> Var {
        data(&batch.speed_mps, 1)
    }

    fn lines(batch: &Batch) -> Option<Var> {
        batch.lines.as_ref().map(|lines| Var::data(NUM_SEGMENTS, SEGMENT_FEATURES, to_vec(lines)))
    }

    fn tokens(batch: &Batch) -> (Var, Var, Vec<f32>) {
        let near = Var::data(NEAR, NEAR_NUMBERS, to_vec(&batch.tokens.near));
        (data(&batch.tokens.own, 1), near, batch.tokens.yaw_rate_radps.clone())
    }
}

/// Edges of those that are seen at so many tokens from now on, and who is seen.
fn seen(batch: &Batch, config: &ModelConfig, tokens: usize) -> (Var, Pairs) {
    let (edges, available) = inputs::at_tokens(&batch.edges, config);
    let is_edge = batch.is_edge.logical_and(&available.select(2, 0)).to_kind(tch::Kind::Float);
    let (edges, is_edge) = (to_vec(&edges), to_vec(&is_edge));
    let (rows, slots) = (batch.num_rows() as usize, batch.neighbours.size()[1] as usize);
    let mut neighbours = vec![0i64; rows * slots];
    batch.neighbours.to_device(tch::Device::Cpu).view([-1]).copy_data(&mut neighbours, rows * slots);
    let per_slot = edges.len() / (rows * slots);
    let (mut others, mut all, mut numbers) = (Seen::empty(), Seen::empty(), Vec::new());
    for row in 0..rows {
        let pair = |slot: usize| (neighbours[row * slots + slot] as usize, slot);
        let found: Vec<usize> = (1..slots).filter(|slot| is_edge[row * slots + slot] > 0.5).collect();
        all.push(std::iter::once(0).chain(found.iter().copied()).map(pair));
        // alone: its own slot
        let of = if found.is_empty() { vec![0] } else { found };
        for slot in &of {
            numbers
                .extend_from_slice(&edges[(row * slots + slot) * per_slot..][..tokens * (EDGE_FEATURES - 1)]);
        }
        others.push(of.into_iter().map(pair));
    }
    (Var::data(tokens, EDGE_FEATURES - 1, numbers), Pairs { others: Rc::new(others), all: Rc::new(all) })
}
