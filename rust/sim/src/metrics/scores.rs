//! The paper's scores: controllability (CS), realism (RS) and generational distances to the Pareto front.

use crate::error::{Result, SimError, check_length};

/// Least and largest value of a metric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least value: score 0.
    pub min: f64,
    /// Largest value: score 1.
    pub max: f64,
}

impl Bounds {
    /// Bounds of values, passing over those that are not finite; 0 and 0 where none is.
    pub fn of(values: &[f64]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let min = finite().fold(f64::INFINITY, f64::min);
        if min.is_infinite() {
            Self { min: 0.0, max: 0.0 }
        } else {
            Self { min, max: finite().fold(min, f64::max) }
        }
    }

    /// Position of a value between the bounds, not clipped; 0 for bounds that are equal.
    fn scale(&self, value: f64) -> f64 {
        let range = self.max - self.min;
        if range > 0.0 { (value - self.min) / range } else { 0.0 * value }
    }
}

/// Bounds of the four metrics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreBounds {
    /// Scene collision rate.
    pub scr: Bounds,
    /// Off-road rate.
    pub orr: Bounds,
    /// Final displacement error.
    pub fde: Bounds,
    /// Comfort distance.
    pub cfd: Bounds,
}

/// Scores (CS, RS) of every entry: CS = scaled SCR, RS = 1 - mean of scaled ORR, FDE and CFD.
///
/// Bounds are those of the whole arrays unless given, as in the paper, where methods and all columns share them: a
/// score depends on the set it is computed in. Values outside given bounds score below 0 or above 1.
///
/// # Errors
/// [`SimError::Length`] where the arrays differ in length.
///
/// # Reference
/// Paper, section on metrics; reference.md#scores.
pub fn scores(
    scr: &[f64],
    orr: &[f64],
    fde: &[f64],
    cfd: &[f64],
    bounds: Option<ScoreBounds>,
) -> Result<(Vec<f64>, Vec<f64>)> {
    for (what, got) in [("ORR", orr.len()), ("FDE", fde.len()), ("CFD", cfd.len())] {
        check_length(what, got, scr.len())?;
    }
    let own = || ScoreBounds {
        scr: Bounds::of(scr),
        orr: Bounds::of(orr),
        fde: Bounds::of(fde),
        cfd: Bounds::of(cfd),
    };
    let bounds = bounds.unwrap_or_else(own);
    let cs = scr.iter().map(|&v| bounds.scr.scale(v)).collect();
    let rs = (0..scr.len())
        .map(|k| {
            let parts = [bounds.orr.scale(orr[k]), bounds.fde.scale(fde[k]), bounds.cfd.scale(cfd[k])];
            1.0 - parts.iter().sum::<f64>() / 3.0
        })
        .collect();
    Ok((cs, rs))
}

type Point = [f64; 2];

/// Points that no other point beats: at least as good in both scores and better in one. Larger is better.
pub fn pareto_front(points: &[Point]) -> Vec<Point> {
    let beats = |a: &Point, b: &Point| a[0] >= b[0] && a[1] >= b[1] && a != b;
    points.iter().filter(|b| !points.iter().any(|a| beats(a, b))).copied().collect()
}

/// Root mean square over `from` of the distance to the nearest point of `to`.
fn mean_distance(from: &[Point], to: &[Point]) -> f64 {
    let squared = |a: &Point, b: &Point| {
        let (x, y) = (a[0] - b[0], a[1] - b[1]);
        x * x + y * y
    };
    let nearest = |a: &Point| to.iter().map(|b| squared(a, b)).fold(f64::INFINITY, f64::min);
    (from.iter().map(nearest).sum::<f64>() / from.len() as f64).sqrt()
}

/// Generational distance (GD) and its inverse (IGD) of every method to the Pareto front of all methods' points.
///
/// GD is the root mean square distance of the method's points to the front, IGD that of the front to the method's
/// points: q = 2. Smaller is better.
///
/// Differs from the paper: its formula subtracts `a` where it must mean `d` (reference.md#scores).
///
/// # Shapes
/// `cs`, `rs`: [methods, columns] of finite numbers, row-major.
///
/// # Errors
/// [`SimError::Length`] where the arrays are empty or do not hold `num_methods` rows each, [`SimError::Config`] for
/// values that are not finite.
///
/// # Reference
/// reference.md#scores.
pub fn generational_distance(num_methods: usize, cs: &[f64], rs: &[f64]) -> Result<(Vec<f64>, Vec<f64>)> {
    check_length("RS", rs.len(), cs.len())?;
    let num_columns = cs.len().checked_div(num_methods).unwrap_or(0);
    if num_columns == 0 || num_columns * num_methods != cs.len() {
        let expected = num_methods * num_columns.max(1);
        return Err(SimError::Length { what: "CS", got: cs.len(), expected });
    }
    if let Some(bad) = cs.iter().chain(rs).find(|v| !v.is_finite()) {
        return Err(SimError::config("scores", bad, "finite scores"));
    }
    let points: Vec<Point> = cs.iter().zip(rs).map(|(&c, &r)| [c, r]).collect();
    let front = pareto_front(&points);
    let of_method = |own: &[Point]| (mean_distance(own, &front), mean_distance(&front, own));
    Ok(points.chunks_exact(num_columns).map(of_method).unzip())
}
