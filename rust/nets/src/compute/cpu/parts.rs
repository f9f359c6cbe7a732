//! What the layers of own kernels hold.

use crate::compute::weights::Weights;
use crate::kernels::Packed;

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
