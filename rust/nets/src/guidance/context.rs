//! What guidance knows about one world: poses and sizes of its agents, those that are guided, the road.

use crate::config::ModelConfig;
use crate::inputs::features::{SceneFeatures, Window};
use ccdiff_sim::geom::{Pose2, Region};
use std::sync::{Arc, OnceLock};

/// Agents at or below this speed now take no part in collision losses and are not moved by them (as released).
pub const MOVING_MPS: f32 = 0.5;

/// Guidance of one world, as the caller knows it. A is the number of agents in the window.
#[derive(Debug, Clone, Copy)]
pub struct WorldGuidance<'a> {
    /// Whose plans are moved, [A].
    pub guided: &'a [bool],
    /// Share of the configured learning rate, at least 0.
    pub guidance_scale: f32,
    /// Where vehicles may drive; map collision is zero without.
    pub road: Option<&'a Region>,
    /// The road of each agent's own level, [A], in place of `road`.
    pub roads: Option<&'a [Option<&'a Region>]>,
    /// If given, only contacts with one of these agents count, [A]: such as the ego.
    pub collision_targets: Option<&'a [bool]>,
    /// Speed limit of the scene, metres per second, for objectives without one of their own.
    pub speed_limit_mps: Option<f32>,
    /// Whether collision losses count standing agents as well: a draw may start them.
    pub starts: bool,
}

impl<'a> WorldGuidance<'a> {
    /// Guides these agents, with nothing else known.
    pub fn new(guided: &'a [bool]) -> Self {
        Self {
            guided,
            guidance_scale: 1.0,
            road: None,
            roads: None,
            collision_targets: None,
            speed_limit_mps: None,
            starts: false,
        }
    }
}

/// One world as the objectives see it: the M agents that are planned for.
#[derive(Debug, Clone)]
pub struct GuidanceContext<'a> {
    /// Steps T of a plan.
    pub num_steps: usize,
    /// Time between steps, seconds.
    pub dt_s: f32,
    /// Poses now, scene frame, [M].
    pub poses: Vec<Pose2>,
    /// Speeds now, [M].
    pub speed_mps: Vec<f32>,
    /// Lengths, metres, [M].
    pub length_m: Vec<f32>,
    /// Widths, metres, [M].
    pub width_m: Vec<f32>,
    /// Whether the agent is faster than [`MOVING_MPS`] now, or may start, [M].
    pub moving: Vec<bool>,
    /// Whether the agent's plan is moved, [M].
    pub guided: Vec<bool>,
    /// Share of the configured learning rate.
    pub guidance_scale: f32,
    /// Whether contacts with the agent count, [M].
    pub partner: Vec<bool>,
    /// Where each agent may drive, [M].
    pub roads: Vec<Option<&'a Region>>,
    /// Which pairs of agents are on different levels, [M, M]; empty: none.
    pub apart: Vec<bool>,
    /// Speed limit.
    pub speed_limit_mps: Option<f32>,
    /// γ^t over their sum, [T].
    pub step_weights: Vec<f32>,
    /// Speed below which the target of a guided agent does not count at a step.
    pub least_target_mps: f32,
    /// Whether a slower target is avoided, and one that is slower now as well: one of those that were named.
    pub spares: bool,
    /// What went wrong first in a loss of the user's own.
    pub failure: Arc<OnceLock<String>>,
}

impl<'a> GuidanceContext<'a> {
    /// The agents of a scene's features; the guidance's discount, the steps that its losses look at, and the speed of targets.
    pub fn new(
        guide: &WorldGuidance<'a>,
        window: &Window,
        features: &SceneFeatures,
        model: &ModelConfig,
        (discount, seen_steps, least_target_mps): (f32, Option<usize>, f32),
    ) -> Self {
        let rows = &features.agents;
        Self {
            num_steps: model.horizon_steps,
            dt_s: model.dt_s as f32,
            poses: features.poses.clone(),
            speed_mps: features.speed_mps.clone(),
            length_m: rows.iter().map(|a| window.length_m[*a]).collect(),
            width_m: rows.iter().map(|a| window.width_m[*a]).collect(),
            moving: features.speed_mps.iter().map(|v| guide.starts || v.abs() > MOVING_MPS).collect(),
            guided: rows.iter().map(|a| guide.guided[*a]).collect(),
            guidance_scale: guide.guidance_scale,
            partner: rows.iter().map(|a| guide.collision_targets.is_none_or(|p| p[*a])).collect(),
            roads: rows.iter().map(|a| guide.roads.map_or(guide.road, |roads| roads[*a])).collect(),
            apart: window.apart_of(rows),
            speed_limit_mps: guide.speed_limit_mps,
            step_weights: step_weights(discount, model.horizon_steps, seen_steps),
            least_target_mps,
            spares: guide.collision_targets.is_some(),
            failure: Arc::default(),
        }
    }

    /// Keeps what went wrong, unless something did before.
    pub fn fail(&self, what: String) {
        self.failure.get_or_init(|| what);
    }

    /// Number of agents M.
    pub fn num_agents(&self) -> usize {
        self.poses.len()
    }

    /// How the contact of a pair counts at a step of plans with speeds [M, T]: as it is weighted (1), not (0), or against its weight
    /// (-1). A weight that seeks contacts seeks none with a target slower than `least_target_mps`, and avoids it if targets were named.
    pub fn sign(&self, weight: f32, speed_mps: &[f32], (i, j): (usize, usize), t: usize) -> f32 {
        if weight >= 0.0 || self.least_target_mps <= 0.0 {
            return 1.0;
        }
        let of = |by: usize, target: usize| {
            let planned_mps = speed_mps[target * self.num_steps + t].abs();
            let stands_now = self.spares && self.speed_mps[target].abs() < self.least_target_mps;
            match planned_mps < self.least_target_mps || stands_now {
                _ if !(self.guided[by] && self.partner[target]) => 0.0,
                false => 1.0,
                true if self.spares => -1.0,
                true => 0.0,
            }
        };
        let (one, other): (f32, f32) = (of(i, j), of(j, i));
        if one > 0.0 || other > 0.0 { 1.0 } else { one.min(other) }
    }

    /// Whether two agents are on different levels.
    pub fn is_apart(&self, i: usize, j: usize) -> bool {
        self.apart.get(i * self.num_agents() + j).copied().unwrap_or(false)
    }
}

/// γ^t / Σ γ^t for t in 0..T, 0 for steps that losses do not look at.
fn step_weights(discount: f32, num_steps: usize, seen_steps: Option<usize>) -> Vec<f32> {
    let powers: Vec<f64> = (0..num_steps).map(|t| f64::from(discount).powi(t as i32)).collect();
    let (sum, seen) = (powers.iter().sum::<f64>(), seen_steps.unwrap_or(num_steps));
    powers.iter().enumerate().map(|(t, p)| if t < seen { (p / sum) as f32 } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::step_weights;

    /// The figures were computed in float64 from the formula, apart from this code.
    #[test]
    fn discounted_steps_have_the_tabulated_weights() {
        for (discount, want) in [
            (0.9, [0.100_419, 0.059_297, 4.6578e-4]),
            (0.98, [0.030_757, 0.027_802, 0.010_977]),
            (0.99, [0.024_568, 0.024_568 * 0.99f32.powi(5), 0.014_715]),
        ] {
            let weights = step_weights(discount, 52, None);
            for (step, want) in [0, 5, 51].into_iter().zip(want) {
                assert!((weights[step] - want).abs() < 2e-6, "{discount} at {step}: {}", weights[step]);
            }
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        }
    }
}
