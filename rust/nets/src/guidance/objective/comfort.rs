//! Lateral acceleration and jerk above their limits.
//!
//! loss_i = mean over t of max(0, |v_t·ω_t| / limit - 1) + max(0, |j_t| / limit - 1), with ω_t = (ψ_t - ψ_{t-1}) / dt and
//! j_t = (v_t - 2·v_{t-1} + v_{t-2}) / dt²; before the first step stand pose and speed of now, the jerk begins at the second.
//! Ours: neither the paper nor the release has such a term.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::geom::math;
use ccdiff_sim::options;
use ccdiff_sim::options::{POSITIVE_MOTION, WEIGHT, within};

options! {
    /// Settings of the comfort loss. The limits are those of nuPlan's comfort.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct Comfort {
        /// Signed weight; positive seeks comfort.
        weight: f32 = 1.0, range WEIGHT;
        /// Lateral acceleration that costs nothing.
        lateral_limit_mps2: f32 = 4.89, unit "m/s²", range POSITIVE_MOTION;
        /// Jerk along the heading that costs nothing.
        jerk_limit_mps3: f32 = 8.37, unit "m/s³", range within(0.0, 1000.0).open_below();
    }
}

impl Comfort {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let (num_steps, dt) = (plan.num_steps, context.dt_s);
        let share = 1.0 / num_steps as f32;
        for agent in (0..context.num_agents()).filter(|a| out.wanted[*a]) {
            let first = agent * num_steps;
            let (start, start_mps) = (&context.poses[agent], context.speed_mps[agent]);
            for t in 0..num_steps {
                let at = first + t;
                let (cos, sin) =
                    if t == 0 { (start.cos, start.sin) } else { (plan.cos[at - 1], plan.sin[at - 1]) };
                let turn_rad = math::atan2(
                    plan.sin[at] * cos - plan.cos[at] * sin,
                    plan.cos[at] * cos + plan.sin[at] * sin,
                );
                let lateral = plan.speed_mps[at] * turn_rad / dt;
                let over = lateral.abs() / self.lateral_limit_mps2 - 1.0;
                if over > 0.0 {
                    out.losses[agent] += share * over;
                    let slope = out.scale * share * lateral.signum() / (self.lateral_limit_mps2 * dt);
                    out.gradient.speed[at] += slope * turn_rad;
                    out.gradient.heading[at] += slope * plan.speed_mps[at];
                    if t > 0 {
                        out.gradient.heading[at - 1] -= slope * plan.speed_mps[at];
                    }
                }
                if t == 0 {
                    continue;
                }
                let before = if t == 1 { start_mps } else { plan.speed_mps[at - 2] };
                let jerk = (plan.speed_mps[at] - 2.0 * plan.speed_mps[at - 1] + before) / (dt * dt);
                let over = jerk.abs() / self.jerk_limit_mps3 - 1.0;
                if over > 0.0 {
                    out.losses[agent] += share * over;
                    let slope = out.scale * share * jerk.signum() / (self.jerk_limit_mps3 * dt * dt);
                    out.gradient.speed[at] += slope;
                    out.gradient.speed[at - 1] -= 2.0 * slope;
                    if t > 1 {
                        out.gradient.speed[at - 2] += slope;
                    }
                }
            }
        }
    }
}
