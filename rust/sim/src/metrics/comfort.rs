//! Comfort distance (CFD): how far the accelerations and jerks of a rollout are from those of the log.

use super::Trajectories;
use crate::error::{Result, SimError};
use crate::geom::{Real, Vector2, math};

/// Bins of every histogram.
pub const HISTOGRAM_BINS: usize = 20;
/// Ranges of longitudinal acceleration, lateral acceleration (m/s2) and jerk (m/s3): [-limit, limit].
const LIMITS: [f64; 3] = [2.0, 2.0, 1.0];
/// Agents that start no faster than this are left out, metres per second.
const MOVING_MPS: f64 = 0.5;

/// What longitudinal and lateral mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ComfortAxes {
    /// The acceleration vector in the agent's own axes.
    #[default]
    Body,
    /// Its length times cosine and sine of the heading in the world, as the release has it: no projection, and
    /// different in a turned world.
    ReferenceImpl,
}

/// Histograms of longitudinal acceleration, lateral acceleration and jerk.
#[derive(Debug, Clone, PartialEq)]
pub struct ComfortHistograms {
    /// Shares per bin; each row sums to 1, or to less where scenes without a moving agent are averaged in.
    pub rows: [[f64; HISTOGRAM_BINS]; 3],
}

impl ComfortHistograms {
    /// Histograms of one scene, from positions `stride` steps apart; all zero where no agent moves.
    ///
    /// Velocity, acceleration and jerk are differences of neighbouring entries; the first of each is repeated. An
    /// agent counts while it is there without a gap, for runs of two or more entries that start faster than
    /// 0.5 m/s. Values outside the ranges are dropped.
    ///
    /// # Errors
    /// [`SimError::Config`] for a stride of 0.
    ///
    /// # Reference
    /// reference.md#comfort-distance; the release uses 0.5 s between entries.
    pub fn from_motion(motion: &Trajectories<'_>, axes: ComfortAxes, stride: usize) -> Result<Self> {
        if stride == 0 {
            return Err(SimError::Config {
                field: "stride".into(),
                got: "0".into(),
                expected: "at least 1".into(),
            });
        }
        let mut counts = [[0u64; HISTOGRAM_BINS]; 3];
        let entries: Vec<usize> = (0..motion.num_steps()).step_by(stride).collect();
        for agent in 0..motion.num_agents() {
            for run in entries.chunk_by(|&a, &b| motion.is_valid(agent, a) && motion.is_valid(agent, b)) {
                if run.len() >= 2 {
                    count_run(motion, agent, run, axes, &mut counts);
                }
            }
        }
        let mut rows = [[0.0; HISTOGRAM_BINS]; 3];
        for (row, count) in rows.iter_mut().zip(&counts) {
            let total: u64 = count.iter().sum();
            if total > 0 {
                row.iter_mut().zip(count).for_each(|(share, &n)| *share = n as f64 / total as f64);
            }
        }
        Ok(Self { rows })
    }

    /// Mean over scenes; all zero without scenes.
    pub fn mean(scenes: &[Self]) -> Self {
        let mut rows = [[0.0; HISTOGRAM_BINS]; 3];
        for scene in scenes {
            for (row, of_scene) in rows.iter_mut().zip(&scene.rows) {
                row.iter_mut().zip(of_scene).for_each(|(mean, share)| *mean += share / scenes.len() as f64);
            }
        }
        Self { rows }
    }
}

