//! A network that plans for all vehicles, as a planner asks it: where the ego would go, and what the others may do.

use crate::error::Result;
use crate::geom::{Pose2, Real};
use crate::policy::{Driver, PlanOverride, PlanRequest, PlanState, TrafficPolicy, WorldView};
use crate::stage::History;
use crate::state::AgentStates;
use crate::world::VecWorld;
use std::fmt;

/// Who the ego is to the network: nobody else is its to drive.
const OWN: Driver = Driver::Policy(u16::MAX);
/// Noise of its own: a planner must not draw what the traffic draws.
const NOISE_STREAM: u64 = 0x9e37_79b9_7f4a_7c15;

/// The network and what it has seen of each world. Pasts are those of the log before the start, and of the episode.
pub(super) struct Network {
    policy: Box<dyn TrafficPolicy>,
    seen: Vec<Option<Seen>>,
}

struct Seen {
    /// Scene, seed and episode.
    episode: (usize, u64, u64),
    elapsed_steps: usize,
    history: History,
    plan: Option<PlanState>,
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Network({})", self.policy.name())
    }
}

impl Network {
    pub(super) fn new(policy: Box<dyn TrafficPolicy>) -> Self {
        Self { policy, seen: Vec::new() }
    }

    /// Plans where it is time, for all worlds at once.
    pub(super) fn plan(&mut self, world: &VecWorld, worlds: &[usize]) -> Result<()> {
        self.seen.resize_with(self.seen.len().max(world.num_worlds()), || None);
        for &i in worlds {
            self.look(world, i)?;
        }
        let config = world.config();
        let views: Vec<(usize, WorldView<'_>)> =
            worlds.iter().map(|i| Ok((*i, world.world(*i)?.view(config)))).collect::<Result<_>>()?;
        let mut drivers = Vec::new();
        for (i, view) in &views {
            let ego = world.slot_agents(*i)?.first().copied().flatten();
            let of = |a| if Some(a) == ego { OWN } else { Driver::REPLAY };
            drivers.push((0..view.states.len()).map(of).collect::<Vec<_>>());
        }
        let nothing = PlanOverride::default();
        let requests: Vec<PlanRequest<'_>> = views
            .iter()
            .zip(&drivers)
            .filter_map(|((i, view), drivers)| {
                let seen = self.seen[*i].as_ref()?;
                let (history, noise_seed) = (Some(&seen.history), view.noise_seed ^ NOISE_STREAM);
                let world = WorldView { drivers, history, noise_seed, ..*view };
                Some(PlanRequest { world, driver: OWN, plan: seen.plan.as_ref(), plan_override: &nothing })
            })
            .collect();
        let made = self.policy.plan(&requests)?;
        let asked: Vec<usize> = requests.iter().map(|r| r.world.world_idx).collect();
        for (i, plan) in asked.into_iter().zip(made) {
            if let (Some(plan), Some(seen)) = (plan, &mut self.seen[i]) {
                seen.plan = Some(plan);
            }
        }
        Ok(())
    }

    /// Adds the present to the past of a world. What it was not asked about is missing there.
    fn look(&mut self, world: &VecWorld, world_idx: usize) -> Result<()> {
        let status = world.status(world_idx)?;
        let (episode, now) = ((status.scene_idx, status.seed, status.episode), status.elapsed_steps);
        let known = self.seen[world_idx].take().filter(|s| s.episode == episode && s.elapsed_steps <= now);
        let prepared = world.prepared(status.scene_idx)?;
        let mut seen = known.unwrap_or_else(|| {
            let (start, len) = (status.step_idx - now, self.policy.history_states().max(1));
            let history = History::from_log(&prepared.scene, start, len);
            Seen { episode, elapsed_steps: 0, history, plan: None }
        });
        let mut missing = AgentStates::default();
        missing.clear_for(status.states.len());
        for step in seen.elapsed_steps + 1..=now {
            seen.history.push(if step == now { status.states } else { &missing });
        }
        seen.elapsed_steps = now;
        self.seen[world_idx] = Some(seen);
        Ok(())
    }

    fn plan_of(&self, world_idx: usize) -> Option<(&PlanState, usize)> {
        let seen = self.seen.get(world_idx)?.as_ref()?;
        let plan = seen.plan.as_ref()?;
        Some((plan, seen.elapsed_steps - plan.record.made_at))
    }

    /// Samples of the plan of a world, at least one.
    pub(super) fn num_samples(&self, world_idx: usize) -> usize {
        self.plan_of(world_idx).map_or(1, |(plan, _)| plan.record.num_samples.max(1))
    }

    /// Poses of an agent at every step from now on in a sample, moved to where it is; `None` where it was not planned for.
    pub(super) fn path(
        &self,
        states: &AgentStates,
        world_idx: usize,
        sample: usize,
        agent_idx: usize,
    ) -> Option<Vec<Pose2>> {
        let (plan, age) = self.plan_of(world_idx)?;
        let record = &plan.record;
        let row = record.agents.iter().position(|a| *a == agent_idx)?;
        let planned = |step: usize| record.pose(sample, row, step);
        let present = states.pose(agent_idx);
        let before = age.checked_sub(1).map_or(Some(present), planned)?;
        let shift = present.position - before.position;
        let mut path = vec![present];
        for step in age..record.num_steps {
            let pose = planned(step)?;
            path.push(Pose2 { position: pose.position + shift, ..pose });
        }
        Some(path)
    }

    /// Pose and speed that the ego shall have after the coming step.
    pub(super) fn next(&self, world_idx: usize, ego: usize) -> Option<(Pose2, Real)> {
        let (plan, age) = self.plan_of(world_idx)?;
        plan.selected(plan.record.agents.iter().position(|a| *a == ego)?, age)
    }
}
