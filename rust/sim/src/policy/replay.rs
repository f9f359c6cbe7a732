//! Log replay.

use super::{AgentMotion, PlanState, TrafficPolicy, WorldView};

/// Puts every agent where the log has it; leaves where the log has it no more.
#[derive(Debug, Default)]
pub struct Replay;

impl TrafficPolicy for Replay {
    fn name(&self) -> &str {
        "replay"
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let logged = world.scene.log.at(agent_idx, world.step_idx + 1);
        logged.map_or(AgentMotion::Leave, |(pose, velocity)| AgentMotion::Place(pose, velocity))
    }
}
