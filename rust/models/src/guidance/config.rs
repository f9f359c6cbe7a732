//! What guidance seeks and how hard it pulls. Stored in JSON, so every field has a name that an error can give back.

use super::objective::{AgentCollision, Approach, Goal, MapCollision, OverSpeed, TargetSpeed};
use crate::error::{ModelError, Result};
use serde::{Deserialize, Serialize};

/// One term of the guidance loss. Its signed weight w enters total = Σ w · mean loss, which is minimised: a negative
/// weight on a collision loss seeks collisions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Objective {
    /// Overlap of the vehicles' disks.
    AgentCollision(AgentCollision),
    /// Parts of the body off the road.
    MapCollision(MapCollision),
    /// Speed above a limit.
    OverSpeed(OverSpeed),
    /// Distance from a wanted speed.
    TargetSpeed(TargetSpeed),
    /// Distance from a wanted position.
    Goal(Goal),
    /// Closeness of vehicles, with a gradient before contact (ours).
    Approach(Approach),
}

impl Objective {
    /// The signed weight.
    pub fn weight(&self) -> f32 {
        match self {
            Self::AgentCollision(o) => o.weight,
            Self::MapCollision(o) => o.weight,
            Self::OverSpeed(o) => o.weight,
            Self::TargetSpeed(o) => o.weight,
            Self::Goal(o) => o.weight,
            Self::Approach(o) => o.weight,
        }
    }

    /// Name in JSON.
    pub fn name(&self) -> &'static str {
        match self {
            Self::AgentCollision(_) => "agent_collision",
            Self::MapCollision(_) => "map_collision",
            Self::OverSpeed(_) => "over_speed",
            Self::TargetSpeed(_) => "target_speed",
            Self::Goal(_) => "goal",
            Self::Approach(_) => "approach",
        }
    }

    /// Whether the loss of an agent depends on where the others go.
    pub fn is_joint(&self) -> bool {
        matches!(self, Self::AgentCollision(_) | Self::Approach(_))
    }

    fn check(&self) -> Result<()> {
        let positive = |field: &'static str, value: f32| {
            if value > 0.0 && value.is_finite() { Ok(()) } else { fail(field, value, "a positive number") }
        };
        if !self.weight().is_finite() {
            return fail("guidance.objectives.weight", self.weight(), "a finite number");
        }
        match self {
            Self::AgentCollision(o) if o.num_disks == 0 => {
                fail("guidance.objectives.num_disks", 0, "at least 1")
            }
            Self::AgentCollision(o) if !(o.buffer_m >= 0.0 && o.buffer_m.is_finite()) => {
                fail("guidance.objectives.buffer_m", o.buffer_m, "at least 0")
            }
            Self::Approach(o) if o.num_disks == 0 => fail("guidance.objectives.num_disks", 0, "at least 1"),
            Self::Approach(o) => positive("guidance.objectives.reach_m", o.reach_m),
            Self::OverSpeed(o) => {
                o.limit_mps.map_or(Ok(()), |v| positive("guidance.objectives.limit_mps", v))
            }
            _ => Ok(()),
        }
    }
}

/// The rule of a gradient step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Optimiser {
    /// Adam from a fresh state in every denoising step: the first step moves every coordinate by the learning rate.
    Adam,
    /// Plain gradient descent.
    Sgd,
}

/// How far guidance may move a plan in one denoising step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Clip {
    /// Each coordinate by `clip_limit` standard deviations of the denoising step.
    Sigma,
    /// Each agent's plan by a Euclidean norm of `clip_limit` in normalised units.
    Norm,
}

/// What is moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// The mean of the denoising step (paper, released).
    Mu,
    /// The predicted clean plan, before the step's mean is formed from it. Losses see no noise: right for few steps.
    X0,
}

/// Weights with which losses choose among samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FilterWeights {
    /// Those of guidance, with their signs.
    Signed,
    /// 1 for all, as released (reference.md#sampling): with a negative collision weight the least colliding sample is taken.
    Unweighted,
}

/// Settings of guidance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceConfig {
    /// Terms of the loss.
    pub objectives: Vec<Objective>,
    /// Weight γ^t of future step t in the collision losses, over the sum of all; in (0, 1].
    pub discount: f32,
    /// Gradient steps per denoising step; 0 chooses among samples only.
    pub gradient_steps: usize,
    /// Learning rate, normalised units.
    pub learning_rate: f32,
    /// Rule of a gradient step.
    pub optimiser: Optimiser,
    /// Measure of the largest move per denoising step.
    pub clip: Clip,
    /// The largest move, in that measure.
    pub clip_limit: f32,
    /// What is moved.
    pub target: Target,
    /// Leading actions of the plan that may be moved; `None`: all. With knots several steps apart, a knot may be moved
    /// where the first step nearest to it is one of these.
    pub executed_steps: Option<usize>,
    /// Choice among samples.
    pub filter_weights: FilterWeights,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self::released()
    }
}