fn count_run(
    motion: &Trajectories<'_>,
    agent: usize,
    run: &[usize],
    axes: ComfortAxes,
    counts: &mut [[u64; HISTOGRAM_BINS]; 3],
) {
    let dt_s = f64::from(motion.dt_s()) * (run[1] - run[0]) as f64;
    let differences = |values: &[nalgebra::Vector2<f64>]| {
        let mut out: Vec<_> = values.windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).collect();
        out.insert(0, out[0]);
        out
    };
    let positions: Vec<_> = run.iter().map(|&t| motion.position(agent, t).coords.cast::<f64>()).collect();
    let velocity = differences(&positions);
    if velocity[0].norm() <= MOVING_MPS {
        return;
    }
    let acceleration = differences(&velocity);
    let size: Vec<f64> = acceleration.iter().map(|a| a.norm()).collect();
    for (k, &step_idx) in run.iter().enumerate() {
        let (sin, cos) = math::sin_cos(motion.heading_rad(agent, step_idx));
        let (forward, left) = (Vector2::new(cos, sin).cast::<f64>(), Vector2::new(-sin, cos).cast::<f64>());
        let (longitudinal, lateral) = match axes {
            ComfortAxes::Body => (acceleration[k].dot(&forward), acceleration[k].dot(&left)),
            ComfortAxes::ReferenceImpl => (size[k] * forward.x, size[k] * forward.y),
        };
        let jerk = (size[k.max(1)] - size[k.max(1) - 1]) / dt_s;
        for (row, value) in [longitudinal, lateral, jerk].into_iter().enumerate() {
            if let Some(bin) = bin_of(value, LIMITS[row]) {
                counts[row][bin] += 1;
            }
        }
    }
}

/// Bin of a value in [-limit, limit]; the last bin holds its upper edge.
fn bin_of(value: f64, limit: f64) -> Option<usize> {
    if value.is_nan() || value.abs() > limit {
        return None;
    }
    let bin = ((value + limit) / (2.0 * limit) * HISTOGRAM_BINS as f64) as usize;
    Some(bin.min(HISTOGRAM_BINS - 1))
}

/// Distances of two sets of histograms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComfortDistance {
    /// Earth mover's distances of longitudinal acceleration, lateral acceleration (m/s2) and jerk (m/s3).
    pub rows: [Real; 3],
    /// Their mean: the CFD, not scaled. (The paper's figures are near 100 times this.)
    pub mean: Real,
}

/// Earth mover's distances between histograms, each scaled to a sum of 1 first.
///
/// In one dimension that is the sum of the differences of the cumulative shares times the width of a bin. A row
/// without any mass is infinitely far from everything.
pub fn comfort_distance(one: &ComfortHistograms, other: &ComfortHistograms) -> ComfortDistance {
    let mut rows = [0.0; 3];
    for (k, distance) in rows.iter_mut().enumerate() {
        let (a, b) = (&one.rows[k], &other.rows[k]);
        let (total_a, total_b) = (a.iter().sum::<f64>(), b.iter().sum::<f64>());
        if total_a <= 0.0 || total_b <= 0.0 {
            *distance = f64::INFINITY;
            continue;
        }
        let width = 2.0 * LIMITS[k] / HISTOGRAM_BINS as f64;
        let mut ahead = 0.0;
        for bin in 0..HISTOGRAM_BINS {
            ahead += a[bin] / total_a - b[bin] / total_b;
            *distance += ahead.abs() * width;
        }
    }
    ComfortDistance { rows: rows.map(|d| d as Real), mean: (rows.iter().sum::<f64>() / 3.0) as Real }
}

#[cfg(test)]
mod tests {
    use super::super::motion::Recorded;
    use super::*;

    /// Check values of reference.md#comfort-distance, in units of 1e-5; their rounding moves distances by up to 2e-5.
    fn reference() -> ComfortHistograms {
        let rows = [
            [
                1160, 962, 1362, 2134, 2514, 3192, 4719, 6093, 8046, 29474, 12830, 6628, 4835, 4294, 2584,
                2104, 1994, 1384, 941, 750,
            ],
            [
                616, 714, 1093, 1760, 2618, 3091, 3580, 5131, 6850, 27572, 15541, 8467, 5819, 4530, 3352,
                2382, 1890, 1243, 1222, 531,
            ],
            [
                1695, 2061, 2290, 2448, 3121, 3411, 2834, 4064, 3286, 29861, 9125, 5044, 5407, 4047, 3823,
                3608, 3184, 2612, 3366, 2713,
            ],
        ];
        ComfortHistograms { rows: rows.map(|row| row.map(|v| f64::from(v) * 1e-5)) }
    }

