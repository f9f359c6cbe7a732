//! Log replay.

use super::{AgentMotion, Kind, PlanState, TrafficPolicy, WorldView};

/// The log.
pub(super) const KIND: Kind = Kind {
    name: "replay",
    title: "log",
    style: "replay",
    options: None,
    always: true,
    make: Some(|_, _| Ok(Box::new(Replay))),
};

/// Puts every agent where the log has it; leaves where the log has it no more.
#[derive(Debug, Default)]
pub struct Replay;

impl TrafficPolicy for Replay {
    fn name(&self) -> &str {
        KIND.name
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let logged = world.scene.log.at(agent_idx, world.step_idx + 1);
        logged.map_or(AgentMotion::Leave, |(pose, velocity)| AgentMotion::Place(pose, velocity))
    }
}
