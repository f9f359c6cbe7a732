//! What the closed-loop score of a planner looks at in a state: asked by benchmarks, never found in a step.

use crate::error::Result;
use crate::events::{expected_contact_s, in_intersection, lane_that_holds, rear_axle};
use crate::geom::{Point2, Real};
use crate::scene::{LaneHit, progress_along_log};
use crate::world::VecWorld;
use crate::world::surroundings::straddles_lanes;

/// Facts of the present state of a world's first slot; none of an agent that is not there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScoreFacts {
    /// The lane whose surface holds the agent's centre, connectors left out, as seen along the x axis.
    pub lane: Option<LaneHit>,
    /// Time to the contact that is to be expected, see [`expected_contact_s`].
    pub contact_s: Option<Real>,
}

impl VecWorld {
    /// How far a path and the log of a world's first slot go along the road blocks of the log in the episode, metres; `None`
    /// where the log is in no lane.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn progress_along_log(&self, world_idx: usize, path: &[Point2]) -> Result<Option<(Real, Real)>> {
        let world = self.begun(world_idx)?;
        let (e, scene) = (&world.episode, &*world.scene);
        let agent = e.slots.first().and_then(|slot| slot.agent_idx);
        let (Some(a), Some(lanes)) = (agent, &scene.at(None).lanes) else { return Ok(None) };
        let start = e.step_idx - e.elapsed_steps;
        let log: Vec<Point2> = (start..=start + self.config.horizon_steps)
            .filter_map(|t| Some(scene.log.at(a, t)?.0.position))
            .collect();
        Ok(progress_along_log(lanes, &scene.scene.map, path, &log))
    }

    /// Facts of a world's first slot, which was in `lane_before`; who is `ignored` is not met within the horizon.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn score_facts(
        &self,
        world_idx: usize,
        lane_before: Option<usize>,
        ignored: &[usize],
        horizon_s: Real,
    ) -> Result<ScoreFacts> {
        let world = self.begun(world_idx)?;
        let (e, scene, map) = (&world.episode, &*world.scene, &world.scene.scene.map);
        let s = &e.states;
        let Some(a) = e.slots.first().and_then(|slot| slot.agent_idx) else {
            return Ok(ScoreFacts::default());
        };
        let (lanes, centre, footprints) =
            (scene.at(s.elevation_m(a)).lanes.as_ref(), s.position(a), &scene.footprints);
        let axle = rear_axle(&s.oriented_box(a, &footprints[a]));
        let from_sides =
            straddles_lanes(s, scene, a) || lanes.is_some_and(|lanes| in_intersection(lanes, map, axle));
        let ignores = |j: usize| ignored.contains(&j);
        let before = lane_before.filter(|l| *l < map.lanes.len());
        Ok(ScoreFacts {
            lane: lanes.and_then(|lanes| lane_that_holds(lanes, map, centre, before)),
            contact_s: expected_contact_s(s, footprints, &scene.kinds, a, from_sides, ignores, horizon_s),
        })
    }
}
