//! The map as short straight lines in each agent's own frame.
//!
//! Differs from the paper, whose map is a raster: lanes, connectors, edges of the road, crossings, stop lines and dividers are cut
//! into pieces of at most 5 m, and an agent sees those nearest to the straight way ahead of it.

use crate::inputs::features::scene::SceneFeatures;
use ccdiff_sim::geom::{Point2, Pose2, Vector2, bounds};
use ccdiff_sim::observe::{MapSegments, Segment, SegmentKind};
use ccdiff_sim::scene::Scene;

/// Segments that an agent sees.
pub const NUM_SEGMENTS: usize = 64;
/// Numbers per segment: both ends x, y, 1 for 20 m; middle x, y and the agent's place along and beside the segment's line, 1 for
/// 5 m and more; cosine and sine of the direction; nearness of the middle; availability; the kind, one of 8.
pub const SEGMENT_FEATURES: usize = 20;
/// Numbers of a segment that change sign in a mirror.
pub const SEGMENT_ODD: [bool; SEGMENT_FEATURES] = {
    let mut odd = [false; SEGMENT_FEATURES];
    let mut y = 1;
    while y < 10 {
        odd[y] = true;
        y += 2;
    }
    odd
};
/// The straight way ahead of an agent: so long, metres,
const WAY_M: f32 = 10.0;
/// longer by so many seconds of its speed,
const WAY_S: f32 = 4.0;
/// and no longer than this, metres.
const LONGEST_WAY_M: f32 = 50.0;
/// Farther from it nothing is seen, metres.
const REACH_M: f32 = 80.0;
/// So far one looks first, metres.
const FIRST_REACH_M: f32 = 20.0;

/// Beyond the logged positions a map reaches at least so far, metres: a vehicle that only leaves its road sideways does not leave
/// the map;
const LOG_MARGIN_M: f32 = 10.0;
/// and no farther than this, metres.
const MOST_MARGIN_M: f32 = 110.0;

/// A scene's map as a network reads it.
#[derive(Debug, Clone, PartialEq)]
pub struct MapLines {
    /// Corners of the part that has a map.
    known: [Point2; 2],
    /// All lines but the edges of walkways, which are mostly those of the road.
    segments: Vec<Segment>,
}

impl MapLines {
    /// The lines of a scene. The part that has a map ends where its areas and lines end, a loader's crop included, between
    /// [`LOG_MARGIN_M`] and [`MOST_MARGIN_M`] beyond the box of all logged positions. Lanes do not count: loaders do not cut them.
    pub fn from_scene(scene: &Scene) -> Self {
        let (map, tracks) = (&scene.map, &scene.tracks);
        let logged = tracks.position.iter().zip(&tracks.valid).filter_map(|(p, valid)| valid.then_some(*p));
        let (low, high) = bounds(logged).unwrap_or_default();
        let areas = [&map.drivable_area, &map.ped_crossings, &map.walkways, &map.carpark_areas];
        let lines = map.road_dividers.iter().chain(&map.lane_dividers).flatten();
        let drawn = areas.into_iter().flatten().flat_map(|area| &area.exterior).chain(lines);
        let drawn = bounds(drawn.copied());
        let margin = |drawn_m: Option<f32>| drawn_m.unwrap_or(f32::MAX).clamp(LOG_MARGIN_M, MOST_MARGIN_M);
        let below = |axis: usize| low[axis] - margin(drawn.map(|(from, _)| low[axis] - from[axis]));
        let above = |axis: usize| high[axis] + margin(drawn.map(|(_, to)| to[axis] - high[axis]));
        let all = MapSegments::new(map);
        Self {
            known: [Point2::new(below(0), below(1)), Point2::new(above(0), above(1))],
            segments: all.segments().filter(|s| s.kind != SegmentKind::Walkway).collect(),
        }
    }

    /// Whether a point lies where there is a map.
    pub fn covers(&self, point: Point2) -> bool {
        let [low, high] = self.known;
        low.x <= point.x && point.x <= high.x && low.y <= point.y && point.y <= high.y
    }
}

/// How much farther a kind counts than a lane.
fn farness(kind: SegmentKind) -> f32 {
    match kind {
        SegmentKind::Lane | SegmentKind::Connector | SegmentKind::RoadEdge => 1.0,
        SegmentKind::Crossing | SegmentKind::StopLine => 1.5,
        SegmentKind::RoadDivider | SegmentKind::LaneDivider | SegmentKind::Walkway => 2.0,
    }
}

/// Segments of all agents of a scene, [M, [`NUM_SEGMENTS`], [`SEGMENT_FEATURES`]], nearest to the way ahead first; zero where
/// there are fewer.
pub(crate) fn seen(features: &SceneFeatures, map: Option<&MapLines>) -> Vec<f32> {
    let segments = map.map_or(&[][..], |map| &map.segments);
    let per_agent = NUM_SEGMENTS * SEGMENT_FEATURES;
    let mut out = vec![0.0; features.agents.len() * per_agent];
    let agents = features.poses.iter().zip(&features.speed_mps);
    for ((frame, speed_mps), rows) in agents.zip(out.chunks_exact_mut(per_agent)) {
        let way_m = (WAY_M + WAY_S * speed_mps).clamp(0.0, LONGEST_WAY_M);
        for (segment, row) in
            nearest(segments, frame, way_m).iter().zip(rows.chunks_exact_mut(SEGMENT_FEATURES))
        {
            row.copy_from_slice(&numbers(segment, frame));
        }
    }
    out
}

