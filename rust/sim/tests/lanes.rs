//! The lane index against a scan of every segment of every lane.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ccdiff_sim::events::{in_intersection, lane_facts, lane_that_holds, straddles_lanes};
use ccdiff_sim::geom::{Point2, Polygon, Polyline, Pose2, Vector2};
use ccdiff_sim::scene::{Lane, LaneHit, LaneIndex, LaneKind, Map, progress_along_log};
use ccdiff_sim::state::{AgentStates, Footprint};
use proptest::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

fn map(centrelines: impl IntoIterator<Item = Vec<Point2>>) -> Map {
    let lane = |centreline| Lane { centreline, ..Lane::default() };
    Map { lanes: centrelines.into_iter().map(lane).collect(), ..Map::default() }
}

fn straight(from: (f32, f32), to: (f32, f32)) -> Vec<Point2> {
    let (a, b) = (Point2::new(from.0, from.1), Point2::new(to.0, to.1));
    let count = (b - a).norm().ceil() as usize;
    (0..=count).map(|i| a + (b - a) * (i as f32 / count as f32)).collect()
}

/// Two lanes of a road along x, 3.5 m apart, right-hand traffic.
fn road() -> Map {
    map([straight((0.0, -1.75), (100.0, -1.75)), straight((100.0, 1.75), (0.0, 1.75))])
}

fn wrong_way(map: &Map, x: f32, y: f32, heading: f32) -> bool {
    let mut states = AgentStates::new(1);
    states.set_pose(0, Pose2::new(x, y, heading), Vector2::zeros());
    lane_facts(&states, 0, &LaneIndex::new(map).unwrap(), map, 10.0).wrong_way
}

fn rectangle(x: [f32; 2], y: [f32; 2]) -> Polygon {
    let corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])];
    Polygon::from_exterior(corners.map(|(x, y)| Point2::new(x, y)).to_vec())
}

/// Distance to the nearest segment whose direction has at least this cosine with the given one, by brute force.
fn scan(map: &Map, point: Point2, direction: Vector2, min_cosine: f32) -> f32 {
    let pairs = map.lanes.iter().flat_map(|l| l.centreline.windows(2));
    let distance = |pair: &[Point2]| {
        let d = pair[1] - pair[0];
        let along = ((point - pair[0]).dot(&d) / d.norm_squared()).clamp(0.0, 1.0);
        let agrees = d.normalize().dot(&direction) >= min_cosine;
        agrees.then(|| (point - (pair[0] + d * along)).norm())
    };
    pairs.filter_map(distance).fold(f32::INFINITY, f32::min)
}

#[test]
fn hits_say_where_along_and_beside_the_lane_a_point_is() {
    let index = LaneIndex::new(&road()).unwrap();
    let hit = index.nearest(Point2::new(30.25, -1.0), 1.0, 0.0, 5.0).unwrap();
    assert_eq!(hit.lane_idx, 0);
    assert!((hit.s_m - 30.25).abs() < 1e-3 && (hit.lateral_m - 0.75).abs() < 1e-5);
    assert!((hit.distance_m - 0.75).abs() < 1e-5 && hit.heading_error_rad().abs() < 1e-6);
    let turned = index.nearest(Point2::new(30.0, -1.0), 0.8, 0.6, 5.0).unwrap();
    assert!((turned.heading_error_rad() - 0.6_f32.asin()).abs() < 1e-5);
}

#[test]
fn lanes_that_agree_with_the_heading_come_first() {
    let index = LaneIndex::new(&road()).unwrap();
    // on the centre line of lane 0, facing as lane 1
    let hit = index.nearest(Point2::new(50.0, -1.75), -1.0, 0.0, 10.0).unwrap();
    assert_eq!(hit.lane_idx, 1);
    // lane 1 is out of range: the nearest of any direction
    let hit = index.nearest(Point2::new(50.0, -1.75), -1.0, 0.0, 3.0).unwrap();
    assert_eq!(hit.lane_idx, 0);
    assert!((hit.heading_error_rad().abs() - PI).abs() < 1e-5 && !hit.agrees());
}

#[test]
fn facing_against_the_lane_whose_surface_holds_one_is_the_wrong_way() {
    // lanes without a surface are 3.5 m wide
    let road = road();
    assert!(!wrong_way(&road, 50.0, -1.75, 0.0));
    assert!(wrong_way(&road, 50.0, -1.75, PI));
    assert!(wrong_way(&road, 50.0, 1.75, 0.1));
    // overtaking with the centre still in the own lane
    assert!(!wrong_way(&road, 50.0, -0.1, 0.0) && wrong_way(&road, 50.0, 0.1, 0.0));
    assert!(!wrong_way(&road, 50.0, 40.0, PI));
}

#[test]
fn a_wide_lane_holds_whom_an_oncoming_centre_line_is_nearer_to() {
    // the own lane is 6 m wide, its centre line 2.6 m away, that of the opposite one 2.5 m
    let mut map = map([straight((0.0, -3.0), (100.0, -3.0)), straight((100.0, 2.1), (0.0, 2.1))]);
    map.lanes[0].polygon = rectangle([0.0, 100.0], [-6.0, 0.0]);
    map.lanes[1].polygon = rectangle([0.0, 100.0], [0.0, 4.2]);
    assert!(!wrong_way(&map, 50.0, -0.4, 0.0));
    assert!(wrong_way(&map, 50.0, 0.1, 0.0));
}

