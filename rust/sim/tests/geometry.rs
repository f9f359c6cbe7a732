//! Boxes, polygons, regions and lines against the `geo` crate and against slow obvious code.

use ccdiff_sim::geom::{OrientedBox, Point2, Polygon, Polyline, Pose2, Real, Region, Vector2};
use ccdiff_sim::state::Footprint;
use geo::{Area, BooleanOps, BoundingRect, Contains, Distance, Euclidean, Length, LineString};
use proptest::prelude::*;
use std::f32::consts::TAU;

/// Oracle and code may disagree on points this near to a boundary, metres.
const DOUBT_M: f64 = 1e-3;

fn coord(p: &Point2) -> geo::Coord<f64> {
    geo::Coord { x: f64::from(p.x), y: f64::from(p.y) }
}

fn ring(points: &[Point2]) -> LineString<f64> {
    let mut coords: Vec<_> = points.iter().map(coord).collect();
    coords.extend(points.first().map(coord));
    LineString::new(coords)
}

fn geo_polygon(p: &Polygon) -> geo::Polygon<f64> {
    geo::Polygon::new(ring(&p.exterior), p.holes.iter().map(|h| ring(h)).collect())
}

fn geo_box(b: &OrientedBox) -> geo::Polygon<f64> {
    geo::Polygon::new(ring(&b.corners()), vec![])
}

fn geo_point(p: Point2) -> geo::Point<f64> {
    geo::Point(coord(&p))
}

fn distance_to_rings(polygon: &Polygon, p: Point2) -> f64 {
    let to_ring = |r: &[Point2]| Euclidean.distance(&geo_point(p), &ring(r));
    polygon.rings().map(to_ring).fold(f64::INFINITY, f64::min)
}

fn oriented_box() -> impl Strategy<Value = OrientedBox> {
    (-8f32..8.0, -8f32..8.0, -7f32..7.0, 0.3f32..12.0, 0.3f32..3.0)
        .prop_map(|(x, y, h, length, width)| Footprint::new(length, width).at(&Pose2::new(x, y, h)))
}

fn shifted(b: &OrientedBox, by: Vector2) -> OrientedBox {
    OrientedBox { centre: b.centre + by, ..*b }
}

/// A ring round a centre, star-shaped, radii between the given ones.
fn star(centre: Point2, radii: &[Real]) -> Vec<Point2> {
    let angle = |i: usize| TAU * i as f32 / radii.len() as f32;
    radii
        .iter()
        .enumerate()
        .map(|(i, r)| centre + Vector2::new(angle(i).cos(), angle(i).sin()) * *r)
        .collect()
}

/// Star-shaped polygons, half of them with a hole.
fn polygon() -> impl Strategy<Value = Polygon> {
    let radii = |range, count| prop::collection::vec(range, count);
    (-30f32..30.0, -30f32..30.0, radii(8f32..25.0, 5..30), radii(1f32..4.0, 3..12), any::<bool>()).prop_map(
        |(x, y, outer, inner, has_hole)| {
            let centre = Point2::new(x, y);
            let holes = if has_hole { vec![star(centre, &inner)] } else { vec![] };
            Polygon { exterior: star(centre, &outer), holes }
        },
    )
}

/// Any ring of points on a coarse lattice: self-crossing, doubled, collinear.
fn lattice_polygon() -> impl Strategy<Value = Polygon> {
    let ring = |count| {
        let point = (-10i8..10, -10i8..10).prop_map(|(x, y)| Point2::new(f32::from(x), f32::from(y)));
        prop::collection::vec(point, count)
    };
    (ring(3..12), prop::collection::vec(ring(3..6), 0..2))
        .prop_map(|(exterior, holes)| Polygon { exterior, holes })
}

fn points() -> impl Strategy<Value = Vec<Point2>> {
    let point = (-60f32..60.0, -60f32..60.0).prop_map(|(x, y)| Point2::new(x, y));
    prop::collection::vec(point, 200)
}

/// A line that turns a little at each point.
fn winding_line() -> impl Strategy<Value = Vec<Point2>> {
    prop::collection::vec((0.2f32..3.0, -0.2f32..0.2), 2..60).prop_map(|steps| {
        let (mut p, mut heading) = (Point2::origin(), 0.0_f32);
        let mut line = vec![p];
        for (length, turn) in steps {
            heading += turn;
            p += Vector2::new(heading.cos(), heading.sin()) * length;
            line.push(p);
        }
        line
    })
}

