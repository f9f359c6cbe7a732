//! Closeness of vehicles, with a gradient before contact.
//!
//! Differs from the paper: ours. The collision loss of the paper has no gradient until two bodies are within 0.2 m of
//! touching, so with a negative weight it can only deepen a contact that a sample already has (reference.md#guidance).
//!
//! With c_ij(t) the distances of the disks' centres (all pairs of disks, not the nearest alone, so that it is smooth):
//! loss_i = (1/M) Σ_j Σ_t w_t mean over disk pairs of max(0, 1 - c_ij(t) / 20 m)³, w_t = γ^t / Σ γ^t; 0 for agents that
//! stand now. Between 0 (all beyond the reach) and 1; the gradient grows towards contact, and is continuous.

use super::Evaluation;
use super::disks::{Disks, PER_VEHICLE, for_pairs};
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::WEIGHT;

/// Distance of the centres of disks beyond which there is no pull, metres.
const REACH_M: f32 = 20.0;

options! {
    /// Settings of the closeness loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct Approach {
        /// Signed weight; negative draws vehicles together.
        weight: f32 = -10.0, range WEIGHT;
    }
}

impl Approach {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let disks = Disks::new(context, plan);
        let share = 1.0 / (context.num_agents().max(1) * PER_VEHICLE * PER_VEHICLE) as f32;
        let wanted = out.wanted;
        for_pairs(context, wanted, |(i, j), moves| {
            let reach_m = REACH_M + disks.reach_m[i] + disks.reach_m[j];
            if !disks.may_meet(i, j, reach_m) {
                return;
            }
            let both = f32::from(u8::from(moves.0)) + f32::from(u8::from(moves.1));
            let mut closeness = 0.0;
            for t in 0..plan.num_steps {
                let sign = context.sign(self.weight, &plan.speed_mps, (i, j), t);
                if sign == 0.0 {
                    continue;
                }
                let weight = sign * share * context.step_weights[t];
                for pair in disks.pairs(plan, (i, j), t).filter(|p| p.distance_m < REACH_M) {
                    let near = 1.0 - pair.distance_m / REACH_M;
                    closeness += weight * near * near * near;
                    let derivative = -3.0 * out.scale * both * weight * near * near / REACH_M;
                    pair.add_gradient(plan, (i, j), t, derivative, moves, out);
                }
            }
            for (agent, moves) in [(i, moves.0), (j, moves.1)] {
                if moves {
                    out.losses[agent] += closeness;
                }
            }
        });
    }
}
