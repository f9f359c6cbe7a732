//! Speed above a limit.
//!
//! loss_i = mean over t of max(0, |v_i(t)| - limit). Gradient: sign(v) / T where above the limit.
//! Source: CTG's speed limit (reference.md#guidance); with a negative weight it is the paper's over-speed objective. The limit is
//! the objective's own, else the world's (`ccdiff_env.metrics.speed_limit`: 0.75 quantile of logged speeds above 1 m/s); the
//! loss is zero without either.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::{POSITIVE_MOTION, WEIGHT};

options! {
    /// Settings of the over-speed loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct OverSpeed {
        /// Signed weight; negative seeks speed.
        weight: f32 = -1.0, range WEIGHT;
        /// Limit; `None`: that of the world.
        limit_mps: Option<f32> = None, unit "m/s", range POSITIVE_MOTION;
    }
}

impl OverSpeed {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let Some(limit_mps) = self.limit_mps.or(context.speed_limit_mps) else { return };
        let share = 1.0 / plan.num_steps as f32;
        for agent in (0..context.num_agents()).filter(|a| out.wanted[*a]) {
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
