//! Comfort distance (CFD): how far the accelerations and jerks of a rollout are from those of the log.

use super::Trajectories;
use crate::error::{Result, SimError};
use crate::named::named;
use crate::state::AgentStates;
use nalgebra::Vector2;

/// Bins of every histogram.
pub const HISTOGRAM_BINS: usize = 20;
/// Ranges of longitudinal acceleration, lateral acceleration (m/s2) and jerk (m/s3): [-limit, limit].
const LIMITS: [f64; 3] = [2.0, 2.0, 1.0];
/// Agents that start no faster than this are left out, metres per second.
const MOVING_MPS: f64 = 0.5;

named! {
    /// What longitudinal and lateral mean.
    pub enum ComfortAxes {
        /// The acceleration vector in the agent's own axes.
        Body = "body",
        /// Its length times cosine and sine of the heading in the world, as the release has it: no projection, and
        /// different in a turned world.
        ReferenceImpl = "reference_impl",
    }
}

impl Trajectories {
    /// Histograms of longitudinal acceleration, lateral acceleration and jerk, from positions `stride` steps apart: shares
    /// per bin, each row summing to 1; all zero where no agent moves.
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
    pub fn comfort(&self, axes: ComfortAxes, stride: usize) -> Result<[[f64; HISTOGRAM_BINS]; 3]> {
        if stride == 0 {
            return Err(SimError::config("stride", 0, "at least 1"));
        }
        let mut counts = [[0u64; HISTOGRAM_BINS]; 3];
        let dt_s = f64::from(self.dt_s) * stride as f64;
        let entries: Vec<&AgentStates> = self.states.iter().step_by(stride).collect();
        for agent in 0..self.num_agents() {
            for run in entries.chunk_by(|a, b| a.active[agent] && b.active[agent]) {
                if run.len() >= 2 {
                    count_run(run, agent, axes, dt_s, &mut counts);
                }
            }
        }
        Ok(counts.map(|row| {
            let total = row.iter().sum::<u64>().max(1);
            row.map(|count| count as f64 / total as f64)
        }))
    }
}

fn count_run(
    run: &[&AgentStates],
    agent: usize,
    axes: ComfortAxes,
    dt_s: f64,
    counts: &mut [[u64; HISTOGRAM_BINS]; 3],
) {
    let differences = |values: &[Vector2<f64>]| {
        let mut out: Vec<_> = values.windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).collect();
        out.insert(0, out[0]);
        out
    };
    let positions: Vec<_> = run.iter().map(|states| states.position(agent).coords.cast::<f64>()).collect();
    let velocity = differences(&positions);
    if velocity[0].norm() <= MOVING_MPS {
        return;
    }
    let acceleration = differences(&velocity);
    let size: Vec<f64> = acceleration.iter().map(|a| a.norm()).collect();
    for (k, states) in run.iter().enumerate() {
        let (cos, sin) = (f64::from(states.cos[agent]), f64::from(states.sin[agent]));
        let (longitudinal, lateral) = match axes {
            ComfortAxes::Body => {
                (acceleration[k].dot(&Vector2::new(cos, sin)), acceleration[k].dot(&Vector2::new(-sin, cos)))
            }
            ComfortAxes::ReferenceImpl => (size[k] * cos, size[k] * sin),
        };
        let jerk = (size[k.max(1)] - size[k.max(1) - 1]) / dt_s;
        for ((row, value), limit) in counts.iter_mut().zip([longitudinal, lateral, jerk]).zip(LIMITS) {
            if value.abs() <= limit {
                // the last bin holds its upper edge
                let bin = ((value + limit) / (2.0 * limit) * HISTOGRAM_BINS as f64) as usize;
                row[bin.min(HISTOGRAM_BINS - 1)] += 1;
            }
        }
    }
}
