//! Leaving the drivable area.

use crate::geom::{Real, Region};
use crate::state::{AgentStates, Footprint};

/// How far an agent has left a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OffRoad {
    /// A corner of the box is outside.
    pub corner: bool,
    /// The centre is outside (the variant of the paper's off-road rate).
    pub centroid: bool,
}

/// Whether an agent has left a region. A square inside the region that holds the box settles most calls at once.
#[inline]
pub fn off_road(states: &AgentStates, agent: usize, footprint: &Footprint, region: &Region) -> OffRoad {
    let centre = states.position(agent);
    let reach_m: Real = footprint.radius_m;
    if region.holds_square(centre, reach_m) {
        return OffRoad::default();
    }
    let body = states.oriented_box(agent, footprint);
    OffRoad { corner: !region.holds_box(&body), centroid: !region.contains(centre) }
}
