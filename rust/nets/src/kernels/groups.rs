//! Group norms of rows of tokens, with their activation.

use super::rows::{at_levels, exp};
use super::simd::{Checked, Work, at_level};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Level;
    use crate::sampling::noise::Noise;

    #[test]
    fn groups_have_mean_zero_and_variance_one_before_mish_at_every_level() {
        let (rows, tokens, width, groups) = (3, 7, 48, 8);
        let x = Noise::new(1, 7).normals(rows * tokens * width);
        let (weight, bias) = (Noise::new(2, 7).normals(width), Noise::new(3, 7).normals(width));
        let found = Level::available().into_iter().map(|level| {
            let mut x = x.clone();
            groups_mish(Checked::at_most(level), &mut x, tokens * width, groups, &weight, &bias);
            x
        });
        let found: Vec<Vec<f32>> = found.collect();
        assert!(found.iter().all(|f| f == &found[0]));
        let at = |row: usize, token: usize, c: usize| (row * tokens + token) * width + c;
        for (row, c) in (0..rows).flat_map(|row| (0..width).map(move |c| (row, c))) {
            let first = c / (width / groups) * (width / groups);
            let group = (0..tokens).flat_map(|t| (first..first + width / groups).map(move |c| (t, c)));
            let group: Vec<f64> = group.map(|(t, c)| f64::from(x[at(row, t, c)])).collect();
            let mean = group.iter().sum::<f64>() / group.len() as f64;
            let variance = group.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / group.len() as f64;
            for token in 0..tokens {
                let normed = (f64::from(x[at(row, token, c)]) - mean) / (variance + 1e-5).sqrt();
                let y = normed * f64::from(weight[c]) + f64::from(bias[c]);
                let want = y * y.exp().ln_1p().tanh();
                assert!((f64::from(found[0][at(row, token, c)]) - want).abs() < 1e-5 + 1e-5 * want.abs());
            }
        }
        // the tabulated values, and the ends
        for (x, want) in [(1.0, 0.8651), (-1.0, -0.3034), (0.5, 0.3752), (60.0, 60.0), (-60.0, 0.0)] {
            assert!((mish(x) - want).abs() < 1e-4, "{x}");
        }
    }
}
