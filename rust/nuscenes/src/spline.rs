//! Natural cubic smoothing splines through values at times that need not be evenly spaced.
//!
//! C. H. Reinsch, "Smoothing by Spline Functions", Numerische Mathematik 10, 1967; names as in P. J. Green and B. W.
//! Silverman, "Nonparametric Regression and Generalized Linear Models", 1994, section 2.3.

/// The curve that minimises the sum of squared distances to the values plus `smoothing` times the integral of its squared
/// second derivative: twice continuously differentiable, straight beyond its ends. Smoothing 0 passes through the values.
#[derive(Debug, Clone)]
pub(crate) struct SmoothingSpline {
    times_s: Vec<f64>,
    smoothing_s3: f64,
    /// One for each inner time.
    rows: Vec<Row>,
}

/// A column of Q, and of R + smoothing Qᵀ Q as L D Lᵀ the diagonal of D and the two numbers of L below it.
#[derive(Debug, Clone, Copy)]
struct Row {
    column: [f64; 3],
    diagonal: f64,
    below: [f64; 2],
}

/// A curve of N values at once: coefficients of their cubics in the seconds since its beginning, for each interval
/// between two times.
#[derive(Debug, Clone)]
pub(crate) struct Curve<const N: usize>(Vec<[[f64; 4]; N]>);

impl SmoothingSpline {
    /// For times that increase, with `smoothing_s3` of at least 0 (for values in metres: m² per m² s⁻³).
    pub(crate) fn new(times_s: Vec<f64>, smoothing_s3: f64) -> Self {
        let inner = times_s.len().saturating_sub(2);
        let row = |j| Row { column: column(&times_s, j), diagonal: 0.0, below: [0.0; 2] };
        let mut rows: Vec<Row> = (0..inner).map(row).collect();
        for j in 0..inner {
            let [h, next] = [times_s[j + 1] - times_s[j], times_s[j + 2] - times_s[j + 1]];
            let [a, b, c] = rows[j].column;
            rows[j].diagonal = (h + next) / 3.0 + smoothing_s3 * (a * a + b * b + c * c);
            if let Some(Row { column: [d, e, _], .. }) = rows.get(j + 1) {
                rows[j].below[0] = next / 6.0 + smoothing_s3 * (b * d + c * e);
            }
            if let Some(Row { column: [d, _, _], .. }) = rows.get(j + 2) {
                rows[j].below[1] = smoothing_s3 * (c * d);
            }
        }
        for j in 0..inner {
            let Row { diagonal: pivot, below: [first, second], .. } = rows[j];
            if j + 1 < inner {
                rows[j + 1].diagonal -= first * first / pivot;
                rows[j + 1].below[0] -= first * second / pivot;
            }
            if j + 2 < inner {
                rows[j + 2].diagonal -= second * second / pivot;
            }
            rows[j].below = [first / pivot, second / pivot];
        }
        Self { times_s, smoothing_s3, rows }
    }

    /// The curve for these values, one for each time, of which there are two at least.
    pub(crate) fn fit<const N: usize>(&self, mut values: Vec<[f64; N]>) -> Curve<N> {
        let inner = self.rows.len();
        let mut seconds = vec![[0.0; N]; values.len()];
        // seconds[j + 1] belongs to the inner value j + 1; the ends have none
        for j in 0..inner {
            let [a, b, c] = self.rows[j].column;
            seconds[j + 1] = each(|n| a * values[j][n] + b * values[j + 1][n] + c * values[j + 2][n]);
        }
        for j in 0..inner {
            let solved = seconds[j + 1];
            if j + 1 < inner {
                seconds[j + 2] = each(|n| seconds[j + 2][n] - self.rows[j].below[0] * solved[n]);
            }
            if j + 2 < inner {
                seconds[j + 3] = each(|n| seconds[j + 3][n] - self.rows[j].below[1] * solved[n]);
            }
        }
        for j in (0..inner).rev() {
            let mut solved = seconds[j + 1].map(|value| value / self.rows[j].diagonal);
            if j + 1 < inner {
                solved = each(|n| solved[n] - self.rows[j].below[0] * seconds[j + 2][n]);
            }
            if j + 2 < inner {
                solved = each(|n| solved[n] - self.rows[j].below[1] * seconds[j + 3][n]);
            }
            seconds[j + 1] = solved;
        }
        if self.smoothing_s3 > 0.0 {
            for j in 0..inner {
                for (i, weight) in self.rows[j].column.into_iter().enumerate() {
                    let weight = self.smoothing_s3 * weight;
                    values[j + i] = each(|n| values[j + i][n] - weight * seconds[j + 1][n]);
                }
            }
        }
        let cubic = |i: usize| {
            let h = self.times_s[i + 1] - self.times_s[i];
            each(|n| {
                let (a, b, c, d) = (values[i][n], values[i + 1][n], seconds[i][n], seconds[i + 1][n]);
                [a, (b - a) / h - h * (2.0 * c + d) / 6.0, c / 2.0, (d - c) / (6.0 * h)]
            })
        };
        Curve((0..values.len() - 1).map(cubic).collect())
    }

