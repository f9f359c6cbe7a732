//! Products of rows with packed weights: what linear layers, convolutions and attention come down to.

use super::shape::{PANEL, Product};
use super::tile::multiply;

/// Weights [columns, inputs] in panels of 16 columns, [columns / 16][inputs][16], zeros beyond the last, with the bias.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed {
    pub(crate) inputs: usize,
    pub(crate) columns: usize,
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Packed {
    /// From rows of columns [columns, inputs], as weight files have them; no bias is one of zeros.
    pub fn new(rows: &[f32], bias: &[f32], columns: usize, inputs: usize) -> Self {
        let panels = columns.div_ceil(PANEL);
        let mut weights = vec![0.0; panels * inputs * PANEL];
        let size = (inputs * PANEL).max(1);
        for (panel, stored) in weights.chunks_exact_mut(size).zip(rows.chunks(size)) {
            for (column, row) in stored.chunks_exact(inputs.max(1)).enumerate() {
                for (to, weight) in panel[column..].iter_mut().step_by(PANEL).zip(row) {
                    *to = *weight;
                }
            }
        }
        let mut padded = vec![0.0; panels * PANEL];
        for (to, bias) in padded.iter_mut().zip(bias) {
            // never -0, which a product of zero would turn to +0
            *to = bias + 0.0;
        }
        Self { inputs, columns, weights, bias: padded }
    }

    /// From gradients of the columns to gradients of the inputs.
    pub(crate) fn turned(&self) -> Self {
        let weight = |column: usize, input: usize| {
            self.weights[(column / PANEL * self.inputs + input) * PANEL + column % PANEL]
        };
        let rows = (0..self.inputs).flat_map(|i| (0..self.columns).map(move |c| weight(c, i)));
        Self::new(&rows.collect::<Vec<_>>(), &[], self.inputs, self.columns)
    }

    fn panels(&self) -> usize {
        self.columns.div_ceil(PANEL)
    }
}

/// x [rows, inputs] times weights, plus bias: [rows, columns]. `out` is made as long as it must be.
pub fn linear(x: &[f32], weights: &Packed, relu: bool, out: &mut Vec<f32>) {
    let (rows, wide) = (x.len() / weights.inputs.max(1), weights.panels() * PANEL);
    let p = Product {
        rows,
        length: weights.inputs,
        input_step: 1,
        panels: weights.panels(),
        panel_step: weights.inputs * PANEL,
        weight_step: PANEL,
        from: weights.inputs,
        to: wide,
        relu,
    };
    out.clear();
    out.resize(rows * wide, 0.0);
    multiply(&p, x, &weights.weights, Some(&weights.bias), out);
    if wide != weights.columns {
        for row in 0..rows {
            out.copy_within(row * wide..row * wide + weights.columns, row * weights.columns);
        }
        out.truncate(rows * weights.columns);
    }
}

/// Numbers in memory as one side of a product: row i and step j at i · `row` + j · `step`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strided<'a> {
    /// All numbers.
    pub(super) numbers: &'a [f32],
    /// From one row to the next.
    pub(super) row: usize,
    /// From one step to the next.
    pub(super) step: usize,
}

/// a [rows, length] times b [length, columns], whose steps are `b_step` apart: [rows, `out_row`]. Columns are a multiple of 16.
pub(super) fn matmul(
    a: Strided<'_>,
    (rows, length, columns): (usize, usize, usize),
    (b, b_step): (&[f32], usize),
    (out, out_row): (&mut [f32], usize),
) {
    let p = Product {
        rows,
        length,
        input_step: a.step,
        panels: columns / PANEL,
        panel_step: PANEL,
        weight_step: b_step,
        from: a.row,
        to: out_row,
        relu: false,
    };
    multiply(&p, a.numbers, b, None, out);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::noise::Noise;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn linear_layers_are_their_sums(rows in 1usize..30, inputs in 1usize..70, columns in 1usize..70, relu: bool) {
            let x = Noise::new(3, 1).normals(rows * inputs);
            let w = Noise::new(4, 1).normals(columns * inputs);
            let bias = Noise::new(5, 1).normals(columns);
            let packed = Packed::new(&w, &bias, columns, inputs);
            let mut found = vec![9.0; 3];
            linear(&x, &packed, relu, &mut found);
            for row in 0..rows {
                for column in 0..columns {
                    let products = (0..inputs).map(|k| f64::from(x[row * inputs + k]) * f64::from(w[column * inputs + k]));
                    let sum = f64::from(bias[column]) + products.sum::<f64>();
                    let sum = if relu { sum.max(0.0) } else { sum };
                    prop_assert!((f64::from(found[row * columns + column]) - sum).abs() < 1e-4);
                }
            }
            // a row alone has the bits that it has among others
            let mut alone = Vec::new();
            linear(&x[..inputs], &packed, relu, &mut alone);
            prop_assert_eq!(&alone, &found[..columns]);
        }
    }
}
