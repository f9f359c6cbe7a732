//! The space that networks plan in, in plain numbers: normalised action knots, and what they say of actions and states.

use crate::config::ModelConfig;
use crate::guidance::KnotMap;
use crate::inputs::unicycle::rolled;
use ccdiff_sim::geom::Pose2;

/// Maps between normalised knots [R, knots, 2], physical actions [R, T, 2] and states [R, T, 6].
#[derive(Debug, Clone)]
pub struct PlanSpace {
    knots: KnotMap,
    steps: usize,
    dt_s: f32,
    mean: [f32; 6],
    std: [f32; 6],
}

impl PlanSpace {
    /// The space of a configuration.
    pub fn new(config: &ModelConfig) -> Self {
        let n = &config.normalisation;
        Self {
            knots: KnotMap::new(config),
            steps: config.horizon_steps,
            dt_s: config.dt_s as f32,
            mean: n.trajectory_mean.map(|v| v as f32),
            std: n.trajectory_std.map(|v| v as f32),
        }
    }

    /// Physical actions [R, T, 2] of normalised knots.
    pub fn actions(&self, knots: &[f32]) -> Vec<f32> {
        let width = self.knots.width();
        let mut actions = vec![0.0; knots.len() / width * self.steps * 2];
        for (row, out) in knots.chunks_exact(width).zip(actions.chunks_exact_mut(2 * self.steps)) {
            self.knots.actions(row, out);
        }
        actions
    }

    /// States x, y, v, yaw, acceleration, yaw rate [R, T, 6] of actions from the origin, heading +x, at speeds [R], which are
    /// repeated for more rows. The last two are the actions as given, not clipped.
    pub fn states(&self, actions: &[f32], speed_mps: &[f32]) -> Vec<f32> {
        let mut out = Vec::with_capacity(actions.len() * 3);
        for (row, start) in actions.chunks_exact(2 * self.steps).zip(speed_mps.iter().cycle()) {
            let moments = rolled(Pose2::new(0.0, 0.0, 0.0), *start, self.dt_s, row);
            for (m, action) in moments.zip(row.chunks_exact(2)) {
                out.extend([m.x_m, m.y_m, m.speed_mps, m.turned_rad, action[0], action[1]]);
            }
        }
        out
    }

    /// Trajectories in the units of the networks' inputs.
    pub fn standardised(&self, states: &mut [f32]) {
        for state in states.as_chunks_mut::<6>().0 {
            for c in 0..6 {
                state[c] = (state[c] - self.mean[c]) / self.std[c];
            }
        }
    }
}
