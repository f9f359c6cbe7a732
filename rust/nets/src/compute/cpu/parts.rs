//! What the layers of own kernels hold: numbers, weights, whom rows see.

use crate::compute::weights::Weights;
use crate::inputs::features::SceneFeatures;
use crate::kernels::{Packed, Seen};
use std::ops::Range;
use std::rc::Rc;

/// Numbers [rows, tokens, width].
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Tokens of a row.
    pub tokens: usize,
    /// Numbers of a token.
    pub width: usize,
    /// The numbers, row by row.
    pub numbers: Vec<f32>,
}

impl Array {
    /// Numbers in this shape; the rows follow.
    pub fn new(tokens: usize, width: usize, numbers: Vec<f32>) -> Self {
        Self { tokens, width, numbers }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.numbers.len() / self.row()
    }

    /// Other numbers in the same shape.
    #[must_use]
    pub fn like(&self, numbers: Vec<f32>) -> Self {
        Self { numbers, ..*self }
    }

    /// Numbers of a row.
    pub fn row(&self) -> usize {
        (self.tokens * self.width).max(1)
    }
}

/// A part of a weight file.
#[derive(Debug)]
pub struct Place<'a> {
    pub(super) weights: &'a Weights,
    pub(super) name: String,
}

impl<'a> Place<'a> {
    /// All of a file.
    pub fn root(weights: &'a Weights) -> Self {
        Self { weights, name: String::new() }
    }

    /// Numbers of a tensor of this part.
    pub(super) fn take(&self, name: &str, shape: &[i64]) -> Option<&'a [f32]> {
        let shape: Vec<usize> = shape.iter().map(|s| *s as usize).collect();
        let dot = if self.name.is_empty() { "" } else { "." };
        self.weights.take(&format!("{}{dot}{name}", self.name), &shape)
    }
}

/// A linear layer from some columns of stored rows.
pub(super) fn packed(
    rows: Option<&[f32]>,
    bias: Option<&[f32]>,
    outputs: i64,
    stored: i64,
    from: i64,
    to: i64,
) -> Packed {
    let Some(rows) = rows else { return Packed::new(&[], &[], 0, 0) };
    let part: Vec<f32> = rows
        .chunks_exact(stored as usize)
        .flat_map(|row| &row[from as usize..to as usize])
        .copied()
        .collect();
    Packed::new(&part, bias.unwrap_or(&[]), outputs as usize, (to - from) as usize)
}

/// A layer norm.
#[derive(Debug)]
pub struct Norm {
    pub(crate) weight: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

/// A convolution over tokens.
#[derive(Debug)]
pub struct Filter {
    /// Inputs token by token.
    pub(super) weights: Packed,
    pub(super) kernel: usize,
    pub(super) stride: usize,
}

/// A group norm.
#[derive(Debug)]
pub struct Groups {
    pub(super) norm: Norm,
    pub(super) groups: usize,
}

/// Batch of the agents of several scenes.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// The scenes.
    pub scenes: &'a [SceneFeatures],
    /// Whether everybody sees itself alone.
    pub alone: bool,
}

/// Whom rows see: others, or themselves where there are none; and themselves with the others.
#[derive(Debug)]
pub struct Pairs {
    /// Others.
    pub others: Rc<Seen>,
    /// All.
    pub all: Rc<Seen>,
    /// Slots of a row.
    pub(super) slots: usize,
}

impl Batch<'_> {
    pub(super) fn numbers(&self, of: impl Fn(&SceneFeatures) -> &[f32]) -> Vec<f32> {
        self.scenes.iter().flat_map(|s| of(s)).copied().collect()
    }

    pub(super) fn num_rows(&self) -> usize {
        self.scenes.iter().map(|s| s.agents.len()).sum()
    }
}

impl Pairs {
    /// Mean attention [R, slots] to the others over samples and tokens, zero where nobody is seen.
    pub(super) fn mean(&self, samples: &[Vec<f32>], tokens: Range<usize>) -> Vec<f32> {
        let (rows, pairs) = (self.others.start.len() - 1, self.others.other.len());
        let mut mean = vec![0.0; rows * self.slots];
        for attention in samples {
            let all = attention.len() / pairs.max(1);
            for row in 0..rows {
                for pair in self.others.start[row]..self.others.start[row + 1] {
                    let of_pair = &attention[pair * all..][tokens.clone()];
                    mean[row * self.slots + self.others.slot[pair]] +=
                        of_pair.iter().sum::<f32>() / (tokens.len() * samples.len()) as f32;
                }
            }
        }
        mean
    }
}