/// Any float, and ordinary ones.
fn wild() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<f32>(),
        -1e4f32..1e4,
        Just(0.0),
        Just(f32::MAX),
        Just(f32::MIN),
        Just(f32::MIN_POSITIVE)
    ]
}

#[test]
fn corners_run_counter_clockwise_from_the_front_left() {
    let b = Footprint::new(4.0, 2.0).at(&Pose2::new(1.0, 2.0, 0.0));
    let expected = [(3.0, 3.0), (-1.0, 3.0), (-1.0, 1.0), (3.0, 1.0)].map(|(x, y)| Point2::new(x, y));
    assert_eq!(b.corners(), expected);
}

#[test]
fn polygons_without_enough_points_are_empty() {
    for points in [vec![], vec![Point2::origin()], vec![Point2::origin(), Point2::new(1.0, 0.0)]] {
        let p = Polygon::from_exterior(points);
        assert_eq!(p.area(), 0.0);
        assert!(!p.contains(Point2::new(0.5, 0.5)));
        assert_eq!(Region::new(&[p]), None);
    }
    assert_eq!(Polygon::default().bounds(), None);
    let not_finite = [Point2::new(f32::NAN, 0.0), Point2::new(1.0, 0.0), Point2::new(1.0, 1.0)];
    assert_eq!(Region::new(&[Polygon::from_exterior(not_finite.to_vec())]), None);
}

#[test]
fn regions_answer_for_points_far_away_and_for_nan() {
    let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)].map(|(x, y)| Point2::new(x, y));
    let region = Region::new(&[Polygon::from_exterior(square.to_vec())]).unwrap();
    assert!(region.contains(Point2::new(2.0, 2.0)) && region.contains(Point2::new(4.0, 4.0)));
    for (x, y) in [(1e9, 0.0), (-1e9, 2.0), (f32::NAN, 1.0), (1.0, f32::INFINITY)] {
        assert!(!region.contains(Point2::new(x, y)));
        assert!(!region.holds_square(Point2::new(x, y), 1.0));
    }
}

#[test]
fn lines_need_two_distinct_finite_points() {
    let p = Point2::new(1.0, 1.0);
    assert_eq!(Polyline::new(vec![]), None);
    assert_eq!(Polyline::new(vec![p, p, p]), None);
    assert_eq!(Polyline::new(vec![p, Point2::new(f32::NAN, 0.0)]), None);
    let line = Polyline::new(vec![p, p, Point2::new(4.0, 5.0), Point2::new(4.0, 5.0)]).unwrap();
    assert_eq!((line.points().len(), line.length_m()), (2, 5.0));
}

#[test]
fn offsets_to_the_left_are_positive_and_ends_are_clamped() {
    let line = Polyline::new([0.0, 1.0, 5.0, 10.0].map(|x| Point2::new(x, 0.0)).to_vec()).unwrap();
    let left = line.project(Point2::new(3.0, 2.0));
    assert_eq!((left.s_m, left.lateral_m, left.distance_m, left.segment_idx), (3.0, 2.0, 2.0, 1));
    let past = line.project(Point2::new(13.0, -4.0));
    assert_eq!((past.s_m, past.lateral_m, past.distance_m), (10.0, -4.0, 5.0));
    assert_eq!(line.at(-3.0).position, Point2::new(0.0, 0.0));
    assert_eq!(line.at(99.0).position, Point2::new(10.0, 0.0));
}

