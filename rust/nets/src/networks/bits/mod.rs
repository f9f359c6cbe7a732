//! BITS: spatial goals, a policy that drives to a goal, a predictor of the others, choice among the plans
//! (rivals.md#bits).
//!
//! ```text
//! state, lines ─► cells of a grid ahead ─► N goals ─► policy ─► N plans ─► choice against predicted others
//! ```
//! Differs from the paper: 32 x 32 cells of 2 m, not 224 x 224 of 0.5 m; every neighbour is a row of its own, so the
//! predictor sees it in its own frame; goals are conditioned on as the grid gives them back, and may lie off the road.

mod grid;

pub use grid::{CHANNELS, GOAL, Grid, PER_TOKEN, by_token};

use crate::compute::backend::Backend;
use crate::compute::cpu::Cpu;
use crate::compute::layers::attention::Attention;
use crate::compute::layers::perceptron::Perceptron;
use crate::compute::numbers::Array;
use crate::config::ModelConfig;
use crate::error::{ModelError, Result, require};
use crate::guidance::Guide;
use crate::networks::cpu_planner::on_cpu;
use crate::networks::kind::NetworkKind;
use crate::networks::planner::{Asked, Proposed, Proposes};
use crate::networks::simnet::HIDDEN;
use crate::networks::trunk::{Encoded, Trunk};
use grid::{CELLS_PER_TOKEN, SIDE};

/// Goals on a grid, a policy that drives to them, a choice among them.
pub const BITS: NetworkKind =
    NetworkKind { fits, ..NetworkKind::with_trunk("bits", "BITS", on_cpu::<Bits<Cpu>>) };

/// Width of a block of cells, hidden width of the goal head, width of an encoded goal.
const GOAL_WIDTHS: [i64; 3] = [16, 96, 32];
/// Blocks of cells, each a token.
const BLOCKS: i64 = ((SIDE / CELLS_PER_TOKEN) * (SIDE / CELLS_PER_TOKEN)) as i64;

/// The three networks on their trunk.
#[derive(Debug)]
pub struct Bits<B: Backend> {
    trunk: Trunk<B>,
    blocks: B::Linear,
    lines: Attention<B>,
    cells: Perceptron<B>,
    goal: B::Linear,
    policy: Perceptron<B>,
    predictor: Perceptron<B>,
}

/// Checks that there is a map that goals are scored by.
fn fits(config: &ModelConfig) -> Result<()> {
    require(config.map.is_some(), "model.map", "None", "a map: goals are scored by its lines")
}

impl<B: Backend> Bits<B> {
    /// What the trunk says of a batch.
    pub fn encode(&self, batch: &B::Batch<'_>) -> Encoded<B> {
        self.trunk.forward(batch)
    }

    /// The cells of each block, whose token has looked at the lines, [R, blocks, [`CHANNELS`] · [`PER_TOKEN`]]; `None` without
    /// lines.
    pub fn cells(&self, seen: &Encoded<B>) -> Option<B::Tensor> {
        let lines = self.lines.memory(seen.map.as_ref()?);
        let blocks = B::cut(&B::apply(&self.blocks, &seen.state), GOAL_WIDTHS[0]);
        Some(self.cells.forward(&B::sum(self.lines.forward(&blocks, &lines, None), &blocks)))
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

impl<B: Backend> Proposes<B> for Bits<B> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let (d, out) = (config.width, 2 * config.num_knots() as i64);
        let feature_width = config.map.as_ref().map_or(0, |map| map.feature_width);
        let at = |name| B::sub(p, name);
        let [block, hidden, goal] = GOAL_WIDTHS;
        Self {
            trunk: Trunk::new(&at("trunk"), config),
            blocks: B::linear(&at("blocks"), d + 1, BLOCKS * block),
            lines: Attention::new(&at("lines"), block, feature_width, 1),
            cells: Perceptron::new(&at("cells"), &[block, hidden, (CHANNELS * PER_TOKEN) as i64]),
            goal: B::linear(&at("goal"), GOAL as i64, goal),
            policy: Perceptron::new(&at("policy"), &[d + 1 + goal, HIDDEN, HIDDEN, out]),
            predictor: Perceptron::new(&at("predictor"), &[d + 1, HIDDEN, out]),
        }
    }

    fn config(&self) -> &ModelConfig {
        self.trunk.config()
    }

    /// Plans to N goals drawn from the grid. Each agent's sample is chosen against the predicted plans of the others.
    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        let (config, seen) = (self.config(), self.encode(batch));
        let Some(cells) = self.cells(&seen) else {
            return Err(ModelError::Shape { what: "map", got: "none".into(), expected: "lines".into() });
        };
        let goals = grid::goals(&B::numbers(&cells), asked);
        let mut knots = Vec::with_capacity(goals.len() / GOAL * 2 * config.num_knots());
        for goals in goals.chunks_exact((asked.rows.count() * GOAL).max(1)) {
            let goals = B::placed(batch, Array::new(1, GOAL, goals.to_vec()));
            knots.extend(B::numbers(&self.plans(&seen, &goals)));
        }
        if let Some(guide) = guide {
            guide.choose_against(B::numbers(&self.predicted(&seen)), None);
            guide.adjust_finished(&mut knots);
        }
        Ok((knots, None))
    }
}
