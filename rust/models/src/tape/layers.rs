//! Weights, and the layers that hold them.

use super::Var;
use ccdiff_nets::compute::cpu::Array;
use ccdiff_nets::kernels::{self, How, PANEL, Packed, Strided};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// Rows of which the gradients of weights are summed before they are added up.
const BLOCK: usize = 256;

/// The gradient of all numbers of a network.
type Gradient = Rc<RefCell<Vec<f32>>>;

/// All numbers of a network, one tensor after the other, and their gradient.
#[derive(Debug)]
pub struct Parameters {
    numbers: Vec<f32>,
    places: BTreeMap<String, usize>,
    gradient: Gradient,
}

impl Parameters {
    /// Numbers, and where the tensors of these names begin.
    pub fn new(numbers: Vec<f32>, places: BTreeMap<String, usize>) -> Self {
        let gradient = Rc::new(RefCell::new(vec![0.0; numbers.len()]));
        Self { numbers, places, gradient }
    }

    /// The gradient so far.
    pub fn gradient(&self) -> Vec<f32> {
        self.gradient.borrow().clone()
    }

    /// The place of all of them.
    pub fn root(&self) -> Place<'_> {
        Place { parameters: self, name: String::new() }
    }
}

/// A part of a network.
#[derive(Debug)]
pub struct Place<'a> {
    parameters: &'a Parameters,
    name: String,
}

impl<'a> Place<'a> {
    pub(super) fn sub(&self, name: &str) -> Place<'a> {
        let dot = if self.name.is_empty() { "" } else { "." };
        Self { parameters: self.parameters, name: format!("{}{dot}{name}", self.name) }
    }

    /// Where a tensor begins, and its numbers; nothing of one that is not there.
    fn take(&self, name: &str, count: usize) -> (usize, &'a [f32]) {
        let at = self.parameters.places.get(&self.sub(name).name).copied().unwrap_or(usize::MAX);
        (at, self.parameters.numbers.get(at..at.saturating_add(count)).unwrap_or_default())
    }

    fn gradient(&self) -> Gradient {
        Rc::clone(&self.parameters.gradient)
    }
}

/// A linear layer, or some columns of one.
#[derive(Debug)]
pub(super) struct Part {
    /// Where its weights begin, and how many numbers a stored row has.
    at: usize,
    stored: usize,
    bias: Option<usize>,
    inputs: usize,
    outputs: usize,
    /// Weights [outputs, inputs].
    rows: Vec<f32>,
    packed: Packed,
    gradient: Gradient,
}

/// A linear layer.
#[derive(Debug, Clone)]
pub struct Linear(Rc<Part>);

impl Linear {
    pub(super) fn new(p: &Place<'_>, inputs: i64, outputs: i64) -> Self {
        Self::part(p, (inputs as usize, 0, inputs as usize), outputs as usize, true)
    }

    /// Columns `from..to` of `stored`.
    pub(super) fn part(
        p: &Place<'_>,
        (stored, from, to): (usize, usize, usize),
        outputs: usize,
        biased: bool,
    ) -> Self {
        let ((at, weights), inputs) = (p.take("weight", outputs * stored), to - from);
        let rows: Vec<f32> =
            weights.chunks_exact(stored.max(1)).flat_map(|row| &row[from..to]).copied().collect();
        let (bias_at, bias) = if biased { p.take("bias", outputs) } else { (0, [].as_slice()) };
        Self(Rc::new(Part {
            at: at.saturating_add(from),
            stored,
            bias: biased.then_some(bias_at),
            inputs,
            outputs,
            packed: Packed::new(&rows, bias, outputs, inputs),
            rows,
            gradient: p.gradient(),
        }))
    }

    /// Tokens of the inputs' width to tokens of the outputs', then a ReLU if asked for.
    pub(super) fn apply(&self, x: &Var, relu: bool) -> Var {
        let mut numbers = Vec::new();
        kernels::linear(&x.numbers, &self.0.packed, relu, How::Fused, &mut numbers);
        let (part, from) = (Rc::clone(&self.0), x.clone());
        let made = Array::new(x.tokens, self.0.outputs, numbers);
        Var::made(made, true, move |made, mut gradient| {
            if relu {
                kernels::relu_back(&mut gradient, &made.numbers);
            }
            part.learn(&from.numbers, &gradient);
            if from.learns {
                from.learn(part.back(&gradient));
            }
        })
    }
}

impl Part {
    /// Gradients by inputs, from those by outputs.
    fn back(&self, gradient: &[f32]) -> Vec<f32> {
        let (m, n) = (self.inputs, self.outputs);
        let wide = m.next_multiple_of(PANEL);
        let rows = gradient.len() / n;
        let mut out = vec![0.0; rows * wide];
        let from = Strided { numbers: gradient, row: n, step: 1 };
        let padded = (wide != m).then(|| widened(&self.rows, m, wide));
        let weights = padded.as_deref().unwrap_or(&self.rows);
        kernels::matmul(from, (rows, n, wide), (weights, wide), (&mut out, wide), How::Fused);
        if wide != m {
            out = out.chunks_exact(wide).flat_map(|row| &row[..m]).copied().collect();
        }
        out
    }