proptest! {
    #[test]
    fn edge_lengths_inside_agree_with_clipped_lines(a in oriented_box(), b in oriented_box()) {
        let corners = a.corners();
        let polygon = geo_box(&b);
        // front runs from the last corner to the first, then left, rear, right
        for (edge, length) in a.edge_lengths_inside(&b).into_iter().enumerate() {
            let (p, q) = (corners[(edge + 3) % 4], corners[edge]);
            let line = geo::MultiLineString::new(vec![LineString::new(vec![coord(&p), coord(&q)])]);
            let clipped: f64 = polygon.clip(&line, false).iter().map(|l| Euclidean.length(l)).sum();
            // an edge that runs within the tolerance of the box counts: leave glancing edges out
            let sine = f64::from((a.cos * b.sin - a.sin * b.cos).abs());
            if sine.min(1.0 - sine) > 0.05 {
                prop_assert!((clipped - f64::from(length)).abs() < 0.1, "{clipped} {length}");
            }
        }
    }

    #[test]
    fn contact_normals_are_the_shortest_way_apart(a in oriented_box(), b in oriented_box()) {
        if a.overlaps(&b) {
            let normal = a.contact_normal(&b);
            prop_assert!((normal.norm() - 1.0).abs() < 1e-5);
            prop_assert!(normal.dot(&(b.centre - a.centre)) >= -1e-4);
            let shadow = |o: &OrientedBox| {
                let along = o.corners().map(|c| c.coords.dot(&normal));
                (along.iter().copied().fold(f32::MAX, f32::min), along.iter().copied().fold(f32::MIN, f32::max))
            };
            let depth = shadow(&a).1 - shadow(&b).0;
            prop_assert!(!a.overlaps(&shifted(&b, normal * (depth + 1e-3))));
            for i in 0..32 {
                let angle = TAU * i as f32 / 32.0;
                let other_way = Vector2::new(angle.cos(), angle.sin()) * (depth * 0.99 - 1e-3);
                prop_assert!(depth < 2e-3 || a.overlaps(&shifted(&b, other_way)));
            }
        }
    }

    #[test]
    fn polygon_contains_and_area_agree_with_geo(polygon in polygon(), points in points()) {
        let oracle = geo_polygon(&polygon);
        prop_assert!((f64::from(polygon.area()) - oracle.unsigned_area()).abs() < 1e-4 * oracle.unsigned_area());
        let rect = oracle.bounding_rect().unwrap();
        let (min, max) = polygon.bounds().unwrap();
        prop_assert_eq!((coord(&min), coord(&max)), (rect.min(), rect.max()));
        for p in points {
            if distance_to_rings(&polygon, p) > DOUBT_M {
                prop_assert_eq!(polygon.contains(p), oracle.contains(&geo_point(p)));
            }
        }
        for p in polygon.rings().flatten() {
            prop_assert!(polygon.contains(*p));
        }
    }

    #[test]
    fn clipped_polygons_are_the_intersection_with_the_rectangle(
        polygon in polygon(), x in -40f32..20.0, y in -40f32..20.0, w in 1f32..40.0, h in 1f32..40.0,
        points in points(),
    ) {
        let (min, max) = (Point2::new(x, y), Point2::new(x + w, y + h));
        let rect = geo::Rect::new(coord(&min), coord(&max)).to_polygon();
        let expected = geo_polygon(&polygon).intersection(&rect).unsigned_area();
        let clipped = polygon.clip_to_rect(min, max);
        let area = clipped.as_ref().map_or(0.0, |c| f64::from(c.area()));
        prop_assert!((area - expected).abs() < 1e-2 + 1e-4 * expected, "{area} {expected}");
        let Some(clipped) = clipped else { return Ok(()) };
        for p in points {
            let in_rect = rect.contains(&geo_point(p));
            if distance_to_rings(&clipped, p) > DOUBT_M && distance_to_rings(&polygon, p) > DOUBT_M {
                prop_assert_eq!(clipped.contains(p), in_rect && polygon.contains(p));
            }
        }
    }

    #[test]
    fn regions_of_broken_rings_follow_the_even_odd_rule(
        polygons in prop::collection::vec(lattice_polygon(), 1..4), points in points(),
    ) {
        let region = Region::new(&polygons).unwrap();
        for p in points {
            let p = Point2::from(p.coords * 0.2);
            let near = |q: &Polygon| {
                let d = distance_to_rings(q, p);
                d > 0.5e-4 && d < 2e-4
            };
            if !polygons.iter().any(near) {
                prop_assert_eq!(region.contains(p), polygons.iter().any(|q| q.contains(p)), "{}", p);
            }
        }
        for p in polygons.iter().flat_map(|q| q.rings()).flatten() {
            prop_assert!(region.contains(*p), "{} is a corner", p);
        }
    }

    #[test]
    fn squares_that_regions_hold_have_all_their_points_inside(
        polygons in prop::collection::vec(polygon(), 1..3), points in points(), half in 0f32..5.0,
    ) {
        let region = Region::new(&polygons).unwrap();
        for p in points {
            if region.holds_square(p, half) {
                for (i, j) in (-4..=4).flat_map(|i| (-4..=4).map(move |j| (i, j))) {
                    let q = p + Vector2::new(i as f32, j as f32) * (half / 4.0);
                    prop_assert!(polygons.iter().any(|r| r.contains(q)));
                }
            }
        }
    }

    #[test]
    fn projections_are_nearest_points(line in winding_line(), points in points()) {
        let oracle = LineString::new(line.iter().map(coord).collect());
        let line = Polyline::new(line).unwrap();
        prop_assert!((f64::from(line.length_m()) - Euclidean.length(&oracle)).abs() < 1e-3);
        for p in points {
            let projection = line.project(p);
            let distance = Euclidean.distance(&geo_point(p), &oracle);
            prop_assert!((f64::from(projection.distance_m) - distance).abs() < 1e-3);
            let foot = line.at(projection.s_m);
            prop_assert!(((p - foot.position).norm() - projection.distance_m).abs() < 1e-3);
            prop_assert!(projection.lateral_m.abs() <= projection.distance_m + 1e-3);
            let near = line.project_near(p, projection.s_m, 2.0);
            prop_assert!((near.distance_m - projection.distance_m).abs() < 1e-3);
        }
    }

    #[test]
    fn sparse_projections_of_gentle_curves_are_nearest_points(
        turns in prop::collection::vec(-0.06f32..0.06, 8..120), along in 0f32..1.0, aside in -8f32..8.0,
    ) {
        // a metre from point to point; curves of 16 m radius at the least, twice what the points stray
        let mut heading = 0.0f32;
        let mut line = vec![Point2::origin()];
        for turn in turns {
            heading = (heading + turn).clamp(-1.2, 1.2);
            line.push(line[line.len() - 1] + Vector2::new(heading.cos(), heading.sin()));
        }
        let line = Polyline::new(line).unwrap();
        let at = line.at(along * line.length_m());
        let p = at.to_outer(Point2::new(0.0, aside));
        // many at once are those one by one
        let (mut found, points) = (Vec::new(), [p, at.position, p, p, p, p, p, p, p, p]);
        line.project_sparsely(&points, at.position.x, 200.0, &mut found);
        prop_assert_eq!(found.len(), points.len());
        prop_assert_eq!(found[0], found[9]);
        let (sparse, whole) = (found[9], line.project(p));
        prop_assert!((sparse.distance_m - whole.distance_m).abs() < 1e-4);
        prop_assert!((sparse.s_m - whole.s_m).abs() < 1e-2);
    }

    #[test]
    fn points_along_a_line_lie_at_their_arc_length(line in winding_line(), share in 0f32..1.0) {
        let line = Polyline::new(line).unwrap();
        let s_m = share * line.length_m();
        let pose = line.at(s_m);
        // walk the segments
        let mut left = s_m;
        let mut expected = line.points()[0];
        for pair in line.points().windows(2) {
            let length = (pair[1] - pair[0]).norm();
            expected = pair[0] + (pair[1] - pair[0]) * (left / length).min(1.0);
            if left <= length {
                break;
            }
            left -= length;
        }
        prop_assert!((pose.position - expected).norm() < 2e-3);
        prop_assert_eq!(line.tangent_at(s_m), Vector2::new(pose.cos, pose.sin));
        prop_assert!((pose.heading_rad.cos() - pose.cos).abs() < 1e-5);
    }

    #[test]
    fn extreme_coordinates_do_no_harm(
        ring in prop::collection::vec((wild(), wild()), 0..8), queries in prop::collection::vec((wild(), wild()), 20),
    ) {
        let ring: Vec<Point2> = ring.into_iter().map(|(x, y)| Point2::new(x, y)).collect();
        let region = Region::new(&[Polygon::from_exterior(ring.clone())]);
        let line = Polyline::new(ring);
        for (x, y) in queries {
            let p = Point2::new(x, y);
            if let Some(region) = &region {
                std::hint::black_box((region.contains(p), region.holds_square(p, y)));
            }
            if let Some(line) = &line {
                std::hint::black_box((line.project(p), line.at(x), line.project_near(p, x, y)));
                line.project_sparsely(&[p], x, y, &mut Vec::new());
            }
        }
    }
}
