//! Loops over rows of numbers, which the compiler turns into vectors of each level.

use super::shape::PANEL;
use super::simd::{Vector, Work, at_level};

/// Functions that are compiled once per level; what they call must be `#[inline(always)]`.
macro_rules! at_levels {
    ($($(#[$doc:meta])* fn $name:ident<'a>($($arg:ident: $ty:ty),* $(,)?) $body:block)+) => {$(
        $(#[$doc])*
        #[allow(clippy::needless_lifetimes, reason = "the work has the same fields")]
        #[allow(unreachable_pub, reason = "training uses some of them")]
        pub fn $name<'a>($($arg: $ty),*) {
            struct Call<'a> { $($arg: $ty,)* lives: std::marker::PhantomData<&'a ()> }
            impl<'a> Work for Call<'a> {
                #[inline(always)]
                fn run<V: Vector, const ROWS: usize>(self) {
                    let Self { $($arg,)* lives: _ } = self;
                    $body
                }
            }
            at_level(Call { $($arg,)* lives: std::marker::PhantomData });
        }
    )+};
}
pub(super) use at_levels;

/// The sum of numbers of a row, by sixteen lanes, then halves of them.
#[inline(always)]
pub(super) fn sum(row: &[f32], of: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0f32; PANEL];
    let (whole, rest) = row.as_chunks::<PANEL>();
    for part in whole {
        for j in 0..PANEL {
            lanes[j] += of(part[j]);
        }
    }
    for (lane, x) in lanes.iter_mut().zip(rest) {
        *lane += of(*x);
    }
    halves(&mut lanes)
}

#[inline(always)]
pub(super) fn halves(lanes: &mut [f32; PANEL]) -> f32 {
    for j in 0..8 {
        lanes[j] += lanes[j + 8];
    }
    for j in 0..4 {
        lanes[j] += lanes[j + 4];
    }
    (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])
}

#[inline(always)]
fn norm_row(row: &mut [f32], weight: &[f32], bias: &[f32], relu: bool) {
    let share = 1.0 / row.len() as f32;
    let mean = sum(row, |x| x) * share;
    let variance = sum(row, |x| (x - mean) * (x - mean)) * share;
    let scale = 1.0 / (variance + 1e-5).sqrt();
    for ((x, w), b) in row.iter_mut().zip(weight).zip(bias) {
        let y = (*x - mean) * scale * w + b;
        *x = if relu && y <= 0.0 { 0.0 } else { y };
    }
}

/// e to the power x, for x up to 88. Below -50 it is zero: nothing beside a one, and no denormal numbers behind it.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    let small = x < -50.0;
    let x = if small { -50.0 } else { x };
    // the nearest whole power of two, in the last bits of a large number
    let shifted = x * std::f32::consts::LOG2_E + 12_582_912.0;
    let n = shifted - 12_582_912.0;
    let r = x - n * 0.693_359_4 - n * -2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 0.5;
    let y = p * (r * r) + r + 1.0;
    let y = f32::from_bits(y.to_bits().wrapping_add(shifted.to_bits() << 23));
    if small { 0.0 } else { y }
}

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

    /// Rows of the weights' width, each with mean 0 and variance 1, then weighted; with `relu` no number below zero.
    fn norm<'a>(x: &'a mut [f32], weight: &'a [f32], bias: &'a [f32], relu: bool) {
        for row in x.chunks_exact_mut(weight.len().max(1)) {
            norm_row(row, weight, bias, relu);
        }
    }

    /// x + y, then as [`norm`].
    fn add_norm<'a>(x: &'a mut [f32], y: &'a [f32], weight: &'a [f32], bias: &'a [f32]) {
        let width = weight.len().max(1);
        for (row, other) in x.chunks_exact_mut(width).zip(y.chunks_exact(width)) {
            for (a, b) in row.iter_mut().zip(other) {
                *a += b;
            }
            norm_row(row, weight, bias, false);
        }
    }

    /// x + y, y again and again.
    fn add_cycle<'a>(x: &'a mut [f32], y: &'a [f32]) {
        for part in x.chunks_exact_mut(y.len().max(1)) {
            for (a, b) in part.iter_mut().zip(y) {
                *a += b;
            }
        }
    }

    /// a + sigmoid(g + h) · (x - a), in place of x.
    fn gate<'a>(x: &'a mut [f32], a: &'a [f32], g: &'a [f32], h: &'a [f32]) {
        for (((x, a), g), h) in x.iter_mut().zip(a).zip(g).zip(h) {
            let z = (g + h).clamp(-87.0, 87.0);
            *x = a + 1.0 / (1.0 + exp(-z)) * (*x - a);
        }
    }

    /// Softmax of scale · x down the columns of rows of `wide` numbers, a multiple of 16.
    fn softmax_columns<'a>(x: &'a mut [f32], wide: usize, scale: f32) {
        for from in (0..wide).step_by(PANEL) {
            let mut most = [f32::NEG_INFINITY; PANEL];
            for row in x.chunks_exact(wide) {
                for (m, x) in most.iter_mut().zip(&row[from..from + PANEL]) {
                    *m = if *x > *m { *x } else { *m };
                }
            }
            let mut total = [0f32; PANEL];
            for row in x.chunks_exact_mut(wide) {
                for ((x, m), t) in row[from..from + PANEL].iter_mut().zip(&most).zip(&mut total) {
                    *x = exp((*x - *m) * scale);
                    *t += *x;
                }
            }
            for t in &mut total {
                *t = 1.0 / *t;
            }
            for row in x.chunks_exact_mut(wide) {
                for (x, t) in row[from..from + PANEL].iter_mut().zip(&total) {
                    *x *= t;
                }
            }
        }
    }

    /// Rows of `width` numbers to columns: number c of row r goes to c · `to` + r.
    fn transpose<'a>(x: &'a [f32], width: usize, out: &'a mut [f32], to: usize) {
        for (r, row) in x.chunks_exact(width.max(1)).enumerate() {
            for (c, x) in row.iter().enumerate() {
                out[c * to + r] = *x;
            }
        }
    }

    /// The greatest number of each column of rows as wide as `out`.
    fn most<'a>(x: &'a [f32], out: &'a mut [f32]) {
        out.fill(f32::NEG_INFINITY);
        for row in x.chunks_exact(out.len().max(1)) {
            for (o, x) in out.iter_mut().zip(row) {
                *o = if *x > *o { *x } else { *o };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_those_of_double_precision() {
        for i in -49_000..88_000 {
            let x = i as f32 * 1e-3;
            let want = libm::exp(f64::from(x));
            assert!((f64::from(exp(x)) - want).abs() < 3e-7 * want, "{x}");
        }
        assert_eq!((exp(-50.1), exp(f32::NEG_INFINITY), exp(0.0)), (0.0, 0.0, 1.0));
    }
}
