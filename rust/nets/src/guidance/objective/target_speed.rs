//! Distance from a wanted speed.
//!
//! loss_i = mean over t of |v_i(t) - v*_i|. Gradient: sign(v - v*) / T. Source: released CCDiff's target speed
//! (reference.md#guidance). The speed is the world's for that agent, else the objective's; the loss is zero without either.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::{MOTION, WEIGHT};

options! {
    /// Settings of the target-speed loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct TargetSpeed {
        /// Signed weight; positive seeks the speed.
        weight: f32 = 1.0, range WEIGHT;
        /// Speed of agents without one of their own; `None`: these seek none.
        speed_mps: Option<f32> = None, unit "m/s", range MOTION;
    }
}

impl TargetSpeed {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let share = 1.0 / plan.num_steps as f32;
        for agent in (0..context.num_agents()).filter(|a| out.wanted[*a]) {
            let Some(wanted_mps) = context.target_speed_mps[agent].or(self.speed_mps) else { continue };
            for at in agent * plan.num_steps..(agent + 1) * plan.num_steps {
                let off_mps = plan.speed_mps[at] - wanted_mps;
                if off_mps != 0.0 {
                    out.losses[agent] += share * off_mps.abs();
                    out.gradient.speed[at] += out.scale * share * off_mps.signum();
                }
            }
        }
    }
}
