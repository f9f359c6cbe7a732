//! Comfort distance (CFD): how far the accelerations and jerks of a rollout are from those of the log.

use super::Trajectories;
use crate::error::{Result, SimError};
use crate::geom::{Vector2, math};

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
            return Err(SimError::config("stride", 0, "at least 1"));
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
