//! Distance from a wanted position.
//!
//! loss_i = ‖p_i(t*) - g_i‖ with t* the given step, else the step at which the plan comes nearest. Gradient: the unit vector
//! from the goal at t*. Source: the target position (at a time) of released CCDiff (reference.md#guidance), whose formula is not
//! recorded there; this one is ours. The loss is zero for agents without a goal.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::{WEIGHT, within};

options! {
    /// Settings of the goal loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct Goal {
        /// Signed weight; positive seeks the goal.
        weight: f32 = 1.0, range WEIGHT;
        /// Step of the plan at which the goal counts, clamped to the last; `None`: whenever it is nearest.
        at_step: Option<usize> = None, range within(0.0, 1000.0);
    }
}

impl Goal {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        for agent in (0..context.num_agents()).filter(|a| out.wanted[*a]) {
            let Some(goal) = context.goals[agent] else { continue };
            let first = agent * plan.num_steps;
            let offset = |at: usize| (plan.x_m[at] - goal.x, plan.y_m[at] - goal.y);
            let distance = |at: usize| {
                let (x, y) = offset(at);
                (x * x + y * y).sqrt()
            };
            let steps = first..first + plan.num_steps;
            let at = match self.at_step {
                Some(step) => first + step.min(plan.num_steps - 1),
                None => steps.min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(first),
            };
            let ((x, y), distance_m) = (offset(at), distance(at));
            out.losses[agent] += distance_m;
            if distance_m > 0.0 {
                out.gradient.x[at] += out.scale * x / distance_m;
                out.gradient.y[at] += out.scale * y / distance_m;
            }
        }
    }
}
