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
        let row = plan.agents.iter().position(|a| *a == agent_idx).filter(|row| plan.follows_plan[*row])?;
        let step = world.elapsed_steps.checked_sub(plan.made_at).filter(|s| *s < plan.num_steps)?;
        let m = plan.agents.len();
        let at = ((plan.selected_sample[row] * m + row) * plan.num_steps + step) * 3;
        let [x, y, heading_rad] = plan.samples[at..at + 3] else { return None };
        let pose = Pose2::new(x, y, heading_rad);
        let speed = self.speed_mps[row * plan.num_steps + step];
        Some((pose, Vector2::new(pose.cos * speed, pose.sin * speed)))
    }

    /// Whether all arrays have the lengths that following the plan relies on, in a scene of some agents.
    pub fn fits(&self, num_agents: usize) -> bool {
        let p = &self.record;
        let fits = |f: &PlanField| f.len == f.shape.iter().product::<usize>() || f.optional && f.len == 0;
        p.fields().iter().all(fits)
            && p.agents.iter().chain(&p.ranking).all(|a| *a < num_agents)
            && p.selected_sample.iter().all(|s| *s < p.num_samples.max(1))
            && self.speed_mps.len() == p.agents.len() * p.num_steps
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

/// An array of a plan's record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlanField {
    /// Name.
    pub name: &'static str,
    /// Number of its elements.
    pub len: usize,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Whether it may be empty, where it was not kept.
    pub optional: bool,
}

/// What an axis of an array counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Axis {
    Agents,
    Ranked,
    Samples,
    Steps,
    Pose,
    Objectives,
}

macro_rules! plan_record {
    ($dollar:tt $($(#[doc = $doc:literal])+ $name:ident: $type:ty
        $(, [$($axis:ident),+] $(, $optional:ident)?)?;)+) => {
        /// A plan of one world and what it was made from. M agents, N samples, T steps, J objectives.
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        pub struct PlanRecord {
            $($(#[doc = $doc])+ pub $name: $type,)+
        }

        impl PlanRecord {
            /// The arrays, in order.
            pub fn fields(&self) -> Vec<PlanField> {
                vec![$($(PlanField {
                    name: stringify!($name),
                    len: self.$name.len(),
                    shape: vec![$(self.along(Axis::$axis)),+],
                    optional: false $(|| stringify!($optional) == "optional")?,
                },)?)+]
            }
        }

        /// Hands the list `name, …` of the fields of a plan's record to a macro.
        #[macro_export]
        macro_rules! with_plan_fields {
            ($dollar then:ident) => {
                $dollar then! { $($name),+ }
            };
        }
    };
}

plan_record! { $
    /// Steps since the episode began when the plan was made.
    made_at: usize;
    /// Agents of the scene that were planned for, [M].
    agents: Vec<usize>, [Agents];
    /// Whether the agent follows the plan, [M]; the others were predicted only.
    follows_plan: Vec<bool>, [Agents];
    /// Whether guidance moved the agent's plan, [M].
    guided: Vec<bool>, [Agents];
    /// Decision causal graph G: row i looks at column j, [M, M].
    graph: Vec<bool>, [Agents, Agents];
    /// Times to contact, seconds, [M, M].
    ttc_s: Vec<Real>, [Agents, Agents];
    /// Attention of row i to column j, mean over heads, [M, M]; empty where it was not kept.
    attention: Vec<Real>, [Agents, Agents], optional;
    /// Agents of the scene by falling importance, those that may be guided only.
    ranking: Vec<usize>, [Ranked];
    /// Number of samples N.
    num_samples: usize;
    /// Number of steps T.
    num_steps: usize;
    /// Poses x, y (m), heading (rad) in the scene frame after each step, [N, M, T, 3].
    samples: Vec<Real>, [Samples, Agents, Steps, Pose];
    /// Sample that each agent follows, [M].
    selected_sample: Vec<usize>, [Agents];
    /// Names of the guidance objectives, [J].
    objectives: Vec<String>;
    /// Loss of each objective, sample and agent, unweighted, [J, N, M].
    losses: Vec<Real>, [Objectives, Samples, Agents];
    /// Total variation between guided and unguided actions, [M]; 0 without guidance (paper, cost C).
    realism_cost: Vec<Real>, [Agents];
    /// The same in standard deviations of the process, [M]: it does not saturate.
    shift_sigmas: Vec<Real>, [Agents];
    /// Mean cosine between the gradients of objectives j and k over guided agents, [J, J]; empty where not kept.
    gradient_cosine: Vec<Real>, [Objectives, Objectives], optional;
    /// Mean cosine between the gradients of realism and guidance, [M]; 0 without a gradient, empty where not kept.
    realism_cosine: Vec<Real>, [Agents], optional;
    /// Share of samples and denoising steps in which that cosine is negative, [M]; empty where not kept.
    conflict_share: Vec<Real>, [Agents], optional;
}

impl PlanRecord {
    fn along(&self, axis: Axis) -> usize {
        match axis {
            Axis::Agents => self.agents.len(),
            Axis::Ranked => self.ranking.len(),
            Axis::Samples => self.num_samples,
            Axis::Steps => self.num_steps,
            Axis::Pose => 3,
            Axis::Objectives => self.objectives.len(),
        }
    }
}
