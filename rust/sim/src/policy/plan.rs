//! Plans: what a policy that plans is asked, what it leaves in a world, and what a watcher learns from it.

use super::{Driver, WorldView};
use crate::geom::{Pose2, Real, Vector2};
use serde::{Deserialize, Serialize};

/// A world for which a policy may plan.
#[derive(Clone, Copy)]
pub struct PlanRequest<'a> {
    /// The world.
    pub world: WorldView<'a>,
    /// The policy as [`WorldView::drivers`] names it.
    pub driver: Driver,
    /// The plan that the world follows; `None` before the first one of its episode.
    pub plan: Option<&'a PlanState>,
    /// Wishes for the plans of this world.
    pub command: &'a Command,
}

impl PlanRequest<'_> {
    /// Whether the policy drives an agent of the scene.
    pub fn drives(&self, agent_idx: usize) -> bool {
        self.world.drivers[agent_idx] == self.driver
    }

    /// Whether there is no plan yet, or the present one is `replan_steps` old.
    pub fn is_due(&self, replan_steps: usize) -> bool {
        self.plan.is_none_or(|p| self.world.elapsed_steps >= p.record.made_at + replan_steps)
    }
}

/// What a policy keeps of a world from one plan to the next: part of the world's episode, and of its snapshots.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlanState {
    /// The plan, with what it was made from.
    pub record: PlanRecord,
    /// Speed of each planned agent after each step of the sample that it follows, m/s, [M, T].
    pub speed_mps: Vec<Real>,
    /// Whatever else the policy wants to find again.
    pub memory: Vec<u8>,
}

impl PlanState {
    /// Pose and velocity after the coming step; `None` for agents that do not follow the plan, and past its end.
    pub fn follow(&self, world: &WorldView<'_>, agent_idx: usize) -> Option<(Pose2, Vector2)> {
        let plan = &self.record;
        let row = plan.agents.iter().position(|a| *a == agent_idx).filter(|row| plan.executed[*row])?;
        let step = world.elapsed_steps.checked_sub(plan.made_at).filter(|s| *s < plan.num_steps)?;
        let m = plan.agents.len();
        let at = ((plan.chosen[row] * m + row) * plan.num_steps + step) * 3;
        let [x, y, heading_rad] = plan.samples[at..at + 3] else { return None };
        let pose = Pose2::new(x, y, heading_rad);
        let speed = self.speed_mps[row * plan.num_steps + step];
        Some((pose, Vector2::new(pose.cos * speed, pose.sin * speed)))
    }

    /// Whether all arrays have the lengths that following the plan relies on, in a scene of some agents.
    pub fn fits(&self, num_agents: usize) -> bool {
        let p = &self.record;
        let m = p.agents.len();
        let (j, n) = (p.objectives.len(), p.num_samples);
        let rows =
            [p.executed.len(), p.guided.len(), p.chosen.len(), p.realism_cost.len(), p.shift_sigmas.len()];
        let either = |got: usize, full: usize| got == 0 || got == full;
        p.agents.iter().chain(&p.ranking).all(|a| *a < num_agents)
            && [p.graph.len(), p.ttc_s.len()] == [m * m; 2]
            && rows.iter().all(|n| *n == m)
            && p.chosen.iter().all(|s| *s < n.max(1))
            && p.samples.len() == n * m * p.num_steps * 3
            && p.losses.len() == j * n * m
            && either(p.attention.len(), m * m)
            && either(p.gradient_cosine.len(), j * j)
            && either(p.realism_cosine.len(), m)
            && either(p.conflict_share.len(), m)
            && self.speed_mps.len() == m * p.num_steps
            && p.samples.iter().chain(&self.speed_mps).all(|x| x.is_finite())
    }
}

/// Wishes for the plans of one world, in force until replaced or until the world begins a new episode.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// Agents of the scene to be guided, in place of the policy's own ranking; `None` leaves the choice to it.
    pub guided: Option<Vec<usize>>,
    /// Strength of the guidance in place of the configured one, at least 0.
    pub criticality: Option<Real>,
}

/// A plan of one world and what it was made from. M agents, N samples, T steps.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Steps since the episode began when the plan was made.
    pub made_at: usize,
    /// Agents of the scene that were planned for, [M].
    pub agents: Vec<usize>,
    /// Whether the agent follows the plan, [M]; the others were predicted only.
    pub executed: Vec<bool>,
    /// Whether guidance moved the agent's plan, [M].
    pub guided: Vec<bool>,
    /// Decision causal graph G: row i looks at column j, [M, M].
    pub graph: Vec<bool>,
    /// Times to contact, seconds, [M, M].
    pub ttc_s: Vec<Real>,
    /// Attention of row i to column j, mean over heads, [M, M]; empty where it was not kept.
    pub attention: Vec<Real>,
    /// Agents of the scene by falling importance, those that may be guided only.
    pub ranking: Vec<usize>,
    /// Number of samples N.
    pub num_samples: usize,
    /// Number of steps T.
    pub num_steps: usize,
    /// Poses x, y (m), heading (rad) in the scene frame after each step, [N, M, T, 3].
    pub samples: Vec<Real>,
    /// Sample that each agent follows, [M].
    pub chosen: Vec<usize>,
    /// Names of the guidance objectives, [J].
    pub objectives: Vec<String>,
    /// Loss of each objective, sample and agent, unweighted, [J, N, M].
    pub losses: Vec<Real>,
    /// Total variation between guided and unguided actions, [M]; 0 without guidance (paper, cost C).
    pub realism_cost: Vec<Real>,
    /// The same in standard deviations of the process, [M]: it does not saturate.
    pub shift_sigmas: Vec<Real>,
    /// Mean cosine between the gradients of objectives j and k over guided agents, [J, J]; empty where not kept.
    pub gradient_cosine: Vec<Real>,
    /// Mean cosine between the gradients of realism and guidance, [M]; 0 without a gradient, empty where not kept.
    pub realism_cosine: Vec<Real>,
    /// Share of samples and denoising steps in which that cosine is negative, [M]; empty where not kept.
    pub conflict_share: Vec<Real>,
}
