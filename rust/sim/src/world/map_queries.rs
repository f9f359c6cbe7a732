//! What the map of a scene says of a place, asked from outside: that of the level of an elevation, where one is given.

use crate::geom::{Point2, Polyline, Pose2, Real, Vector2};
use crate::observe::{Segment, SegmentKind};
use crate::scene::{LaneHit, follow};
use crate::stage::PreparedScene;

/// A straight piece of a line of the map in somebody's own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearPiece {
    /// Its two ends, in the order of the line's points, metres.
    pub ends: [Point2; 2],
    /// What it belongs to.
    pub kind: SegmentKind,
    /// Distance from the origin of the frame, metres.
    pub distance_m: Real,
}

/// The lane that somebody is on, and the way along it.
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
    /// The pieces of the map's lines nearest to a pose, in its frame, nearest first, at most `count`; of some kinds alone.
    ///
    /// Pieces are straight, at most 5 m long, and follow their line to 0.5 m. Ties are in the order of the map.
    pub fn near_pieces(
        &self,
        frame: &Pose2,
        elevation_m: Option<Real>,
        count: usize,
        wanted: impl Fn(SegmentKind) -> bool,
    ) -> Vec<NearPiece> {
        let place = |segment: &Segment| {
            let middle = frame.to_local(Point2::new(segment.x, segment.y));
            (middle, frame.rotate_inverse(Vector2::new(segment.cos, segment.sin)))
        };
        let distance_sq = |segment: &Segment| {
            let (middle, direction) = place(segment);
            let half_m = segment.half_length_m;
            let along = (-middle.coords.dot(&direction)).clamp(-half_m, half_m);
            (middle.coords + direction * along).norm_squared()
        };
        let lines = &self.at(elevation_m).segments;
        let wanted = lines.segments().enumerate().filter(|(_, s)| wanted(s.kind));
        let mut near: Vec<(Real, usize)> = wanted.map(|(i, s)| (distance_sq(&s), i)).collect();
        let order = |a: &(Real, usize), b: &(Real, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if count < near.len() {
            near.select_nth_unstable_by(count, order);
            near.truncate(count);
        }
        near.sort_unstable_by(order);
        let piece = |(distance_sq, i): &(Real, usize)| {
            let segment = lines.segment(*i);
            let (middle, direction) = place(&segment);
            let half = direction * segment.half_length_m;
            NearPiece {
                ends: [middle - half, middle + half],
                kind: segment.kind,
                distance_m: distance_sq.sqrt(),
            }
        };
        near.iter().map(piece).collect()
    }

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
