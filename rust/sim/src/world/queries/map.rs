//! What the map of a scene says of a place, asked from outside: that of the level of an elevation, where one is given.

use crate::geom::{Point2, Polyline, Pose2, Real};
use crate::scene::{LaneHit, follow};
use crate::stage::PreparedScene;

/// The lane that a vehicle is on, and the way along it.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneAhead {
    /// The lane, and where its nearest point is.
    pub lane: LaneHit,
    /// The way from that point on.
    path: Option<Polyline>,
}

impl LaneAhead {
    /// A place ahead by way of the lane and those that follow it, scene frame; `None` past their end.
    pub fn at(&self, ahead_m: Real) -> Option<Point2> {
        let path = self.path.as_ref().filter(|path| ahead_m <= path.length_m())?;
        Some(path.at(ahead_m).position)
    }
}

impl PreparedScene {
    /// Distance of a place to the edge of the road, metres, negative off the road; `None` where the map has no road.
    ///
    /// The road ends where the map was cut out.
    pub fn road_distance_m(&self, point: Point2, elevation_m: Option<Real>) -> Option<Real> {
        self.at(elevation_m).road_distance_m(&self.scene.map, point)
    }

    /// The nearest lane that leads where a pose heads, to 90 degrees, and the way along it; `None` without one in reach (at
    /// most 10 m).
    pub fn lane_ahead(
        &self,
        pose: &Pose2,
        elevation_m: Option<Real>,
        reach_m: Real,
        length_m: Real,
    ) -> Option<LaneAhead> {
        let lanes = self.at(elevation_m).lanes.as_ref()?;
        let lane = lanes.nearest_by_direction(pose.position, pose.cos, pose.sin, reach_m).agreeing?;
        let centreline = &self.scene.map.lanes[lane.lane_idx as usize].centreline;
        let start = Polyline::new(centreline.clone()).map(|line| line.at(lane.s_m).position);
        let mut points: Vec<Point2> = start.into_iter().collect();
        // not the point of the lane that is there already
        follow(&self.scene.map, lane.lane_idx, lane.s_m + 0.1, length_m, |point, _| points.push(point));
        Some(LaneAhead { lane, path: Polyline::new(points) })
    }
}
