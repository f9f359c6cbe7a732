//! Speed above a limit.
//!
//! loss_i = mean over t of max(0, |v_i(t)| - limit). Gradient: sign(v) / T where above the limit.
//! Source: CTG's speed limit (reference.md#guidance); with a negative weight it is the paper's over-speed objective. The limit is
//! the objective's own, else the world's (`ccdiff_env.metrics.speed_limit`: 0.75 quantile of logged speeds above 1 m/s); the
//! loss is zero without either.

use super::Evaluation;
use crate::guidance::rollout::Rollout;
use crate::guidance::situation::Situation;
use serde::{Deserialize, Serialize};

/// Settings of the over-speed loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OverSpeed {
    /// Signed weight; negative seeks speed.
    pub weight: f32,
    /// Limit, metres per second; `None`: that of the world.
    pub limit_mps: Option<f32>,
}

impl Default for OverSpeed {
    fn default() -> Self {
        Self { weight: -1.0, limit_mps: None }
    }
}

impl OverSpeed {
    pub(super) fn evaluate(&self, situation: &Situation<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let Some(limit_mps) = self.limit_mps.or(situation.speed_limit_mps) else { return };
        let share = 1.0 / plan.num_steps as f32;
        for agent in (0..situation.num_agents()).filter(|a| out.wanted[*a]) {
            for at in agent * plan.num_steps..(agent + 1) * plan.num_steps {
                let over_mps = plan.speed_mps[at].abs() - limit_mps;
                if over_mps > 0.0 {
                    out.losses[agent] += share * over_mps;
                    out.gradient.speed[at] += out.scale * share * plan.speed_mps[at].signum();
                }
            }
        }
    }
}