    /// Values and slopes of a curve `u_s` seconds after the time `i`; before the first time and after the last one straight
    /// lines.
    pub(crate) fn at<const N: usize>(&self, Curve(cubics): &Curve<N>, i: usize, u_s: f64) -> [[f64; 2]; N] {
        let u = u_s.clamp(0.0, self.times_s[i + 1] - self.times_s[i]);
        cubics[i].map(|[a, b, c, d]| {
            let slope = b + u * (2.0 * c + u * (3.0 * d));
            [a + u * (b + u * (c + u * d)) + slope * (u_s - u), slope]
        })
    }
}

/// An array of what a function makes of each index.
#[inline]
fn each<T, const N: usize>(make: impl FnMut(usize) -> T) -> [T; N] {
    std::array::from_fn(make)
}

/// Column `j` of Q: second differences about the time `j + 1`.
fn column(times_s: &[f64], j: usize) -> [f64; 3] {
    let [a, b] = [1.0 / (times_s[j + 1] - times_s[j]), 1.0 / (times_s[j + 2] - times_s[j + 1])];
    [a, -a - b, b]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Slopes and second derivatives are continuous, the third derivative jumps by what each value is missed by: this and
        /// straight ends are the smoothing spline and no other curve (Green and Silverman, theorem 2.1).
        #[test]
        fn the_curve_is_the_one_that_bends_least(
            points in proptest::collection::vec((-5.0_f64..5.0, 0.05_f64..2.0), 2..12),
            smoothing_s3 in prop_oneof![Just(0.0), 1e-4_f64..0.1],
        ) {
            let times_s: Vec<f64> = points.iter().scan(0.0, |t, (_, h)| { *t += h; Some(*t) }).collect();
            let values: Vec<[f64; 1]> = points.iter().map(|(value, _)| [*value]).collect();
            let spline = SmoothingSpline::new(times_s.clone(), smoothing_s3);
            let curve = spline.fit(values.clone());
            let last = values.len() - 1;
            let span = |i: usize| times_s[i + 1] - times_s[i];
            let Curve(cubics) = &curve;
            let end = cubics[last - 1][0];
            prop_assert_eq!(cubics[0][0][2], 0.0);
            prop_assert!((end[2] + 3.0 * end[3] * span(last - 1)).abs() < 1e-6);
            for i in 0..=last {
                let before = if i > 0 { 6.0 * cubics[i - 1][0][3] } else { 0.0 };
                let after = if i < last { 6.0 * cubics[i][0][3] } else { 0.0 };
                let value =
                    if i < last { cubics[i][0][0] } else { spline.at(&curve, last - 1, span(last - 1))[0][0] };
                prop_assert!((values[i][0] - value - smoothing_s3 * (after - before)).abs() < 1e-6);
                if i > 0 && i < last {
                    let [end, start] = [(i - 1, span(i - 1)), (i, 0.0)].map(|(i, u)| spline.at(&curve, i, u)[0]);
                    prop_assert!((end[0] - start[0]).abs() < 1e-9);
                    prop_assert!((end[1] - start[1]).abs() < 1e-6 * (1.0 + end[1].abs()));
                    let [_, _, c, d] = cubics[i - 1][0];
                    let bend = c + 3.0 * d * span(i - 1);
                    prop_assert!((bend - cubics[i][0][2]).abs() < 1e-6 * (1.0 + bend.abs()));
                }
            }
            // the slope is that of the value
            let [a, b] = [0.3 * span(0), 0.3 * span(0) + 1e-6];
            let slope = (spline.at(&curve, 0, b)[0][0] - spline.at(&curve, 0, a)[0][0]) / 1e-6;
            prop_assert!((slope - spline.at(&curve, 0, a)[0][1]).abs() < 1e-3 * (1.0 + slope.abs()));
        }
    }
}
