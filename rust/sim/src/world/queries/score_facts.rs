//! What the closed-loop score of a planner looks at in a state: asked by benchmarks, never found in a step.

use crate::events::{expected_contact_s, in_intersection, lane_that_holds, rear_axle};
use crate::geom::{Point2, Real};
use crate::scene::{LaneHit, progress_along_log};
use crate::world::WorldStatus;
use crate::world::tick::straddles_lanes;

/// Facts of the present state of a world's first slot; none of an agent that is not there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScoreFacts {
    /// The lane whose surface holds the agent's centre, connectors left out, as seen along the x axis.
    pub lane: Option<LaneHit>,
    /// Time to the contact that is to be expected, see [`expected_contact_s`].
    pub contact_s: Option<Real>,
}

impl WorldStatus<'_> {
    /// How far a path and the log of the first slot go along the road blocks of the log in the episode, metres; `None` where
    /// the log is in no lane.
    pub fn progress_along_log(&self, path: &[Point2]) -> Option<(Real, Real)> {
        let (a, scene) = (self.slots.first()?.agent_idx?, self.scene);
        let start = self.step_idx - self.elapsed_steps;
        let logged = |t: usize| Some(scene.log.at(a, t)?.0.position);
        let log: Vec<Point2> = (start..=start + self.horizon_steps).filter_map(logged).collect();
        progress_along_log(scene.at(None).lanes.as_ref()?, &scene.scene.map, path, &log)
    }

    /// Facts of the first slot, which was in `lane_before`; `ignored` agents do not count.
    pub fn score_facts(&self, lane_before: Option<usize>, ignored: &[usize], horizon_s: Real) -> ScoreFacts {
        let (s, scene, map) = (self.states, self.scene, &self.scene.scene.map);
        let Some(a) = self.slots.first().and_then(|slot| slot.agent_idx) else {
            return ScoreFacts::default();
        };
        let (lanes, centre, footprints) =
            (scene.at(s.elevation_m(a)).lanes.as_ref(), s.position(a), &scene.footprints);
        let axle = rear_axle(&s.oriented_box(a, &footprints[a]));
        let from_sides =
            straddles_lanes(s, scene, a) || lanes.is_some_and(|lanes| in_intersection(lanes, map, axle));
        let ignores = |j: usize| ignored.contains(&j);
        let before = lane_before.filter(|l| *l < map.lanes.len());
        ScoreFacts {
            lane: lanes.and_then(|lanes| lane_that_holds(lanes, map, centre, before)),
            contact_s: expected_contact_s(s, footprints, &scene.kinds, a, from_sides, ignores, horizon_s),
        }
    }
}
