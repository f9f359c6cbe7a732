//! How much of the time agents are off the drivable area.

use super::Trajectories;
use crate::events::{OffRoad, off_road};
use crate::geom::{Real, Region};
use crate::state::AgentStates;

/// Off-road flags of one scene and their shares.
#[derive(Debug, Clone, PartialEq)]
pub struct OffRoadReport {
    /// Flags [A, T]; false where the agent is absent.
    pub flags: Vec<OffRoad>,
    /// Share of the entries with a present agent whose centre is outside, over the agents asked for.
    pub centroid_rate: f64,
    /// The same for boxes that have a corner outside.
    pub box_rate: f64,
    /// The centre variant as the release is thought to count: an agent that vanishes between two plans counts as
    /// outside until the next plan (reference.md#off-road, an inference).
    pub reference_impl_rate: f64,
}

/// Tests every agent at every step against the region of the road at its elevation, `None` where there is no road.
///
/// Rates count the agents of `counted` [A] (all, where it is shorter), 0 where there is nothing to count.
/// `replan_steps` is the number of steps between plans, for the rate of the reference implementation; 0 counts as 1.
///
/// Differs from the release: polygons of the map in place of pixels of a raster that is clamped at its border.
pub fn off_road_report<'r>(
    motion: &Trajectories<'_>,
    region: impl Fn(Option<Real>) -> Option<&'r Region>,
    counted: &[bool],
    replan_steps: usize,
) -> OffRoadReport {
    let (num_agents, num_steps) = (motion.num_agents(), motion.num_steps());
    let replan_steps = replan_steps.max(1);
    let mut flags = vec![OffRoad::default(); num_agents * num_steps];
    let mut states = AgentStates::new(num_agents);
    for step_idx in 0..num_steps {
        motion.states_at(step_idx, &mut states);
        for (agent, footprint) in motion.footprints().iter().enumerate() {
            if states.active[agent] {
                let flag = &mut flags[agent * num_steps + step_idx];
                *flag = match region(states.elevation_m(agent)) {
                    Some(region) => off_road(&states, agent, footprint, region),
                    None => OffRoad { corner: true, centroid: true },
                };
            }
        }
    }
    let (mut present, mut centroid, mut corner, mut vanished) = (0u64, 0u64, 0u64, 0u64);
    for agent in (0..num_agents).filter(|&a| counted.get(a).copied().unwrap_or(true)) {
        for step_idx in 0..num_steps {
            let flag = flags[agent * num_steps + step_idx];
            if motion.is_valid(agent, step_idx) {
                present += 1;
                centroid += u64::from(flag.centroid);
                corner += u64::from(flag.corner);
            } else if motion.is_valid(agent, step_idx - step_idx % replan_steps) {
                vanished += 1;
            }
        }
    }
    let share = |count: u64, of: u64| if of == 0 { 0.0 } else { count as f64 / of as f64 };
    OffRoadReport {
        flags,
        centroid_rate: share(centroid, present),
        box_rate: share(corner, present),
        reference_impl_rate: share(centroid + vanished, present + vanished),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Point2, Polygon};
    use crate::state::Footprint;

    #[test]
    fn rates_count_present_agents_and_the_reference_impl_counts_those_who_vanish_within_a_plan() {
        let ring = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)];
        let square = Polygon::from_exterior(ring.map(|(x, y)| Point2::new(x, y)).to_vec());
        let region = Region::new(&[square]).unwrap();
        // centre leaves at the third step, a corner at the second; gone from the fourth on
        let x = [5.0, 9.0, 11.0, 0.0, 0.0, 0.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0];
        let there = x.map(|x| x > 0.0);
        let cars = [Footprint::new(4.0, 2.0); 2];
        let motion = Trajectories::new(0.1, &x, &[5.0; 12], &[0.0; 12], &there, &cars).unwrap();
        let report = off_road_report(&motion, |_| Some(&region), &[], 5);
        assert_eq!(report.centroid_rate, 1.0 / 9.0);
        assert_eq!(report.box_rate, 2.0 / 9.0);
        assert_eq!(report.reference_impl_rate, 3.0 / 11.0);
        let only_second = off_road_report(&motion, |_| Some(&region), &[false, true], 5);
        assert_eq!(only_second.reference_impl_rate, 0.0);
        assert!(!only_second.flags[3].centroid);
    }
}
