//! The lane index against a scan of every segment of every lane.

use ccdiff_sim::events::lane_facts;
use ccdiff_sim::geom::{Point2, Polygon, Polyline, Pose2, Vector2};
use ccdiff_sim::scene::{Lane, LaneHit, LaneIndex, LaneKind, Map};
use ccdiff_sim::state::AgentStates;
use proptest::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

fn lane(centreline: Vec<Point2>) -> Lane {
    Lane {
        id: String::new(),
        kind: LaneKind::Lane,
        centreline,
        polygon: Polygon::default(),
        successors: vec![],
        predecessors: vec![],
        speed_limit_mps: None,
        elevation_m: Vec::new(),
    }
}

fn map(centrelines: impl IntoIterator<Item = Vec<Point2>>) -> Map {
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

fn wrong_way(index: &LaneIndex, x: f32, y: f32, heading: f32) -> bool {
    let mut states = AgentStates::new(1);
    states.set_pose(0, Pose2::new(x, y, heading), Vector2::zeros());
    lane_facts(&states, 0, index, 10.0).wrong_way
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

/// Any float, and ordinary ones.
fn wild() -> impl Strategy<Value = f32> {
    prop_oneof![any::<f32>(), -1e4f32..1e4, Just(0.0), Just(f32::MAX), Just(f32::MIN)]
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
fn facing_oncoming_traffic_in_its_lane_is_the_wrong_way() {
    let road = LaneIndex::new(&road()).unwrap();
    assert!(!wrong_way(&road, 50.0, -1.75, 0.0));
    assert!(wrong_way(&road, 50.0, -1.75, PI));
    assert!(wrong_way(&road, 50.0, 1.75, 0.1));
    // overtaking with the own lane's centre still within 2 m
    assert!(!wrong_way(&road, 50.0, 0.2, 0.0));
    assert!(!wrong_way(&road, 50.0, 40.0, PI));
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
    fn extreme_coordinates_do_no_harm(
        line in prop::collection::vec((wild(), wild()), 0..8), queries in prop::collection::vec((wild(), wild()), 20),
    ) {
        let index = LaneIndex::new(&map([line.into_iter().map(|(x, y)| Point2::new(x, y)).collect()]));
        for (x, y) in queries {
            let near = index.as_ref().map(|i| i.nearest_by_direction(Point2::new(x, y), 1.0, 0.0, y));
            std::hint::black_box(near);
        }
    }
}
