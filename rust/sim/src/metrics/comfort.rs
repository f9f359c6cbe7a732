//! Comfort distance (CFD): how far the accelerations and jerks of a rollout are from those of the log.

use super::Trajectories;
use crate::error::{Result, SimError};
use crate::events::limits::{ACCELERATION_MPS2, JERK_MPS3};
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
    /// How many accelerations along its heading every agent has, how many of them are outside of [`ACCELERATION_MPS2`], and how
    /// many of its jerks are beyond [`JERK_MPS3`], nuPlan's limits of comfort, [A].
    ///
    /// Speeds along the heading are differences of neighbouring positions, accelerations the means of three of theirs, jerks
    /// differences of those; runs in which the agent is there without a gap.
    ///
    /// Differs from nuPlan: means of three in place of a Savitzky-Golay filter, which would need longer runs.
    pub fn harsh_motion(&self) -> Vec<[u32; 3]> {
        let dt_s = f64::from(self.dt_s);
        let differences = |values: &[f64]| -> Vec<f64> {
            values.windows(2).map(|pair| (pair[1] - pair[0]) / dt_s).collect()
        };
        let of_agent = |agent: usize| {
            let mut counts = [0; 3];
            for run in self.states.chunk_by(|a, b| a.active[agent] && b.active[agent]) {
                let along = |pair: &[AgentStates]| {
                    let way = (pair[1].position(agent) - pair[0].position(agent)).cast::<f64>();
                    let (cos, sin) = (f64::from(pair[0].cos[agent]), f64::from(pair[0].sin[agent]));
                    (way.x * cos + way.y * sin) / dt_s
                };
                let speed: Vec<f64> = run.windows(2).map(along).collect();
                let mean = |three: &[f64]| (three[0] + three[1] + three[2]) / 3.0;
                let smooth: Vec<f64> = differences(&speed).windows(3).map(mean).collect();
                let jerk = differences(&smooth);
                let [least, most] = ACCELERATION_MPS2.map(f64::from);
                counts[0] += smooth.len() as u32;
                counts[1] += smooth.iter().filter(|a| **a < least || **a > most).count() as u32;
                counts[2] += jerk.iter().filter(|j| j.abs() > f64::from(JERK_MPS3)).count() as u32;
            }
            counts
        };
        (0..self.num_agents()).map(of_agent).collect()
    }

    /// Histograms of longitudinal acceleration, lateral acceleration and jerk, from positions `stride` steps apart: shares
    /// per bin, each row summing to 1; all zero where no agent moves.
    ///
    /// Velocity, acceleration and jerk are differences of neighbouring entries; the first of each is repeated. An
    /// agent counts while it is there without a gap, for runs of two or more entries that start faster than
    /// 0.5 m/s. Values outside the ranges count in the `end_bins`, or are dropped, as the release has it.
    ///
    /// # Errors
    /// [`SimError::Config`] for a stride of 0.
    ///
    /// # Reference
    /// reference.md#comfort-distance; the release uses 0.5 s between entries.
    pub fn comfort(
        &self,
        axes: ComfortAxes,
        end_bins: bool,
        stride: usize,
    ) -> Result<[[f64; HISTOGRAM_BINS]; 3]> {
        if stride == 0 {
            return Err(SimError::config("stride", 0, "at least 1"));
        }
        let mut counts = [[0u64; HISTOGRAM_BINS]; 3];
        let dt_s = f64::from(self.dt_s) * stride as f64;
        let entries: Vec<&AgentStates> = self.states.iter().step_by(stride).collect();
        for agent in 0..self.num_agents() {
            for run in entries.chunk_by(|a, b| a.active[agent] && b.active[agent]) {
                if run.len() >= 2 {
                    count_run(run, agent, (axes, end_bins), dt_s, &mut counts);
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
    (axes, end_bins): (ComfortAxes, bool),
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
            if value.abs() <= limit || end_bins {
                // the last bin holds its upper edge; what is below the first one becomes 0 in the cast
                let bin = ((value + limit) / (2.0 * limit) * HISTOGRAM_BINS as f64) as usize;
                row[bin.min(HISTOGRAM_BINS - 1)] += 1;
            }
        }
    }
}