    /// Adds the gradients by weights and bias.
    fn learn(&self, x: &[f32], gradient: &[f32]) {
        let (m, n, mut all) = (self.inputs, self.outputs, self.gradient.borrow_mut());
        if let Some(bias) = self.bias {
            kernels::add_rows(gradient, &mut all[bias..bias + n]);
        }
        // of either side the columns are whole panels, or inputs are widened
        if m % PANEL != 0 && n % PANEL == 0 {
            let mut turned = vec![0.0; m * n];
            blocks((gradient, n), (x, m), &mut turned);
            for (input, row) in turned.chunks_exact(n).enumerate() {
                for (output, g) in row.iter().enumerate() {
                    all[self.at + output * self.stored + input] += g;
                }
            }
            return;
        }
        let wide = m.next_multiple_of(PANEL);
        let padded = (wide != m).then(|| widened(x, m, wide));
        let mut sums = vec![0.0; n * wide];
        blocks((padded.as_deref().unwrap_or(x), wide), (gradient, n), &mut sums);
        for (output, row) in sums.chunks_exact(wide).enumerate() {
            let to = &mut all[self.at + output * self.stored..][..m];
            to.iter_mut().zip(row).for_each(|(a, g)| *a += g);
        }
    }
}

/// Adds rows^T [n, R] times columns [R, m] to `out` [n, m], block by block.
fn blocks((columns, m): (&[f32], usize), (rows, n): (&[f32], usize), out: &mut [f32]) {
    let mut part = vec![0.0; n * m];
    for (columns, rows) in columns.chunks(BLOCK * m).zip(rows.chunks(BLOCK * n)) {
        let a = Strided { numbers: rows, row: 1, step: n };
        kernels::matmul(a, (n, rows.len() / n, m), (columns, m), (&mut part, m), How::Fused);
        kernels::add_cycle(out, &part);
    }
}

/// Rows with zeros behind them.
fn widened(x: &[f32], width: usize, wide: usize) -> Vec<f32> {
    let mut out = vec![0.0; x.len() / width * wide];
    for (to, from) in out.chunks_exact_mut(wide).zip(x.chunks_exact(width)) {
        to[..width].copy_from_slice(from);
    }
    out
}

/// A layer norm.
#[derive(Debug, Clone)]
pub struct Norm(Rc<NormPart>);

#[derive(Debug)]
struct NormPart {
    weight: Vec<f32>,
    bias: Vec<f32>,
    at: [usize; 2],
    gradient: Gradient,
}

impl Norm {
    pub(super) fn new(p: &Place<'_>, width: i64) -> Self {
        let [(weight_at, weight), (bias_at, bias)] =
            ["weight", "bias"].map(|name| p.take(name, width as usize));
        let at = [weight_at, bias_at];
        Self(Rc::new(NormPart { weight: weight.to_vec(), bias: bias.to_vec(), at, gradient: p.gradient() }))
    }

    /// Normed rows, then a ReLU if asked for.
    pub(super) fn apply(&self, x: &Var, relu: bool) -> Var {
        let (norm, x) = (Rc::clone(&self.0), x.clone());
        Var::made(x.like(self.made(x.numbers.clone(), relu)), true, move |made, mut gradient| {
            if relu {
                kernels::relu_back(&mut gradient, &made.numbers);
            }
            norm.back(&x.numbers, &mut gradient);
            x.learn(gradient);
        })
    }

    /// Normed sums.
    pub(super) fn of_sum(&self, x: &Var, y: &Var) -> Var {
        let mut sum = x.numbers.clone();
        kernels::add_cycle(&mut sum, &y.numbers);
        let (norm, x, y, numbers) = (Rc::clone(&self.0), x.clone(), y.clone(), self.made(sum.clone(), false));
        Var::made(y.like(numbers), true, move |_, mut gradient| {
            norm.back(&sum, &mut gradient);
            x.learn(gradient.clone());
            y.learn(gradient);
        })
    }

    fn made(&self, mut numbers: Vec<f32>, relu: bool) -> Vec<f32> {
        kernels::norm(&mut numbers, &self.0.weight, &self.0.bias, relu);
        numbers
    }
}

impl NormPart {
    fn back(&self, x: &[f32], gradient: &mut [f32]) {
        let (mut all, width) = (self.gradient.borrow_mut(), self.weight.len());
        let (mut of_weight, mut of_bias) = (vec![0.0; width], vec![0.0; width]);
        kernels::norm_back(x, &self.weight, gradient, &mut of_weight, &mut of_bias);
        for (at, of) in self.at.into_iter().zip([of_weight, of_bias]) {
            all[at..at + width].iter_mut().zip(of).for_each(|(a, g)| *a += g);
        }
    }
}
