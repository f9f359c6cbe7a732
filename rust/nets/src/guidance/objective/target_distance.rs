//! STRIVE's adversarial objective: whoever can come nearest to the target is drawn to it (rivals.md#strive).
//!
//! With d_it the distance of the centres of attacker i and of the nearest target at step t, and w the soft minimum of d
//! over all attackers and steps from `from_s` on: loss_i = Σ_t w_it d_it², w_it = exp(-d_it) / Σ exp(-d). Attackers are the
//! guided agents that move and are no targets; those that are behind the target all the time do not count.
//! Gradient of the sum: w_it (2 d_it - d_it² + Σ w d²) along the line from the target; none for the target.
//! Source: STRIVE (Rempe et al., CVPR 2022), L_adv. Differs from it: its other terms are this method's own objectives.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::options;
use ccdiff_sim::options::{WEIGHT, within};

options! {
    /// Settings of the distance to the target. Without `collision_targets` nobody is the target, and nobody is drawn.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct TargetDistance {
        /// Signed weight; positive draws the attacker to the target.
        weight: f32 = 2.0, range WEIGHT;
        /// Time of the plan from which on distances count.
        from_s: f32 = 2.0, unit "s", range within(0.0, 1000.0);
    }
}

/// An attacker at a step, and where its target is from there.
struct Reach {
    at: usize,
    agent: usize,
    /// From the target to the attacker, metres.
    offset_m: (f32, f32),
    distance_m: f32,
}

impl TargetDistance {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        let targets: Vec<usize> = (0..context.num_agents()).filter(|a| context.partner[*a]).collect();
        let first = ((self.from_s / context.dt_s).round() as usize).min(plan.num_steps.saturating_sub(1));
        let attacks = |a: &usize| context.guided[*a] && context.moving[*a] && !context.partner[*a];
        let mut reaches = Vec::new();
        for agent in (0..context.num_agents()).filter(attacks) {
            let of_agent = (first..plan.num_steps).filter_map(|t| {
                let at = agent * plan.num_steps + t;
                let to = |target: &usize| {
                    let there = target * plan.num_steps + t;
                    let offset_m = (plan.x_m[at] - plan.x_m[there], plan.y_m[at] - plan.y_m[there]);
                    let ahead_m = offset_m.0 * plan.cos[there] + offset_m.1 * plan.sin[there];
                    let distance_m = (offset_m.0 * offset_m.0 + offset_m.1 * offset_m.1).sqrt();
                    (Reach { at, agent, offset_m, distance_m }, ahead_m >= 0.0)
                };
                targets
                    .iter()
                    .filter(|target| !context.is_apart(agent, **target))
                    .map(to)
                    .min_by(|(a, _), (b, _)| a.distance_m.total_cmp(&b.distance_m))
            });
            let of_agent: Vec<(Reach, bool)> = of_agent.collect();
            if of_agent.iter().any(|(_, ahead)| *ahead) {
                reaches.extend(of_agent.into_iter().map(|(reach, _)| reach));
            }
        }
        let weights = soft_minimum(&reaches.iter().map(|r| r.distance_m).collect::<Vec<_>>());
        let total: f32 = reaches.iter().zip(&weights).map(|(r, w)| w * r.distance_m * r.distance_m).sum();
        for (reach, weight) in reaches.iter().zip(&weights).filter(|(r, _)| out.wanted[r.agent]) {
            let d = reach.distance_m;
            out.losses[reach.agent] += weight * d * d;
            if d > 0.0 {
                let derivative = out.scale * weight * (2.0 * d - d * d + total) / d;
                out.gradient.x[reach.at] += derivative * reach.offset_m.0;
                out.gradient.y[reach.at] += derivative * reach.offset_m.1;
            }
        }
    }
}

/// exp(-d) over their sum.
fn soft_minimum(distances_m: &[f32]) -> Vec<f32> {
    let least = distances_m.iter().copied().fold(f32::MAX, f32::min);
    let powers: Vec<f32> = distances_m.iter().map(|d| (least - d).exp()).collect();
    let sum: f32 = powers.iter().sum();
    powers.iter().map(|p| p / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The figures were computed in float64 from the formula, apart from this code.
    #[test]
    fn the_nearest_attacker_and_step_has_nearly_all_of_the_weight() {
        let distances_m = [10.0, 6.0, 5f32.sqrt(), 20.0, 18.0, 16.0];
        let weights = soft_minimum(&distances_m);
        for (got, want) in weights.iter().zip([0.000415, 0.022657, 0.976927]) {
            assert!((got - want).abs() < 1e-5, "{got}, expected {want}");
        }
        assert!(weights[3..].iter().all(|w| *w < 2e-6));
        let loss: f32 = weights.iter().zip(distances_m).map(|(w, d)| w * d * d).sum();
        assert!((loss - 5.742108).abs() < 1e-4, "{loss}");
        assert!(soft_minimum(&[]).is_empty());
    }
}
