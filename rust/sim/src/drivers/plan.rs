//! Plans: what a planning driver is asked, what it keeps in a world, and what is reported of it.

use super::{Driver, WorldView};
use crate::geom::{Pose2, Real, Vector2};
use serde::{Deserialize, Serialize};

/// A world for which a driver may plan.
#[derive(Clone, Copy)]
pub struct PlanRequest<'a> {
    /// The world.
    pub world: WorldView<'a>,
    /// The driver as [`WorldView::drivers`] names it.
    pub driver: Driver,
    /// The plan that the world follows; `None` before the first one of its episode.
    pub plan: Option<&'a PlanState>,
    /// What is asked of the plans of this world.
    pub plan_override: &'a PlanOverride,
}

impl PlanRequest<'_> {
    /// Whether the driver moves an agent of the scene.
    pub fn drives(&self, agent_idx: usize) -> bool {
        self.world.drivers[agent_idx] == self.driver
    }

    /// Whether there is no plan yet, or the present one is `replan_steps` old.
    pub fn is_due(&self, replan_steps: usize) -> bool {
        self.plan.is_none_or(|p| self.world.elapsed_steps >= p.record.made_at + replan_steps)
    }
}

/// What a driver keeps of a world from one plan to the next: part of the world's episode, and of its snapshots.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlanState {
    /// The plan, with what it was made from.
    pub record: PlanRecord,
    /// Speed of each planned agent after each step of the sample that it follows, m/s, [M, T].
    pub speed_mps: Vec<Real>,
    /// Whatever else the driver wants to find again.
    pub memory: Vec<u8>,
}

impl PlanState {
    /// Pose and velocity after the coming step; `None` for agents that do not follow the plan, and past its end.
    pub fn follow(&self, world: &WorldView<'_>, agent_idx: usize) -> Option<(Pose2, Vector2)> {
        let plan = &self.record;
        let row = plan.agents.iter().position(|a| *a == agent_idx).filter(|row| plan.follows_plan[*row])?;
        let step = world.elapsed_steps.checked_sub(plan.made_at).filter(|s| *s < plan.num_steps)?;
        let (pose, speed) = self.selected(row, step)?;
        Some((pose, Vector2::new(pose.cos * speed, pose.sin * speed)))
    }

    /// Pose and speed of the agent of a row after a step of the sample that it follows.
    pub(crate) fn selected(&self, row: usize, step: usize) -> Option<(Pose2, Real)> {
        let plan = &self.record;
        let pose = plan.pose(plan.selected_sample[row], row, step)?;
        Some((pose, *self.speed_mps.get(row * plan.num_steps + step)?))
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

/// What replaces a driver's own choice in the plans of one world, in force until replaced or until the world begins a new episode.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PlanOverride {
    /// Agents of the scene to be guided, in place of the driver's own ranking; `None` leaves the choice to it.
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

/// What is known of a field of every plan's record.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PlanFieldSchema {
    /// Name.
    pub name: &'static str,
    /// Its type in Rust.
    pub kind: &'static str,
    /// What its axes count; empty where it is no array.
    pub axes: &'static [Axis],
    /// Whether it may be empty, where it was not kept.
    pub optional: bool,
    /// Meaning.
    pub doc: &'static str,
}

/// What an axis of an array counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Axis {
    /// Planned agents.
    #[serde(rename = "M")]
    Agents,
    /// Ranked agents.
    #[serde(rename = "R")]
    Ranked,
    /// Samples.
    #[serde(rename = "N")]
    Samples,
    /// Steps.
    #[serde(rename = "T")]
    Steps,
    /// x, y, heading.
    #[serde(rename = "3")]
    Pose,
    /// Objectives of the guidance.
    #[serde(rename = "J")]
    Objectives,
}

