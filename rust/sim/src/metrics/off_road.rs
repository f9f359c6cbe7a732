//! Who is off the drivable area of a recorded scene.

use super::Trajectories;
use crate::events::{OffRoad, off_road};
use crate::geom::{Real, Region};
use crate::state::AgentStates;

/// Tests every agent at every step against the region of the road at its elevation, `None` where there is no road: flags
/// [A, T], false where the agent is absent.
///
/// Differs from the release: polygons of the map in place of pixels of a raster that is clamped at its border.
pub fn off_road_flags<'r>(
    motion: &Trajectories<'_>,
    region: impl Fn(Option<Real>) -> Option<&'r Region>,
) -> Vec<OffRoad> {
    let (num_agents, num_steps) = (motion.num_agents(), motion.num_steps());
    let mut flags = vec![OffRoad::default(); num_agents * num_steps];
    let mut states = AgentStates::new(num_agents);
    for step_idx in 0..num_steps {
        motion.states_at(step_idx, &mut states);
        for (agent, footprint) in motion.footprints().iter().enumerate() {
            if states.active[agent] {
                flags[agent * num_steps + step_idx] = match region(states.elevation_m(agent)) {
                    Some(region) => off_road(&states, agent, footprint, region),
                    None => OffRoad { corner: true, centroid: true },
                };
            }
        }
    }
    flags
}
