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

    /// A part of this part.
    pub(super) fn sub(&self, name: &str) -> Self {
        let dot = if self.name.is_empty() { "" } else { "." };
        Self { weights: self.weights, name: format!("{}{dot}{name}", self.name) }
    }

    /// Numbers of a tensor of this part.
    pub(super) fn take(&self, name: &str, shape: &[i64]) -> Option<&'a [f32]> {
        let shape: Vec<usize> = shape.iter().map(|s| *s as usize).collect();
        self.weights.take(&self.sub(name).name, &shape)
    }
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
