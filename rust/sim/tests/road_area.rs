//! The road that edges and lanes make, against the shapes that they were drawn from.

#![expect(clippy::panic, reason = "a test fails by panicking")]

use ccdiff_sim::geom::{Point2, Polygon, Real, Region};
use ccdiff_sim::scene::{Lane, RoadParts, road_area};

fn p(x: f64, y: f64) -> Point2 {
    Point2::new(x as Real, y as Real)
}

fn arc(centre: (f64, f64), radius: f64, from_deg: f64, to_deg: f64) -> Vec<Point2> {
    let at = |i: i32| (from_deg + (to_deg - from_deg) * f64::from(i) / 90.0).to_radians();
    (0..=90).map(|i| p(centre.0 + radius * at(i).cos(), centre.1 + radius * at(i).sin())).collect()
}

fn lane(centreline: Vec<Point2>) -> Lane {
    Lane { centreline, ..Lane::default() }
}

fn road(edges: &[Vec<Point2>], lanes: &[Lane]) -> Vec<Polygon> {
    road_area(RoadParts { edges, lanes, ..RoadParts::default() })
}

/// Compares with what the shape says at places that are not at its border.
fn agree(polygons: &[Polygon], from: (f64, f64), to: (f64, f64), inside_m: impl Fn(f64, f64) -> f64) {
    let Some(region) = Region::new(polygons) else { panic!("no road") };
    for i in 0..200 {
        for j in 0..200 {
            let x = from.0 + (to.0 - from.0) * (f64::from(i) + 0.37) / 200.0;
            let y = from.1 + (to.1 - from.1) * (f64::from(j) + 0.61) / 200.0;
            let expected = inside_m(x, y);
            if expected.abs() > 0.06 {
                assert_eq!(region.contains(p(x, y)), expected > 0.0, "at {x:.2}, {y:.2}: {expected:.2} m");
            }
        }
    }
}

#[test]
fn a_straight_road_lies_between_its_edges() {
    // askew, so that no edge runs along the grid; the road is to the left of both
    let (c, s) = (0.8, 0.6);
    let at = |along: f64, left: f64| p(3.0 + c * along - s * left, -7.0 + s * along + c * left);
    let edges = [vec![at(0.0, -5.2), at(80.0, -5.2)], vec![at(80.0, 6.1), at(0.0, 6.1)]];
    let lanes = [lane(vec![at(0.0, 0.0), at(80.0, 0.0)])];
    agree(&road(&edges, &lanes), (-5.0, -20.0), (60.0, 55.0), |x, y| {
        let (dx, dy) = (x - 3.0, y + 7.0);
        let (along, left) = (c * dx + s * dy, -s * dx + c * dy);
        // beyond the ends of the edges nothing is said here
        if (5.0..75.0).contains(&along) { (left + 5.2).min(6.1 - left) } else { 0.0 }
    });
}

#[test]
fn a_median_is_no_road_and_a_bend_is_bounded() {
    // a quarter of a ring road round the origin, 20 to 40 m, with a median from 29.5 to 30.5 m
    let mut outer = arc((0.0, 0.0), 40.0, 0.0, 90.0);
    let inner: Vec<_> = arc((0.0, 0.0), 20.0, 0.0, 90.0).into_iter().rev().collect();
    // the ring's middle is left of what runs counter-clockwise
    outer.dedup();
    let mut median = arc((0.0, 0.0), 29.5, 10.0, 80.0);
    median.extend(arc((0.0, 0.0), 30.5, 80.0, 10.0));
    median.push(median[0]);
    let lanes = [lane(arc((0.0, 0.0), 25.0, 0.0, 90.0)), lane(arc((0.0, 0.0), 35.0, 90.0, 0.0))];
    agree(&road(&[outer, inner, median], &lanes), (0.0, 0.0), (45.0, 45.0), |x, y| {
        let (radius, angle) = (x.hypot(y), y.atan2(x).to_degrees());
        if !(12.0..78.0).contains(&angle) {
            return 0.0;
        }
        let ring = (radius - 20.0).min(40.0 - radius);
        ring.min((radius - 30.0).abs() - 0.5)
    });
}