macro_rules! plan_record {
    ($dollar:tt $($(#[doc = $doc:literal])+ $name:ident: $type:ty
        $(, [$($axis:ident),+] $(, $optional:ident)?)?;)+) => {
        /// A plan of one world and what it was made from: M agents, N samples, T steps, J objectives.
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        pub struct PlanRecord {
            $($(#[doc = $doc])+ pub $name: $type,)+
        }

        /// The fields of a plan's record, in order.
        pub static PLAN_FIELDS: &[PlanFieldSchema] = &[$(PlanFieldSchema {
            name: stringify!($name),
            kind: stringify!($type),
            axes: &[$($(Axis::$axis),+)?],
            optional: false $($(|| !stringify!($optional).is_empty())?)?,
            doc: concat!($($doc, "\n"),+),
        }),+];

        impl PlanRecord {
            /// The arrays, in order.
            pub fn fields(&self) -> Vec<PlanField> {
                vec![$($(PlanField {
                    name: stringify!($name),
                    len: self.$name.len(),
                    shape: vec![$(self.along(Axis::$axis)),+],
                    optional: false $(|| !stringify!($optional).is_empty())?,
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
    /// Steps since the episode (in a recording: since that) began when the plan was made.
    made_at: usize;
    /// Agents that were planned for, indices in the scene.
    agents: Vec<usize>, [Agents];
    /// Whether an agent follows the plan; the others were predicted only.
    follows_plan: Vec<bool>, [Agents];
    /// Whether guidance moved its plan.
    guided: Vec<bool>, [Agents];
    /// Decision causal graph G.
    graph: Vec<bool>, [Agents, Agents];
    /// Times to contact (s), 20 where there is none sooner.
    ttc_s: Vec<Real>, [Agents, Agents];
    /// Attention, mean over heads, zero outside of G. Not kept unless `explain` is set.
    attention: Vec<Real>, [Agents, Agents], optional;
    /// Agents that may be guided, by falling importance, indices in the scene.
    ranking: Vec<usize>, [Ranked];
    /// Number of samples N.
    num_samples: usize;
    /// Number of steps T.
    num_steps: usize;
    /// x, y (m) and heading (rad) in the scene frame after each step.
    samples: Vec<Real>, [Samples, Agents, Steps, Pose];
    /// Sample that each agent follows.
    selected_sample: Vec<usize>, [Agents];
    /// Names of the guidance objectives, J of them.
    objectives: Vec<String>;
    /// Loss of each objective without its weight.
    losses: Vec<Real>, [Objectives, Samples, Agents];
    /// How far guidance moved the plan by 2 s, metres; 0 for agents that are not guided, NaN where the plan was moved before it
    /// was finished, or chosen. Not kept without guidance.
    moved_m: Vec<Real>, [Agents], optional;
    /// Mean cosine of the gradients of two objectives over guided agents. Not kept unless `explain` is set.
    gradient_cosine: Vec<Real>, [Objectives, Objectives], optional;
    /// Mean cosine of the gradients of realism and guidance; 0 for an agent without a gradient. Not kept without
    /// guidance, and unless `explain` is set.
    realism_cosine: Vec<Real>, [Agents], optional;
    /// Share of samples and denoising steps in which that cosine is negative. Not kept likewise.
    conflict_share: Vec<Real>, [Agents], optional;
}

impl PlanRecord {
    /// The record of one sample that all agents follow unguided, with no graph, before its states are known.
    pub fn of_one_sample(made_at: usize, agents: Vec<usize>, num_steps: usize) -> Self {
        let m = agents.len();
        Self {
            made_at,
            follows_plan: vec![true; m],
            guided: vec![false; m],
            selected_sample: vec![0; m],
            graph: vec![false; m * m],
            ttc_s: vec![Real::INFINITY; m * m],
            num_samples: 1,
            num_steps,
            agents,
            ..Self::default()
        }
    }

    /// Pose of the agent of a row after a step of a sample, scene frame; `None` past the end.
    pub(crate) fn pose(&self, sample: usize, row: usize, step: usize) -> Option<Pose2> {
        let at = (sample * self.agents.len() + row) * self.num_steps + step;
        let [x, y, heading_rad] = *self.samples.get(3 * at..)?.first_chunk::<3>()?;
        (step < self.num_steps).then(|| Pose2::new(x, y, heading_rad))
    }

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
