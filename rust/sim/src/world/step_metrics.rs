//! What the last step was like for any set of agents, slots or not.

use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::world::VecWorld;
use crate::world::reward::discomfort;
use crate::world::tick::World;

/// Step metrics of some agents: of those that were there before the step and after it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepMetrics {
    /// How many of them were there; without any, the rest is 0.
    pub num_agents: usize,
    /// Share of them with a corner of the box off the road.
    pub off_road: f64,
    /// Mean discomfort, as in the reward `comfort`.
    pub discomfort: f64,
}

impl World {
    /// Keeps what metrics of the coming step compare with.
    pub(super) fn remember(&mut self) {
        self.acceleration_before_mps2.clone_from(&self.episode.states.acceleration_mps2);
        self.active_before.clone_from(&self.episode.states.active);
    }

    /// Forgets the step before, which belongs to another state.
    pub(super) fn forget(&mut self) {
        self.acceleration_before_mps2.clear();
        self.active_before.clear();
    }
}

impl VecWorld {
    /// Metrics of a world's last step for some agents of its scene; of nobody where it has not stepped since a reset or a
    /// snapshot.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Unknown`] for an agent that does not exist.
    pub fn step_metrics(&self, world_idx: usize, agents: &[usize]) -> Result<StepMetrics> {
        let off_road = self.off_road(world_idx)?;
        let world = self.world(world_idx)?;
        let s = &world.episode.states;
        if let Some(agent) = agents.iter().find(|a| **a >= s.len()) {
            let expected = format!("an index below {}", s.len());
            return Err(SimError::Unknown { what: "agent", got: agent.to_string(), expected });
        }
        let mut found = StepMetrics::default();
        for a in agents.iter().copied() {
            if !(s.active[a] && world.active_before.get(a) == Some(&true)) {
                continue;
            }
            let acceleration = s.acceleration_mps2[a];
            let jerk: Real = (acceleration - world.acceleration_before_mps2[a]) / self.config.dt_s;
            let lateral = s.speed_mps[a] * s.yaw_rate_radps[a];
            found.num_agents += 1;
            found.off_road += f64::from(u8::from(off_road[a].corner));
            found.discomfort += f64::from(discomfort(acceleration, lateral, jerk));
        }
        let n = found.num_agents.max(1) as f64;
        Ok(StepMetrics { off_road: found.off_road / n, discomfort: found.discomfort / n, ..found })
    }
}
