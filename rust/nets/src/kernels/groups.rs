//! Group norms of rows of tokens, with their activation.

use super::rows::{at_levels, exp};
use super::simd::{Work, at_level};

/// x · tanh(ln(1 + exp x)), which is x · n / (n + 2) with n = exp x · (exp x + 2).
#[inline(always)]
pub(super) fn mish(x: f32) -> f32 {
    // from 20 on it is x
    let e = exp(if x > 20.0 { 20.0 } else { x });
    let n = e * (e + 2.0);
    x * (n / (n + 2.0))
}

/// Sums of groups from those of their columns, one after the other, to every column of the group.
#[inline(always)]
fn gathered(columns: &mut [f32], groups: usize, share: f32) {
    for group in columns.chunks_exact_mut((columns.len() / groups).max(1)) {
        let sum = group.iter().sum::<f32>() * share;
        group.fill(sum);
    }
}

at_levels! {
    /// Rows of `row` numbers, tokens as wide as the weights: each of `groups` groups of columns with mean 0 and variance 1 over
    /// all tokens, then weighted, then Mish.
    fn groups_mish<'a>(x: &'a mut [f32], row: usize, groups: usize, weight: &'a [f32], bias: &'a [f32]) {
        let width = weight.len().max(1);
        let share = groups as f32 / row as f32;
        let (mut mean, mut scale) = (vec![0f32; width], vec![0f32; width]);
        for row in x.chunks_exact_mut(row.max(1)) {
            mean.fill(0.0);
            for token in row.chunks_exact(width) {
                for (sum, x) in mean.iter_mut().zip(token) {
                    *sum += x;
                }
            }
            gathered(&mut mean, groups, share);
            scale.fill(0.0);
            for token in row.chunks_exact(width) {
                for ((sum, x), mean) in scale.iter_mut().zip(token).zip(&mean) {
                    *sum += (x - mean) * (x - mean);
                }
            }
            gathered(&mut scale, groups, share);
            for variance in &mut scale {
                *variance = 1.0 / (*variance + 1e-5).sqrt();
            }
            for token in row.chunks_exact_mut(width) {
                for ((((x, mean), scale), w), b) in token.iter_mut().zip(&mean).zip(&scale).zip(weight).zip(bias) {
                    *x = mish((*x - mean) * scale * w + b);
                }
            }
        }
    }
}
