//! Constant velocity.

use super::{AgentMotion, DriverModel, Kind, PlanState, WorldView};
use crate::geom::{Point2, Pose2, Vector2};

pub(super) const KIND: Kind = Kind {
    name: "constant_velocity",
    title: "constant velocity",
    style: "constant_velocity",
    options: None,
    always: true,
    make: Some(|_, _| Ok(Box::new(ConstantVelocity))),
};

/// Keeps heading and speed.
#[derive(Debug, Default)]
pub struct ConstantVelocity;

impl DriverModel for ConstantVelocity {
    fn name(&self) -> &str {
        KIND.name
    }

    fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
        let pose = world.states.pose(agent_idx);
        let speed = world.states.speed_mps[agent_idx];
        let velocity = Vector2::new(pose.cos * speed, pose.sin * speed);
        let position = Point2::from(pose.position.coords + velocity * world.dt_s);
        AgentMotion::Place(Pose2 { position, ..pose }, velocity)
    }
}