impl GuidanceConfig {
    /// Values of the paper's table: 30 steps of 0.001 within a norm of 100, discount 0.99 (reference.md#guidance-settings).
    pub fn paper() -> Self {
        Self {
            discount: 0.99,
            gradient_steps: 30,
            learning_rate: 1e-3,
            clip: Clip::Norm,
            clip_limit: 100.0,
            ..Self::released()
        }
    }

    /// Values of the released evaluation: one step of 0.3 within σ, discount 0.9, the mean is moved (reference.md#guidance-settings).
    ///
    /// Differs from the released code: the step does reach the plan, σ does clip, and the filter keeps the signs.
    pub fn released() -> Self {
        Self {
            objectives: vec![
                Objective::AgentCollision(AgentCollision::default()),
                Objective::MapCollision(MapCollision::default()),
            ],
            discount: 0.9,
            gradient_steps: 1,
            learning_rate: 0.3,
            optimiser: Optimiser::Adam,
            clip: Clip::Sigma,
            clip_limit: 1.0,
            target: Target::Mu,
            executed_steps: None,
            filter_weights: FilterWeights::Signed,
        }
    }

    /// For few-step sampling in a training loop: the clean plan is moved, with a gradient before contact.
    ///
    /// Differs from the paper: ours.
    pub fn rl() -> Self {
        Self {
            objectives: vec![
                Objective::AgentCollision(AgentCollision::default()),
                Objective::Approach(Approach::default()),
                Objective::MapCollision(MapCollision::default()),
            ],
            discount: 0.98,
            gradient_steps: 2,
            target: Target::X0,
            ..Self::released()
        }
    }

    /// A preset by name.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another name than `paper`, `released` and `rl`.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "released" => Ok(Self::released()),
            "rl" => Ok(Self::rl()),
            _ => fail("guidance.preset", format!("{name:?}"), "\"paper\", \"released\" or \"rl\""),
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn validated(self) -> Result<Self> {
        if !(self.discount > 0.0 && self.discount <= 1.0) {
            return fail("guidance.discount", self.discount, "a number in (0, 1]");
        }
        if !(self.learning_rate > 0.0 && self.learning_rate.is_finite()) {
            return fail("guidance.learning_rate", self.learning_rate, "a positive number");
        }
        if !(self.clip_limit > 0.0 && self.clip_limit.is_finite()) {
            return fail("guidance.clip_limit", self.clip_limit, "a positive number");
        }
        if self.executed_steps == Some(0) {
            return fail("guidance.executed_steps", 0, "at least 1");
        }
        self.objectives.iter().try_for_each(Objective::check)?;
        Ok(self)
    }
}

fn fail<T>(field: &'static str, got: impl ToString, expected: &'static str) -> Result<T> {
    Err(ModelError::Config { field, got: got.to_string(), expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_survive_json() {
        for name in ["paper", "released", "rl"] {
            let config = GuidanceConfig::preset(name).unwrap().validated().unwrap();
            let text = serde_json::to_string(&config).unwrap();
            assert_eq!(serde_json::from_str::<GuidanceConfig>(&text).unwrap(), config);
        }
        assert!(GuidanceConfig::preset("hard").unwrap_err().to_string().contains("guidance.preset"));
    }

    #[test]
    fn a_short_json_takes_the_rest_from_the_defaults_and_a_wrong_name_is_refused() {
        let text = r#"{"objectives": [{"kind": "agent_collision", "weight": 50.0}], "gradient_steps": 4}"#;
        let config: GuidanceConfig = serde_json::from_str(text).unwrap();
        assert_eq!((config.objectives[0].weight(), config.gradient_steps), (50.0, 4));
        assert_eq!(config.learning_rate, 0.3);
        for wrong in [
            r#"{"gradient_step": 4}"#,
            r#"{"objectives": [{"kind": "agent_collision", "wieght": 50.0}]}"#,
            r#"{"objectives": [{"kind": "collision"}]}"#,
        ] {
            assert!(serde_json::from_str::<GuidanceConfig>(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn values_out_of_range_name_their_field() {
        let released = GuidanceConfig::released;
        for (config, field) in [
            (GuidanceConfig { discount: 0.0, ..released() }, "guidance.discount"),
            (GuidanceConfig { learning_rate: f32::NAN, ..released() }, "guidance.learning_rate"),
            (GuidanceConfig { clip_limit: -1.0, ..released() }, "guidance.clip_limit"),
            (GuidanceConfig { executed_steps: Some(0), ..released() }, "guidance.executed_steps"),
            (
                GuidanceConfig {
                    objectives: vec![Objective::Approach(Approach { reach_m: 0.0, ..Approach::default() })],
                    ..released()
                },
                "guidance.objectives.reach_m",
            ),
        ] {
            assert!(config.validated().unwrap_err().to_string().contains(field), "{field}");
        }
    }
}
