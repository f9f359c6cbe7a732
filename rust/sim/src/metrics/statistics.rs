//! Statistics of the evaluation: total variation, gradient conflict, Pearson correlation.

use crate::error::{Result, SimError};
use crate::geom::Real;

/// Total-variation distance of two Gaussians of equal variance: erf(|m1 - m2| / (2 sqrt(2) sigma)), in [0, 1].
///
/// # Shapes
/// `mean_one`, `mean_other`, `std_dev`: one entry per independent dimension.
///
/// # Errors
/// [`SimError::Length`] where the lengths differ, [`SimError::Config`] for a standard deviation that is not positive.
pub fn total_variation(mean_one: &[Real], mean_other: &[Real], std_dev: &[Real]) -> Result<f64> {
    for (what, got) in [("other mean", mean_other.len()), ("standard deviations", std_dev.len())] {
        if got != mean_one.len() {
            return Err(SimError::Length { what, got, expected: mean_one.len() });
        }
    }
    if let Some(bad) = std_dev.iter().find(|s| !s.is_finite() || **s <= 0.0) {
        let expected = "positive and finite".into();
        return Err(SimError::Config { field: "std_dev".into(), got: bad.to_string(), expected });
    }
    let squared: f64 = (0..mean_one.len())
        .map(|k| (f64::from(mean_one[k]) - f64::from(mean_other[k])) / f64::from(std_dev[k]))
        .map(|d| d * d)
        .sum();
    Ok(libm::erf(squared.sqrt() / std::f64::consts::SQRT_2 / 2.0))
}

/// How far the gradients of realism and guidance pull against each other.
#[derive(Debug, Clone, PartialEq)]
pub struct GradientConflict {
    /// Cosine between the two gradients of every agent; 0 where one of them is zero.
    pub cosine: Vec<f64>,
    /// Share of the agents whose gradients have a negative inner product.
    pub conflict_share: f64,
    /// Mean of the negative cosines with their sign turned; 0 where there is none.
    pub mean_negative_cosine: f64,
}

/// Compares two gradients per agent.
///
/// Differs from the paper: it gives the two figures without a definition; these are of reference.md#gradient-conflict.
///
/// # Shapes
/// `realism`, `guidance`: [agents, dimensions], row-major.
///
/// # Errors
/// [`SimError::Length`] where the arrays differ or do not hold `num_agents` rows.
pub fn gradient_conflict(num_agents: usize, realism: &[Real], guidance: &[Real]) -> Result<GradientConflict> {
    if guidance.len() != realism.len() {
        let (got, expected) = (guidance.len(), realism.len());
        return Err(SimError::Length { what: "guidance gradient", got, expected });
    }
    let width = realism.len().checked_div(num_agents).unwrap_or(0);
    if width * num_agents != realism.len() {
        let (got, expected) = (realism.len(), width * num_agents);
        return Err(SimError::Length { what: "realism gradient", got, expected });
    }
    let dot =
        |a: &[Real], b: &[Real]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
    let cosine: Vec<f64> = (0..num_agents)
        .map(|agent| {
            let (a, b) = (&realism[agent * width..][..width], &guidance[agent * width..][..width]);
            let lengths = (dot(a, a) * dot(b, b)).sqrt();
            if lengths > 0.0 { dot(a, b) / lengths } else { 0.0 }
        })
        .collect();
    let negative: Vec<f64> = cosine.iter().filter(|c| **c < 0.0).map(|c| -c).collect();
    let share = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
    Ok(GradientConflict {
        conflict_share: share(negative.len() as f64, num_agents),
        mean_negative_cosine: share(negative.iter().sum(), negative.len()),
        cosine,
    })
}

/// Pearson's correlation r of paired samples and its two-sided p value by Student's t with n - 2 degrees.
///
/// # Errors
/// [`SimError::Length`] where the samples differ in number or are fewer than three, [`SimError::Config`] where one of
/// them does not vary or is not finite.
pub fn pearson(x: &[f64], y: &[f64]) -> Result<(f64, f64)> {
    if x.len() != y.len() {
        return Err(SimError::Length { what: "y samples", got: y.len(), expected: x.len() });
    }
    if x.len() < 3 {
        return Err(SimError::Length { what: "samples", got: x.len(), expected: 3 });
    }
    let centred = |values: &[f64]| -> Vec<f64> {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| v - mean).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(p, q)| p * q).sum::<f64>();
    let (dx, dy) = (centred(x), centred(y));
    let lengths = (dot(&dx, &dx) * dot(&dy, &dy)).sqrt();
    if !(lengths.is_finite() && lengths > 0.0) {
        let expected = "finite samples that vary".into();
        return Err(SimError::Config { field: "samples".into(), got: "no variance".into(), expected });
    }
    let r = (dot(&dx, &dy) / lengths).clamp(-1.0, 1.0);
    let degrees = (x.len() - 2) as f64;
    Ok((r, regularised_beta(1.0 - r * r, degrees / 2.0, 0.5)))
}

/// Regularised incomplete beta function I_x(a, b) by its continued fraction (DLMF 8.17.22), modified Lentz.
fn regularised_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - regularised_beta(1.0 - x, b, a);
    }
    let log_front =
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * libm::log(x) + b * libm::log1p(-x);
    let guard = |v: f64| if v.abs() < 1e-300 { 1e-300 } else { v };
    let (mut c, mut d) = (1.0, 1.0 / guard(1.0 - (a + b) * x / (a + 1.0)));
    let mut fraction = d;
    for k in 1..1000 {
        let m = f64::from(k);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for term in [even, odd] {
            d = 1.0 / guard(1.0 + term * d);
            c = guard(1.0 + term / c);
            step = c * d;
            fraction *= step;
        }
        if (step - 1.0).abs() < 1e-15 {
            break;
        }
    }
    libm::exp(log_front) * fraction / a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_values_are_those_of_students_t() {
        // with one degree of freedom t is Cauchy's: p = 1 - 2 atan(t) / pi, t = r / sqrt(1 - r^2)
        let (r, p) = pearson(&[1.0, 2.0, 3.0], &[1.0, 3.0, 2.0]).unwrap();
        let t = r / (1.0 - r * r).sqrt();
        assert!((r - 0.5).abs() < 1e-12);
        assert!((p - (1.0 - 2.0 / std::f64::consts::PI * t.atan())).abs() < 1e-12);
        let (r, p) = pearson(&[1.0, 2.0, 3.0], &[-2.0, -4.0, -6.0]).unwrap();
        assert!(r == -1.0 && p < 1e-7);
        assert!(pearson(&[1.0; 3], &[1.0, 2.0, 3.0]).is_err());
    }
}