#[test]
fn connectors_are_never_the_wrong_way_and_overlapping_lanes_are_right_for_both_directions() {
    let mut map = map([straight((100.0, 0.0), (0.0, 0.0))]);
    map.lanes[0].kind = LaneKind::Connector;
    assert!(!wrong_way(&map, 50.0, 0.0, 0.0));
    let both = super_imposed();
    assert!(!wrong_way(&both, 50.0, 0.0, 0.0) && !wrong_way(&both, 50.0, 0.0, PI));
}

/// Two lanes at the same place, of opposite directions.
fn super_imposed() -> Map {
    map([straight((0.0, 0.0), (100.0, 0.0)), straight((100.0, 0.0), (0.0, 0.0))])
}

/// Lanes 0 and 1 lead over connector 2 to lane 3; lane 4 lies left of lane 0.
fn crossing() -> Map {
    let mut map = map([
        straight((0.0, 0.0), (40.0, 0.0)),
        straight((50.0, -30.0), (50.0, -10.0)),
        straight((40.0, 0.0), (60.0, 0.0)),
        straight((60.0, 0.0), (100.0, 0.0)),
        straight((0.0, 3.5), (40.0, 3.5)),
    ]);
    map.lanes[2].kind = LaneKind::Connector;
    (map.lanes[0].successors, map.lanes[2].predecessors) = (vec![2], vec![0]);
    (map.lanes[2].successors, map.lanes[3].predecessors) = (vec![3], vec![2]);
    map
}

fn straddles(map: &Map, x: f32, y: f32) -> bool {
    let car = Footprint::new(4.0, 2.0).at(&Pose2::new(x, y, 0.0));
    straddles_lanes(&LaneIndex::new(map).unwrap(), map, &car.corners())
}

#[test]
fn who_is_in_two_lanes_or_beside_all_straddles_who_follows_a_lane_does_not() {
    let map = crossing();
    assert!(!straddles(&map, 20.0, 0.0) && !straddles(&map, 20.0, 3.5));
    assert!(straddles(&map, 20.0, 1.75), "between the two lanes");
    assert!(straddles(&map, 20.0, -1.0), "one side beside the road");
    assert!(straddles(&map, 20.0, -20.0), "beside the road");
    // half in the lane, half in the connector that follows, and on into the next lane
    assert!(!straddles(&map, 40.0, 0.0) && !straddles(&map, 60.0, 0.0));
}

#[test]
fn intersections_are_where_connectors_are() {
    let map = crossing();
    let index = LaneIndex::new(&map).unwrap();
    assert!(in_intersection(&index, &map, Point2::new(50.0, 1.0)));
    assert!(!in_intersection(&index, &map, Point2::new(20.0, 1.0)));
}

#[test]
fn the_lane_that_holds_a_point_is_the_one_of_before_while_it_does() {
    let map = super_imposed();
    let index = LaneIndex::new(&map).unwrap();
    let lane = |before| lane_that_holds(&index, &map, Point2::new(30.0, 0.5), before).map(|hit| hit.lane_idx);
    assert_eq!((lane(None), lane(Some(0)), lane(Some(1))), (Some(0), Some(0), Some(1)));
    let away = lane_that_holds(&index, &map, Point2::new(30.0, 5.0), Some(0));
    assert!(away.is_none(), "the surface ends");
    let crossing = crossing();
    let index = LaneIndex::new(&crossing).unwrap();
    assert_eq!(lane_that_holds(&index, &crossing, Point2::new(50.0, 0.0), None), None, "a connector is none");
}

fn line(points: &[(f32, f32)]) -> Vec<Point2> {
    points.iter().map(|(x, y)| Point2::new(*x, *y)).collect()
}

#[test]
fn progress_counts_in_the_road_blocks_of_the_log() {
    let map = crossing();
    let index = LaneIndex::new(&map).unwrap();
    let log = line(&[(10.0, 0.0), (30.0, 0.0), (50.0, 0.0), (70.0, 0.0)]);
    let ways = |path: &[(f32, f32)]| {
        let (own_m, log_m) = progress_along_log(&index, &map, &line(path), &log).unwrap();
        assert!((log_m - 60.0).abs() < 1e-3, "{log_m}");
        own_m
    };
    let is = |path: &[(f32, f32)], m: f32| assert!((ways(path) - m).abs() < 1e-3, "{path:?} {}", ways(path));
    is(&[(10.0, 0.0), (30.0, 0.0), (50.0, 0.0), (70.0, 0.0)], 60.0);
    // in the lane beside, which ends; then off the road; back on it where it goes on
    is(&[(10.0, 3.5), (35.0, 3.5)], 25.0);
    is(&[(10.0, 0.0), (30.0, 0.0), (50.0, 9.0)], 20.0);
    is(&[(10.0, 0.0), (30.0, 0.0), (50.0, 9.0), (80.0, 0.0)], 70.0);
    // another road, and backwards
    is(&[(10.0, 0.0), (30.0, 0.0), (50.0, -20.0)], 20.0);
    is(&[(10.0, 0.0), (5.0, 0.0)], -5.0);
    let nowhere = line(&[(0.0, 90.0), (9.0, 90.0)]);
    assert_eq!(progress_along_log(&index, &map, &log, &nowhere), None, "a log in no lane");
}

