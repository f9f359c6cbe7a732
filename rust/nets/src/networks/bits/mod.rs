//! BITS: spatial goals, a policy that drives to a goal, a predictor of the others, choice among the plans
//! (rivals.md#bits).
//!
//! ```text
//! map tokens, state ─► cells of a grid ahead ─► N goals ─► policy ─► N plans ─► choice against predicted others
//! ```
//! Differs from the paper: 32 x 32 cells of 2 m, not 224 x 224 of 0.5 m; every neighbour is a row of its own, so the
//! predictor sees it in its own frame; goals are conditioned on as the grid gives them back.

mod grid;

pub use grid::{CHANNELS, GOAL, Grid, PER_TOKEN, by_token};

use crate::compute::backend::Backend;
use crate::compute::layers::perceptron::Perceptron;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result};
use crate::guidance::Guidance;
use crate::networks::planner::{Asked, Proposes, Weighted};
use crate::networks::simnet::HIDDEN;
use crate::networks::trunk::{Encoded, Trunk};
use grid::{CELLS_PER_TOKEN, SIDE};

/// Hidden width of the goal head, width of an encoded goal.
const GOAL_WIDTHS: (i64, i64) = (96, 32);

/// The three networks on their trunk.
#[derive(Debug)]
pub struct Bits<B: Backend> {
    trunk: Trunk<B>,
    film: B::Linear,
    cells: Perceptron<B>,
    goal: B::Linear,
    policy: Perceptron<B>,
    predictor: Perceptron<B>,
}

/// Checks that goals can be drawn from the map.
pub(crate) fn fits(config: &ModelConfig) -> Result<()> {
    let pixels = 8 * SIDE / CELLS_PER_TOKEN;
    if config.map.as_ref().is_some_and(|m| m.size_px == pixels) {
        return Ok(());
    }
    let expected = "a map of 64 pixels: goals are drawn from it";
    Err(ModelError::Config { field: "model.map", got: format!("{:?}", config.map), expected })
}

impl<B: Backend> Bits<B> {
    /// What the trunk says of a batch. `train` switches batch normalisation.
    pub fn encode(&self, batch: &B::Batch<'_>, train: bool) -> Encoded<B> {
        self.trunk.forward(batch, train)
    }

    /// The cells that each map token covers, [R, tokens, [`CHANNELS`] · [`PER_TOKEN`]]; `None` without a map.
    pub fn cells(&self, seen: &Encoded<B>) -> Option<B::Tensor> {
        let film = B::apply(&self.film, &seen.state);
        seen.map.as_ref().map(|map| self.cells.forward(&B::modulated(map, &film)))
    }

    /// Knots of the predicted plans, those of an agent side by side, [R, 1, 2 · knots].
    pub fn predicted(&self, seen: &Encoded<B>) -> B::Tensor {
        self.predictor.forward(&seen.state)
    }

    /// Knots of plans to goals [R, 1, [`GOAL`]], those of an agent side by side, [R, 1, 2 · knots].
    pub fn plans(&self, seen: &Encoded<B>, goals: &B::Tensor) -> B::Tensor {
        self.policy.forward(&B::beside(&seen.state, &B::apply_relu(&self.goal, goals)))
    }
}

impl<B: Backend> Weighted<B> for Bits<B> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (d, out) = (config.width, 2 * config.num_knots() as i64);
        let feature_width = config.map.as_ref().map_or(0, |map| map.feature_width);
        let at = |name| B::sub(p, name);
        let (hidden, goal) = GOAL_WIDTHS;
        Self {
            trunk: Trunk::new(&at("trunk"), config),
            film: B::linear(&at("film"), d + 1, 2 * feature_width),
            cells: Perceptron::new(&at("cells"), &[feature_width, hidden, (CHANNELS * PER_TOKEN) as i64]),
            goal: B::linear(&at("goal"), GOAL as i64, goal),
            policy: Perceptron::new(&at("policy"), &[d + 1 + goal, HIDDEN, HIDDEN, out]),
            predictor: Perceptron::new(&at("predictor"), &[d + 1, HIDDEN, out]),
        }
    }

    fn config(&self) -> &ModelConfig {
        self.trunk.config()
    }
}

impl<B: Backend> Proposes<B> for Bits<B> {
    /// Plans to N goals drawn from the grid. Each agent's sample is chosen against the predicted plans of the others.
    fn propose(
        &self,
        batch: &B::Batch<'_>,
        asked: &Asked<'_>,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Vec<f32>> {
        asked.rows.check_seeds(asked.seeds)?;
        let (config, seen) = (self.config(), self.encode(batch, false));
        let (Some(cells), Some(map)) = (self.cells(&seen), &config.map) else {
            return Err(ModelError::Shape { what: "map", got: "none".into(), expected: "rasters".into() });
        };
        let goals = grid::goals(&B::numbers(&cells), B::road(batch, config).as_deref(), map, asked);
        let mut knots = Vec::with_capacity(goals.len() / GOAL * 2 * config.num_knots());
        for goals in goals.chunks_exact((asked.rows.count() * GOAL).max(1)) {
            let goals = B::placed(&seen.state, goals.to_vec(), 1, GOAL);
            knots.extend(B::numbers(&self.plans(&seen, &goals)));
        }
        if let Some(guide) = guide {
            guide.choose_against(B::numbers(&self.predicted(&seen)), None)?;
            guide.adjust_finished(&mut knots)?;
        }
        Ok(knots)
    }
}
