//! What guidance seeks and how hard it pulls.

use super::objective::{AgentCollision, Approach, MapCollision, Objective, OverSpeed, PythonCost};
use crate::error::{ModelError, Result, require};
use ccdiff_sim::options::{Table, within};
use ccdiff_sim::{choices, options};

choices! {
    /// What guidance moves.
    #[derive(Clone, Copy, Eq)]
    pub enum Target {
        /// The finished plan, once: nothing denoises the move away.
        Finished = "finished",
        /// The mean of each denoising step but the last (paper). Networks that do not denoise, or in one step, are guided on
        /// their finished plans.
        Mean = "mean",
    }
}

/// Speed below which nobody is run into, metres per second.
pub const LEAST_TARGET_MPS: f32 = 1.0;

/// The tables of guidance.
pub const TABLES: &[&Table] = &[
    &GuidanceConfig::TABLE,
    &AgentCollision::TABLE,
    &MapCollision::TABLE,
    &OverSpeed::TABLE,
    &Approach::TABLE,
    &PythonCost::TABLE,
];

options! {
    /// Settings of guidance. The defaults are those of the preset `"rl"`.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct GuidanceConfig {
        /// Terms of the loss, at most 32, Σ w · mean: a negative weight on a collision loss seeks collisions.
        objectives: Vec<Objective> = vec![
            Objective::AgentCollision(AgentCollision::default()),
            Objective::Approach(Approach::default()),
            Objective::MapCollision(MapCollision::default()),
        ];
        /// Weight γ^t of future step t in the collision losses, over the sum of all.
        discount: f32 = 0.98, range within(0.0, 1.0).open_below();
        /// Gradient steps per plan, or per denoising step where its mean is moved; 0 chooses among samples only.
        gradient_steps: usize = 8, range within(0.0, 1000.0);
        /// Learning rate of Adam, normalised units.
        learning_rate: f32 = 0.05, range within(0.0, 1000.0).open_below();
        /// What guidance moves.
        target: Target = Target::Finished;
        /// Greatest distance of a guided finished plan from the plan that it was, after 2 s; `None`: any.
        bound_m: Option<f32> = None, unit "m", range within(0.0, 1000.0).open_below();
        /// Contacts with a target are not sought at steps at which it is planned to be slower than this. Such an ego, and one that is
        /// slower now, is avoided. 0: who stands is rammed, too.
        least_target_mps: f32 = LEAST_TARGET_MPS, unit "m/s", range within(0.0, 100.0);
        /// Leading actions of the plan that may be moved; `None`: all. With knots several steps apart, a knot may be moved
        /// where the first step nearest to it is one of these.
        executed_steps: Option<usize> = None, range within(1.0, 1000.0);
        /// Leading steps of the plan that collision losses look at; `None`: all.
        seen_steps: Option<usize> = None, range within(1.0, 1000.0);
    }
}

impl GuidanceConfig {
    /// Values of the paper's table: 30 steps of 0.001, discount 0.99, its objectives, on the mean of each denoising step
    /// (reference.md#guidance-settings). Its bound, a norm of 100, is out of their reach.
    pub fn paper() -> Self {
        Self {
            objectives: vec![
                Objective::AgentCollision(AgentCollision::default()),
                Objective::MapCollision(MapCollision::default()),
            ],
            discount: 0.99,
            gradient_steps: 30,
            learning_rate: 1e-3,
            target: Target::Mean,
            least_target_mps: 0.0,
            ..Self::default()
        }
    }

    /// A preset by name.
    ///
    /// # Errors
    /// [`ModelError::Config`] for another name than `paper` and `rl`, the defaults.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "paper" => Ok(Self::paper()),
            "rl" => Ok(Self::default()),
            _ => Err(ModelError::Config {
                field: "guidance.preset",
                got: format!("{name:?}"),
                expected: "\"paper\" or \"rl\"",
            }),
        }
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn validated(self) -> Result<Self> {
        options::check("guidance", &self)?;
        let count = self.objectives.len();
        require(count <= 32, "guidance.objectives", format!("{count} objectives"), "at most 32")?;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid_and_survive_json() {
        for name in ["paper", "rl"] {
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
        assert_eq!(config.learning_rate, GuidanceConfig::default().learning_rate);
        for wrong in [
            r#"{"gradient_step": 4}"#,
            r#"{"objectives": [{"kind": "agent_collision", "wieght": 50.0}]}"#,
            r#"{"objectives": [{"kind": "collision"}]}"#,
        ] {
            assert!(serde_json::from_str::<GuidanceConfig>(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn too_many_objectives_are_refused() {
        let objectives = vec![Objective::Approach(Approach::default()); 33];
        let error = GuidanceConfig { objectives, ..GuidanceConfig::default() }.validated().unwrap_err();
        assert!(error.to_string().contains("guidance.objectives is 33 objectives"));
    }
}
