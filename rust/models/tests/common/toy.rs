//! Vehicles made by hand, as guidance sees them.

#![allow(dead_code, reason = "not every test file uses all of it")]

use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::vehicles;
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::guidance::{
    Evaluation, GuidanceConfig, GuidanceContext, KnotMap, Objective, Rollout, StateGradient, WorldGuidance,
};

pub(crate) const T: usize = 52;

/// Two vehicles that pass each other 0.6 m apart, and a third that stays away.
pub(crate) const NEAR_MISS: [[f32; 5]; 3] =
    [[0.0, 0.0, 0.0, 8.0, 0.0], [80.0, 2.5, std::f32::consts::PI, 6.0, 0.0], [20.0, -30.0, 0.0, 7.0, 0.0]];

pub(crate) const BOTH_WAYS: [[f32; 5]; 4] = [
    [0.0, 0.0, 0.4, 6.0, 0.0],
    [30.0, 2.0, 3.0, 3.0, 0.1],
    [10.0, -5.0, 1.7, 0.0, 0.0],
    [-9.0, 4.0, -0.2, 9.0, -0.4],
];

/// Vehicles as the models see them at one step.
pub(crate) struct Toy {
    pub(crate) window: Window,
    pub(crate) features: SceneFeatures,
    pub(crate) model: ModelConfig,
}

/// `vehicles` are (x, y, heading, speed, acceleration) 4 s before now.
pub(crate) fn toy(list: &[[f32; 5]], model: ModelConfig) -> Toy {
    let model = ModelConfig { map: None, ..model };
    let scene = super::scene(list, 110);
    let window = Window::from_scene(&scene, 40, &vehicles(&scene), model.history_steps);
    let features = features::build(&window, None, &model).unwrap();
    Toy { window, features, model }
}

impl Toy {
    pub(crate) fn context<'a>(
        &self,
        guide: &WorldGuidance<'a>,
        config: &GuidanceConfig,
    ) -> GuidanceContext<'a> {
        let steps = (config.discount, config.seen_steps, config.least_target_mps);
        GuidanceContext::new(guide, &self.window, &self.features, &self.model, steps)
    }

    /// Rolled-out actions [M, T, 2].
    pub(crate) fn roll(&self, context: &GuidanceContext<'_>, actions: &[f32]) -> Rollout {
        let mut plan = Rollout::zeros(context.num_agents(), T);
        for (agent, row) in actions.chunks_exact(2 * T).enumerate() {
            plan.roll(context, agent, row);
        }
        plan
    }

    /// Normalised knots of zero actions.
    pub(crate) fn still(&self) -> Vec<f32> {
        let n = &self.model.normalisation;
        let zero = [0, 1].map(|c| (-n.action_mean[c] / n.action_std[c]) as f32);
        zero.repeat(self.features.agents.len() * self.model.num_knots())
    }

    /// Rolled-out normalised knots.
    pub(crate) fn roll_knots(&self, context: &GuidanceContext<'_>, knots: &[f32]) -> Rollout {
        let map = KnotMap::new(&self.model);
        let mut actions = vec![0.0; context.num_agents() * 2 * T];
        for (row, out) in knots.chunks_exact(map.width()).zip(actions.chunks_exact_mut(2 * T)) {
            map.actions(row, out);
        }
        self.roll(context, &actions)
    }
}

/// Sum over agents of the losses, each agent's loss, and the gradient.
pub(crate) fn evaluate(o: &Objective, s: &GuidanceContext<'_>, plan: &Rollout) -> (Vec<f32>, StateGradient) {
    let m = s.num_agents();
    let (mut losses, mut gradient) = (vec![0.0; m], StateGradient::zeros(m, T));
    let wanted = vec![true; m];
    o.evaluate(
        s,
        &[plan],
        &mut [Evaluation { losses: &mut losses, gradient: &mut gradient, wanted: &wanted, scale: 1.0 }],
    );
    (losses, gradient)
}
