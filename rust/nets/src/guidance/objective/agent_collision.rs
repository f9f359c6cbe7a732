//! Overlap of vehicles as disks, as released (reference.md#guidance).
//!
//! D_ij = W_i/2 + W_j/2 + buffer; d_ij(t) = least distance of their disks; pen_ij(t) = max(0, 1 - d_ij(t) / D_ij);
//! loss_i = (1/M) Σ_j Σ_t w_t pen_ij(t), w_t = γ^t / Σ γ^t; 0 for agents that stand now.
//! Gradient: ∂pen/∂d = -1/D through the nearest pair of disks; none before the disks are within the buffer.
//! Source: released CCDiff (2 disks, buffer 0.2 m).

use super::Evaluation;
use super::disks::{Disks, for_pairs};
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::{WEIGHT, within};

options! {
    /// Settings of the collision loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct AgentCollision {
        /// Signed weight; negative seeks collisions.
        weight: f32 = -50.0, range WEIGHT;
        /// Added to the distance at which disks touch.
        buffer_m: f32 = 0.2, unit "m", range within(0.0, 100.0);
    }
}

impl AgentCollision {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let disks = Disks::new(context, plan);
        let share = 1.0 / context.num_agents().max(1) as f32;
        let wanted = out.wanted;
        for_pairs(context, wanted, |(i, j), moves| {
            let touch_m = 0.5 * (context.width_m[i] + context.width_m[j]) + self.buffer_m;
            let reach_m = touch_m + disks.reach_m[i] + disks.reach_m[j];
            if !disks.may_meet(i, j, reach_m) {
                return;
            }
            let both = f32::from(u8::from(moves.0)) + f32::from(u8::from(moves.1));
            let mut penalty = 0.0;
            for t in 0..plan.num_steps {
                let sign = context.sign(self.weight, &plan.speed_mps, (i, j), t);
                if sign == 0.0 {
                    continue;
                }
                let (at_i, at_j) = (i * plan.num_steps + t, j * plan.num_steps + t);
                let (dx, dy) = (plan.x_m[at_j] - plan.x_m[at_i], plan.y_m[at_j] - plan.y_m[at_i]);
                if dx * dx + dy * dy > reach_m * reach_m {
                    continue;
                }
                let nearest =
                    disks.pairs(plan, (i, j), t).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
                let Some(pair) = nearest.filter(|p| p.distance_m <= touch_m) else { continue };
                let weight = sign * share * context.step_weights[t];
                penalty += weight * (1.0 - pair.distance_m / touch_m);
                let derivative = -out.scale * both * weight / touch_m;
                pair.add_gradient(plan, (i, j), t, derivative, moves, out);
            }
            for (agent, moves) in [(i, moves.0), (j, moves.1)] {
                if moves {
                    out.losses[agent] += penalty;
                }
            }
        });
    }
}