/// The segments nearest to the way ahead of a pose, nearest first; ties in the order of the map.
fn nearest(segments: &[Segment], frame: &Pose2, way_m: f32) -> Vec<Segment> {
    let squared = |segment: &Segment| {
        let middle = frame.to_local(Point2::new(segment.x, segment.y));
        let beyond = middle.x - middle.x.clamp(0.0, way_m);
        (beyond * beyond + middle.y * middle.y) * farness(segment.kind).powi(2)
    };
    let within = |reach_m: f32| -> Vec<(f32, usize)> {
        segments.iter().map(squared).zip(0..).filter(|(squared, _)| *squared < reach_m * reach_m).collect()
    };
    // mostly there are enough of them nearby
    let mut near = within(FIRST_REACH_M);
    if near.len() < NUM_SEGMENTS {
        near = within(REACH_M);
    }
    let order = |a: &(f32, usize), b: &(f32, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    if near.len() > NUM_SEGMENTS {
        near.select_nth_unstable_by(NUM_SEGMENTS, order);
        near.truncate(NUM_SEGMENTS);
    }
    near.sort_unstable_by(order);
    near.iter().map(|(_, k)| segments[*k]).collect()
}

/// See [`SEGMENT_FEATURES`].
fn numbers(segment: &Segment, frame: &Pose2) -> [f32; SEGMENT_FEATURES] {
    let middle = frame.to_local(Point2::new(segment.x, segment.y));
    let turned = frame.rotate_inverse(Vector2::new(segment.cos, segment.sin));
    let half = turned * segment.half_length_m;
    let along = -middle.x * turned.x - middle.y * turned.y;
    let beside = middle.x * turned.y - middle.y * turned.x;
    let near = |v: f32| (v / 5.0).clamp(-1.0, 1.0);
    let mut out = [0.0; SEGMENT_FEATURES];
    out[..12].copy_from_slice(&[
        (middle.x - half.x) / 20.0,
        (middle.y - half.y) / 20.0,
        (middle.x + half.x) / 20.0,
        (middle.y + half.y) / 20.0,
        near(middle.x),
        near(middle.y),
        turned.x,
        turned.y,
        near(along),
        near(beside),
        5.0 / (5.0 + middle.coords.norm()),
        1.0,
    ]);
    out[12 + segment.kind as usize] = 1.0;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(x: f32, y: f32, heading_rad: f32, kind: SegmentKind) -> Segment {
        Segment { x, y, cos: heading_rad.cos(), sin: heading_rad.sin(), half_length_m: 2.0, kind }
    }

    #[test]
    fn a_line_is_told_in_the_agents_own_frame() {
        // the agent faces north; the lane begins 8 m ahead of it, 3 m to its right, and leads north, too
        let frame = Pose2::new(100.0, 50.0, std::f32::consts::FRAC_PI_2);
        let lane = segment(103.0, 60.0, std::f32::consts::FRAC_PI_2, SegmentKind::Connector);
        let found = numbers(&lane, &frame);
        let nearness = 5.0 / (5.0 + 109f32.sqrt());
        let expected = [0.4, -0.15, 0.6, -0.15, 1.0, -0.6, 1.0, 0.0, -1.0, 0.6, nearness, 1.0];
        for (at, (a, b)) in found.iter().zip(expected).enumerate() {
            assert!((a - b).abs() < 1e-5, "{at}: {a} in place of {b}");
        }
        assert_eq!(found[12..], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn lines_beside_the_way_ahead_come_before_those_behind() {
        let frame = Pose2::new(0.0, 0.0, 0.0);
        let behind = segment(-6.0, 0.0, 0.0, SegmentKind::Lane);
        let ahead = segment(25.0, 3.0, 0.0, SegmentKind::Lane);
        let divider = segment(10.0, 2.0, 0.0, SegmentKind::LaneDivider);
        let far = segment(0.0, 90.0, 0.0, SegmentKind::Lane);
        let map = [behind, divider, far, ahead];
        assert_eq!(nearest(&map, &frame, 30.0), [ahead, divider, behind]);
        // a standing vehicle looks less far
        assert_eq!(nearest(&map, &frame, 10.0), [divider, behind, ahead]);
    }

    #[test]
    fn no_more_lines_are_seen_than_there_is_room_for() {
        let map: Vec<Segment> =
            (0u8..200).map(|k| segment(0.0, 0.3 * f32::from(k), 0.0, SegmentKind::Lane)).collect();
        let found = nearest(&map, &Pose2::new(0.0, 0.0, 0.0), 10.0);
        assert_eq!(found, map[..NUM_SEGMENTS]);
    }
}
