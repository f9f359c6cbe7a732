//! Log replay.

use super::{Motion, PlanState, TrafficPolicy, WorldView};
use crate::geom::Pose2;

/// Puts every agent where the log has it; leaves where the log has it no more.
#[derive(Debug, Default)]
pub struct Replay;

impl TrafficPolicy for Replay {
    fn name(&self) -> &str {
        "replay"
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> Motion {
        let scene = &world.scene.scene;
        let step_idx = world.step_idx + 1;
        if !scene.is_valid(agent_idx, step_idx) {
            return Motion::Leave;
        }
        let at = scene.at(agent_idx, step_idx);
        let p = scene.tracks.position[at];
        Motion::Place(Pose2::new(p.x, p.y, scene.tracks.heading_rad[at]), scene.tracks.velocity[at])
    }
}
