//! Log replay.

use super::{AgentMotion, ConstantVelocity, DriverModel, Kind, PlanState, WorldView};

pub(super) const KIND: Kind = Kind {
    name: "replay",
    title: "log",
    style: "replay",
    options: None,
    always: true,
    make: Some(|_, _| Ok(Box::new(Replay))),
};

/// Puts every agent where the log has it; goes straight on through a gap of the log, and leaves where the log has it no
/// more.
#[derive(Debug, Default)]
pub struct Replay;

impl DriverModel for Replay {
    fn name(&self) -> &str {
        KIND.name
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let (log, next) = (&world.scene.log, world.step_idx + 1);
        match log.at(agent_idx, next) {
            Some((pose, velocity)) => AgentMotion::Place(pose, velocity),
            None if log.goes_on(agent_idx, next) => ConstantVelocity.act(world, None, agent_idx),
            None => AgentMotion::Leave,
        }
    }
}