#[test]
fn nothing_is_found_out_of_reach_or_without_lanes() {
    assert_eq!(LaneIndex::new(&Map::default()), None);
    let index = LaneIndex::new(&road()).unwrap();
    for (x, y) in [(50.0, 60.0), (1e9, 0.0), (f32::NAN, 0.0)] {
        assert_eq!(index.nearest(Point2::new(x, y), 1.0, 0.0, 1e9), None);
    }
    assert_eq!(index.nearest(Point2::new(50.0, -3.0), 1.0, 0.0, 1.0), None);
}

#[test]
fn lanes_of_coinciding_points_do_no_harm() {
    let p = Point2::new(1.0, 1.0);
    assert_eq!(LaneIndex::new(&map([vec![p, p]])), None);
    let doubled = vec![p, p, Point2::new(2.0, 1.0), Point2::new(2.0, 1.0), Point2::new(3.0, 1.0)];
    let hit = LaneIndex::new(&map([doubled])).unwrap().nearest(Point2::new(2.5, 1.0), 1.0, 0.0, 1.0).unwrap();
    assert!((hit.s_m - 1.5).abs() < 1e-5);
}

proptest! {
    #[test]
    fn nearest_lanes_are_those_of_a_full_scan(
        lanes in prop::collection::vec(
            (-60f32..60.0, -60f32..60.0, -PI..PI, -0.08f32..0.08, 5usize..80), 1..15,
        ),
        queries in prop::collection::vec((-80f32..80.0, -80f32..80.0, -PI..PI), 100),
    ) {
        let arcs = lanes.into_iter().map(|(x, y, mut heading, turn, count)| {
            let mut p = Point2::new(x, y);
            let mut line = vec![p];
            for _ in 0..count {
                heading += turn;
                p += Vector2::new(heading.cos(), heading.sin());
                line.push(p);
            }
            line
        });
        let map = map(arcs);
        let index = LaneIndex::new(&map).unwrap();
        for (x, y, heading) in queries {
            let point = Point2::new(x, y);
            let direction = Vector2::new(heading.cos(), heading.sin());
            let near = index.nearest_by_direction(point, direction.x, direction.y, 8.0);
            // centre lines are kept to 1 cm, and so are distances; a merged segment may turn a little
            let distance = |hit: Option<LaneHit>| hit.map_or(8.0, |h| h.distance_m);
            let any = scan(&map, point, direction, -2.0).min(8.0);
            prop_assert!((distance(near.any) - any).abs() < 0.011, "{:?} {}", near.any, any);
            let (surely, perhaps) = (scan(&map, point, direction, 0.2), scan(&map, point, direction, -0.2));
            prop_assert!(distance(near.agreeing) < surely + 0.011, "{:?} {}", near.agreeing, surely);
            prop_assert!(distance(near.agreeing) > perhaps.min(8.0) - 0.011, "{:?} {}", near.agreeing, perhaps);
            prop_assert!(near.agreeing.is_none_or(|h| h.heading_error_rad().abs() <= FRAC_PI_2 + 1e-4));
            if let Some(hit) = near.any {
                let lane = &map.lanes[hit.lane_idx as usize].centreline;
                let oracle = Polyline::new(lane.clone()).unwrap();
                let foot = oracle.at(hit.s_m).position;
                prop_assert!(((foot - point).norm() - hit.distance_m).abs() < 0.05);
            }
        }
    }

    #[test]
    fn surfaces_that_hold_a_point_are_those_of_all_lanes(
        boxes in prop::collection::vec((-60f32..60.0, -60f32..60.0, 1f32..20.0, 1f32..20.0), 1..12),
        queries in prop::collection::vec((-80f32..80.0, -80f32..80.0), 100),
    ) {
        let mut map = map(boxes.iter().map(|(x, y, w, _)| straight((*x, *y), (x + w, *y))));
        for (lane, (x, y, w, h)) in map.lanes.iter_mut().zip(&boxes).skip(1) {
            lane.polygon = rectangle([*x, x + w], [y - h, y + h]);
        }
        let index = LaneIndex::new(&map).unwrap();
        for (x, y) in queries {
            let point = Point2::new(x, y);
            let all = (0..map.lanes.len()).filter(|l| index.holds(&map, *l, point));
            // farther than 10 m from all centre lines nothing is looked for
            let near = index.nearest(point, 1.0, 0.0, 10.0).is_some();
            let expected: Vec<usize> = all.filter(|_| near).collect();
            let found: Vec<usize> = index.holding(&map, point).filter(|_| near).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
