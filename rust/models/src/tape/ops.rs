//! The operations with their gradients, and the inputs of networks.

use super::attention::{Mixed, attended};
use super::layers::{Linear, Norm, Place};
use super::{Tape, Var};
use crate::batch::Batch;
use crate::config::ModelConfig;
use ccdiff_nets::compute::backend::{Inputs, KeyValue, Ops};
use ccdiff_nets::compute::cpu::Cpu;
use ccdiff_nets::compute::numbers::{self, Array, Pairs};
use ccdiff_nets::kernels;
use ccdiff_nets::sampling::plan_space::PlanSpace;
use std::rc::Rc;

/// Gradients of the tokens of every row in one.
fn over_tokens(gradient: &[f32], tokens: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; gradient.len() / tokens];
    for (row, out) in gradient.chunks_exact(tokens * width).zip(out.chunks_exact_mut(width)) {
        kernels::add_rows(row, out);
    }
    out
}

impl Ops for Tape {
    type Tensor = Var;
    type Linear = Linear;
    type Joint = [Linear; 2];
    type Norm = Norm;
    type Slots = Pairs;
    type Attention = Vec<f32>;
    type Path<'a> = Place<'a>;

    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a> {
        p.sub(name)
    }

    fn linear(p: &Place<'_>, inputs: i64, outputs: i64) -> Linear {
        Linear::new(p, inputs, outputs)
    }

    fn joint(p: &Place<'_>, token: i64, edge: i64, outputs: i64) -> [Linear; 2] {
        let (token, all, outputs) = (token as usize, (token + edge) as usize, outputs as usize);
        [Linear::part(p, (all, 0, token), outputs, true), Linear::part(p, (all, token, all), outputs, false)]
    }

    fn norm(p: &Place<'_>, width: i64) -> Norm {
        Norm::new(p, width)
    }

    fn table(_: &Place<'_>, numbers: &[f32], width: i64) -> Var {
        Var::of(Array::new(numbers.len() / width as usize, width as usize, numbers.to_vec()))
    }

    fn numbers(x: &Var) -> Vec<f32> {
        x.numbers.clone()
    }

    fn layer(layer: &Linear, x: &Var, relu: bool) -> Var {
        layer.apply(x, relu)
    }

    fn apply_joint(layer: &[Linear; 2], tokens: &Var, edges: &Var) -> KeyValue<Self> {
        (layer[0].apply(tokens, false), layer[1].apply(edges, false))
    }

    fn normed(norm: &Norm, x: &Var, relu: bool) -> Var {
        norm.apply(x, relu)
    }

    fn sum_normed(norm: &Norm, x: &Var, y: Var) -> Var {
        norm.of_sum(x, &y)
    }

    fn sum(x: Var, y: &Var) -> Var {
        let (made, y) = (Cpu::sum(Array::clone(&x), y), y.clone());
        Var::made(made, x.learns || y.learns, move |_, gradient| {
            if y.learns && y.tokens != x.tokens {
                y.learn(over_tokens(&gradient, x.tokens, x.width));
            } else if y.numbers.len() == gradient.len() {
                y.learn(gradient.clone());
            } else if y.learns {
                let mut of = vec![0.0; y.numbers.len()];
                kernels::add_rows(&gradient, &mut of);
                y.learn(of);
            }
            x.learn(gradient);
        })
    }

    fn cut(x: &Var, width: i64) -> Var {
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

    fn scaled(x: &Var, factor: &Var) -> Var {
        let factor = factor.clone();
        x.through(Cpu::scaled(x, &factor), move |made, gradient| {
            Cpu::scaled(&made.like(gradient), &factor).numbers
        })
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
        let numbers = places.iter().map(|at| x.numbers[*at as usize]).collect();
        let count = x.numbers.len();
        x.through(Array::new(1, width, numbers), move |_, gradient| {
            let mut of = vec![0.0; count];
            places.iter().zip(gradient).for_each(|(at, g)| of[*at as usize] = g);
            of
        })
    }

    fn rows_of(table: &Var, steps: &[usize]) -> Var {
        Var::of(Cpu::rows_of(table, steps))
    }

    fn mish(x: &Var) -> Var {
        let (mut numbers, from) = (x.numbers.clone(), x.clone());
        kernels::mish(&mut numbers);
        x.through(x.like(numbers), move |_, mut gradient| {
            kernels::mish_back(&mut gradient, &from.numbers);
            gradient
        })
    }

    fn attend(q: &Var, (k, v): (&Var, &Var), heads: i64, _: Option<&Pairs>) -> Var {
        attended(q, k, v, heads as usize)
    }

    fn attend_across(
        q: &Var,
        (k, v): &KeyValue<Self>,
        edges: Option<&KeyValue<Self>>,
        slots: &Pairs,
        heads: i64,
    ) -> (Var, Vec<f32>) {
        let seen = Rc::clone(if edges.is_some() { &slots.others } else { &slots.all });
        let edges = edges.map(|(k, v)| [k.clone(), v.clone()]);
        Mixed { seen, heads: heads as usize, rows: [q, k, v].map(Var::clone), edges }.made()
    }

    fn gated(a: &Var, g: &Var, h: &Var, own: Var) -> Var {
        let made = Cpu::gated(a, g, h, Array::clone(&own));
        let (a, g, h) = (a.clone(), g.clone(), h.clone());
        Var::made(made, true, move |_, gradient| {
            let [mut of_a, mut of_g, mut of_own] = [&a, &g, &own].map(|x| x.numbers.clone());
            kernels::gate_back(&gradient, &mut of_a, &mut of_g, &h.numbers, &mut of_own);
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
        let (width, tokens) = (plan.width, plan.tokens);
        let mut numbers = Vec::with_capacity(plan.numbers.len() + history.numbers.len());
        for (own, plan) in history.numbers.chunks_exact(width).zip(plan.numbers.chunks_exact(plan.row())) {
            let from = numbers.len();
            numbers.extend_from_slice(own);
            numbers.extend_from_slice(plan);
            if carried {
                kernels::add_cycle(&mut numbers[from + width..], own);
            }
        }
        let row = (1 + tokens) * width;
        for (numbers, steps) in numbers.chunks_exact_mut(row).zip(steps.numbers.chunks_exact(width)) {
            kernels::add_cycle(numbers, steps);
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

    fn plain(batch: &Batch) -> numbers::Batch<'_> {
        batch.numbers()
    }

    fn alone<'a>(batch: &Self::Batch<'a>) -> Self::Batch<'a> {
        batch.clone().with_graph_dropped(|_| true)
    }

    fn placed(_: &Batch, x: Array) -> Var {
        Var::of(x)
    }

    fn edges(batch: &Batch, config: &ModelConfig, moved: bool) -> (Var, Pairs) {
        let (edges, pairs) = batch.numbers().edges(config, moved);
        (Var::of(edges), pairs)
    }
}