    fn assert_distances(histograms: &ComfortHistograms, rows: [f32; 3], mean: f32) {
        let got = comfort_distance(histograms, &reference());
        for (g, e) in got.rows.iter().zip(rows) {
            assert!((g - e).abs() < 3e-5, "{g}, expected {e}");
        }
        assert!((got.mean - mean).abs() < 3e-5, "{}, expected {mean}", got.mean);
    }

    #[test]
    fn distances_to_the_known_histograms_are_the_known_ones() {
        let mut still = ComfortHistograms { rows: [[0.0; 20]; 3] };
        still.rows.iter_mut().for_each(|row| row[10] = 0.7);
        assert_distances(&still, [0.50170, 0.46815, 0.32323], 0.43103);
        let uniform = ComfortHistograms { rows: [[0.05; 20]; 3] };
        assert_distances(&uniform, [0.54179, 0.54828, 0.18916], 0.42641);
        let [lon, lat, jerk] = reference().rows;
        let swapped = ComfortHistograms { rows: [lat, lon, jerk] };
        let both = comfort_distance(&swapped, &reference());
        assert!((both.rows[0] - 0.06666).abs() < 1e-5 && (both.rows[1] - 0.06666).abs() < 1e-5);
        assert_eq!(both.rows[2], 0.0);
    }

    #[test]
    fn constant_velocity_lies_in_the_bin_above_zero_and_slow_agents_do_not_count() {
        let fast = (0..31).map(|t| Some((t as f32, 0.0, 0.4))).collect();
        let slow = (0..31).map(|t| Some((t as f32 * 0.04, 9.0, 0.0))).collect();
        let recorded = Recorded::new(&[fast, slow]);
        for axes in [ComfortAxes::Body, ComfortAxes::ReferenceImpl] {
            let h = ComfortHistograms::from_motion(&recorded.motion(0.1), axes, 5).unwrap();
            assert!(h.rows.iter().all(|row| row[10] == 1.0));
        }
        assert!(ComfortHistograms::from_motion(&recorded.motion(0.1), ComfortAxes::Body, 0).is_err());
    }

    #[test]
    fn body_axes_do_not_change_with_the_world_and_parity_axes_do() {
        // brakes at 1.1 m/s2 straight ahead, once along x and once along y
        let s = |t: f32| 10.0 * t - 0.55 * t * t;
        let along = |turn: f32| {
            let (sin, cos) = turn.sin_cos();
            let track = (0..41).map(|k| s(k as f32 * 0.1)).map(|d| Some((d * cos, d * sin, turn))).collect();
            Recorded::new(&[track])
        };
        let (east, north) = (along(0.0), along(std::f32::consts::FRAC_PI_2));
        let of = |r: &Recorded, axes| ComfortHistograms::from_motion(&r.motion(0.1), axes, 5).unwrap();
        assert_eq!(of(&east, ComfortAxes::Body).rows[0], of(&north, ComfortAxes::Body).rows[0]);
        // rounding puts the lateral zeros on either side of 0
        assert!(of(&north, ComfortAxes::Body).rows[1][9..=10].iter().sum::<f64>() > 0.999);
        // -1.1 lies in bin 4, the two repeated zeros in bin 10
        assert!((of(&east, ComfortAxes::Body).rows[0][4] - 7.0 / 9.0).abs() < 1e-12);
        assert!(of(&east, ComfortAxes::ReferenceImpl).rows[0][15] > 0.7);
        assert!(of(&north, ComfortAxes::ReferenceImpl).rows[1][15] > 0.7);
    }

    #[test]
    fn means_over_scenes_keep_empty_scenes() {
        let empty = ComfortHistograms { rows: [[0.0; 20]; 3] };
        let full = ComfortHistograms { rows: [[0.05; 20]; 3] };
        let mean = ComfortHistograms::mean(&[empty.clone(), full]);
        assert!((mean.rows[0].iter().sum::<f64>() - 0.5).abs() < 1e-12);
        assert!(comfort_distance(&empty, &mean).mean.is_infinite());
    }
}