#[test]
fn edges_in_many_pieces_with_corners_are_one_edge() {
    // an L of road: the inner corner is convex, the outer one is not; each piece is a line of its own, a centimetre apart
    let inner = [p(60.0, 8.0), p(8.0, 8.0), p(8.0, 60.0)];
    let outer = [p(0.0, 60.0), p(0.0, 0.0), p(60.0, 0.0)];
    let mut edges = Vec::new();
    for line in [inner, outer] {
        for (i, pair) in line.windows(2).enumerate() {
            edges.push(vec![pair[0] + (pair[1] - pair[0]) * 0.0002 * i as Real, pair[1]]);
        }
    }
    let lanes = [lane(vec![p(4.0, 60.0), p(4.0, 4.0), p(60.0, 4.0)])];
    let inside = |x: f64, y: f64| {
        if x > 52.0 || y > 52.0 {
            return 0.0;
        }
        // the corners are rounded by less than a cell
        let blunt = [(8.0, 8.0), (0.0, 0.0)].iter().any(|(cx, cy)| (x - cx).hypot(y - cy) < 0.5);
        if blunt { 0.0 } else { x.min(y).min(8.0 - x.min(y)) }
    };
    agree(&road(&edges, &lanes), (-20.0, -20.0), (60.0, 60.0), inside);
}

#[test]
fn without_edges_lanes_are_as_wide_as_lanes() {
    let lanes = [lane(vec![p(0.0, 0.0), p(50.0, 0.0)]), lane(vec![p(50.0, 3.5), p(0.0, 3.5)])];
    agree(&road(&[], &lanes), (2.0, -8.0), (48.0, 12.0), |_, y| (y + 1.75).min(5.25 - y));
    // a lane's own polygon counts in place of the usual width, a driveway as it is
    let polygon = Polygon::from_exterior(vec![p(0.0, -3.0), p(50.0, -3.0), p(50.0, 3.0), p(0.0, 3.0)]);
    let wide = [Lane { polygon, ..lanes[0].clone() }];
    let driveway = [Polygon::from_exterior(vec![p(20.0, 2.0), p(24.0, 2.0), p(24.0, 30.0), p(20.0, 30.0)])];
    let parts = RoadParts { lanes: &wide, surfaces: &driveway, ..RoadParts::default() };
    agree(&road_area(parts), (2.0, -8.0), (48.0, 29.0), |x, y| {
        (3.0 - y.abs()).max((x - 20.0).min(24.0 - x).min(y - 2.0))
    });
}

#[test]
fn pieces_without_lanes_or_vehicles_are_left_out() {
    let kerb = |y: f64| vec![vec![p(0.0, y), p(50.0, y)], vec![p(50.0, y + 6.0), p(0.0, y + 6.0)]];
    let edges: Vec<_> = kerb(0.0).into_iter().chain(kerb(40.0)).chain(kerb(80.0)).collect();
    let lanes = [lane(vec![p(0.0, 3.0), p(50.0, 3.0)])];
    let seeds = [p(20.0, 83.0)];
    let parts = RoadParts { edges: &edges, lanes: &lanes, seeds: &seeds, ..RoadParts::default() };
    let region = Region::new(&road_area(parts)).unwrap_or_else(|| panic!("no road"));
    assert!(region.contains(p(25.0, 3.0)) && region.contains(p(25.0, 83.0)));
    assert!(!region.contains(p(25.0, 43.0)));
}

#[test]
fn edges_that_are_drawn_the_other_way_bound_the_same_road() {
    let edges = [vec![p(0.0, -4.0), p(60.0, -4.0)], vec![p(60.0, 4.0), p(0.0, 4.0)]];
    let reversed = edges.clone().map(|line| line.into_iter().rev().collect());
    let lanes = [lane(vec![p(0.0, 0.0), p(60.0, 0.0)])];
    for lines in [edges, reversed] {
        agree(&road(&lines, &lanes), (3.0, -20.0), (57.0, 20.0), |_, y| 4.0 - y.abs());
    }
}

#[test]
fn nothing_and_too_much_make_no_road() {
    assert!(road(&[], &[]).is_empty());
    assert!(road(&[vec![p(0.0, 0.0)]], &[]).is_empty());
    assert!(road(&[], &[lane(vec![p(-9e5, 0.0), p(9e5, 9e5)])]).is_empty());
    // a square of 200 m that 100,000 lines cross takes its time by their length alone
    let zigzag: Vec<_> = (0..30_000).map(|i| p(f64::from(i % 2) * 200.0, f64::from(i) / 150.0)).collect();
    assert!(road(&[zigzag], &[]).is_empty());
}
