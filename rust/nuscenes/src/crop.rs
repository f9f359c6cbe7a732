//! The part of a location's map round one scene, in the scene frame.

use crate::budget::Budget;
use crate::map_file::{Bounds, GlobalLane, GlobalLine, GlobalMap, GlobalPolygon};
use ccdiff_sim::geom::{Point2, Polygon, Real};
use ccdiff_sim::scene::{Lane, Map};

/// Clipped polygons smaller than this are slivers along the cut, square metres.
const MIN_AREA_M2: Real = 1e-3;

/// Cuts a map to a rectangle given in the global frame; lanes whose bounding box touches it stay whole. Its points are
/// of a budget, as many scenes may have one map.
pub(crate) fn crop(map: &GlobalMap, origin: [f64; 2], rect: &Bounds, points: &Budget) -> Map {
    let [min, max] = [rect.min, rect.max].map(|corner| recentre(origin, &corner));
    let cutter = Cutter { origin, rect: *rect, min, max, points };
    Map {
        drivable_area: cutter.polygons(&map.drivable_area),
        lanes: cutter.lanes(map),
        road_dividers: cutter.lines(&map.road_dividers),
        lane_dividers: cutter.lines(&map.lane_dividers),
        ped_crossings: cutter.polygons(&map.ped_crossings),
        walkways: cutter.polygons(&map.walkways),
        stop_lines: cutter.polygons(&map.stop_lines),
        carpark_areas: cutter.polygons(&map.carpark_areas),
        ..Map::default()
    }
}

fn recentre(origin: [f64; 2], point: &[f64; 2]) -> Point2 {
    Point2::new((point[0] - origin[0]) as Real, (point[1] - origin[1]) as Real)
}

struct Cutter<'a> {
    origin: [f64; 2],
    rect: Bounds,
    min: Point2,
    max: Point2,
    points: &'a Budget,
}

impl Cutter<'_> {
    fn points(&self, points: &[[f64; 2]]) -> Vec<Point2> {
        // a line takes about as much as eight points by itself; who asked for the map looks whether it was covered
        self.points.covers(points.len() + 8);
        points.iter().map(|p| recentre(self.origin, p)).collect()
    }

    fn whole(&self, polygon: &GlobalPolygon) -> Polygon {
        Polygon {
            exterior: self.points(&polygon.exterior),
            holes: polygon.holes.iter().map(|h| self.points(&h.points)).collect(),
        }
    }

    /// A polygon with the same part in the rectangle and few points far from it.
    fn near(&self, polygon: &GlobalPolygon) -> Polygon {
        let ring = |points: &[[f64; 2]]| self.points(&near_ring(points, &self.rect));
        // of a hole beyond one side nothing would be left
        let holes = polygon.holes.iter().filter(|h| beyond(&h.bounds, &self.rect) == 0);
        Polygon {
            exterior: ring(&polygon.exterior),
            holes: holes.map(|h| ring(&h.points)).filter(|h| h.len() >= 3).collect(),
        }
    }

    fn polygons(&self, polygons: &[GlobalPolygon]) -> Vec<Polygon> {
        let mut cut = Vec::new();
        for polygon in polygons.iter().filter(|p| p.bounds.touches(&self.rect)) {
            if self.rect.holds(&polygon.bounds) {
                cut.push(self.whole(polygon));
            } else {
                let near = self.near(polygon);
                cut.extend(near.clip_to_rect(self.min, self.max).filter(|p| p.area() > MIN_AREA_M2));
            }
        }
        cut
    }

    fn lines(&self, lines: &[GlobalLine]) -> Vec<Vec<Point2>> {
        let mut cut = Vec::new();
        for line in lines.iter().filter(|l| l.bounds.touches(&self.rect)) {
            let points = self.points(&line.points);
            if self.rect.holds(&line.bounds) {
                cut.push(points);
            } else {
                clip_line(&points, self.min, self.max, &mut cut);
            }
        }
        cut
    }

    fn lanes(&self, map: &GlobalMap) -> Vec<Lane> {
        let bounds = (0..).zip(&map.lane_bounds);
        let kept: Vec<u32> = bounds.filter(|(_, b)| b.touches(&self.rect)).map(|(i, _)| i).collect();
        let links = |indices: &[u32]| {
            self.points.covers(indices.len());
            let new = |old: &u32| kept.binary_search(old).ok().map(|i| i as u32);
            indices.iter().filter_map(new).collect()
        };
        let lane = |lane: &GlobalLane| Lane {
            id: lane.id.clone(),
            kind: lane.kind,
            centreline: self.points(&lane.centreline),
            polygon: lane.polygon.as_ref().map(|p| self.whole(p)).unwrap_or_default(),
            successors: links(&lane.successors),
            predecessors: links(&lane.predecessors),
            ..Lane::default()
        };
        kept.iter().map(|i| lane(&map.lanes[*i as usize])).collect()
    }
}

/// The sides of a rectangle beyond which all points of a box lie, as bits.
fn beyond(points: &Bounds, rect: &Bounds) -> u8 {
    u8::from(points.max[0] < rect.min[0])
        | u8::from(points.min[0] > rect.max[0]) << 1
        | u8::from(points.max[1] < rect.min[1]) << 2
        | u8::from(points.min[1] > rect.max[1]) << 3
}

/// The points of a ring but those that lie, with both their neighbours, beyond one side of the rectangle: the shorter
/// way between the neighbours lies beyond that side as well.
fn near_ring(points: &[[f64; 2]], rect: &Bounds) -> Vec<[f64; 2]> {
    let beyond_at = |point: &[f64; 2]| beyond(&Bounds { min: *point, max: *point }, rect);
    let Some(first) = points.first() else { return Vec::new() };
    // one point is left out at a time, so the neighbour before is the last one kept; the first point always stays
    let mut near = vec![*first];
    let mut before = beyond_at(first);
    let mut here = beyond_at(points.get(1).unwrap_or(first));
    for (i, point) in points.iter().enumerate().skip(1) {
        let after = beyond_at(points.get(i + 1).unwrap_or(first));
        if before & here & after == 0 {
            near.push(*point);
            before = here;
        }
        here = after;
    }
    near
}

/// Appends the segments of a line that lie in a rectangle (Liang and Barsky, ACM TOG 1984, edge by edge).
fn clip_line(points: &[Point2], min: Point2, max: Point2, segments: &mut Vec<Vec<Point2>>) {
    let mut segment: Vec<Point2> = Vec::new();
    let mut close = |segment: &mut Vec<Point2>| {
        segment.dedup();
        if segment.len() >= 2 {
            segments.push(std::mem::take(segment));
        }
        segment.clear();
    };
    for pair in points.windows(2) {
        let Some((from, to)) = clip_segment(pair[0], pair[1], min, max) else {
            close(&mut segment);
            continue;
        };
        if segment.last() != Some(&from) {
            close(&mut segment);
            segment.push(from);
        }
        segment.push(to);
        if to != pair[1] {
            close(&mut segment);
        }
    }
    close(&mut segment);
}

fn clip_segment(a: Point2, b: Point2, min: Point2, max: Point2) -> Option<(Point2, Point2)> {
    let d = b - a;
    let (mut enter, mut leave) = (0.0_f32, 1.0_f32);
    for (p, q) in [(-d.x, a.x - min.x), (d.x, max.x - a.x), (-d.y, a.y - min.y), (d.y, max.y - a.y)] {
        if p == 0.0 {
            if q < 0.0 {
                return None;
            }
        } else if p < 0.0 {
            enter = enter.max(q / p);
        } else {
            leave = leave.min(q / p);
        }
    }
    let at = |t: Real| {
        if t <= 0.0 {
            a
        } else if t >= 1.0 {
            b
        } else {
            a + d * t
        }
    };
    (enter <= leave).then(|| (at(enter), at(leave)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn length(line: &[Point2]) -> f32 {
        line.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
    }

    #[test]
    fn a_line_that_leaves_and_comes_back_gives_two_segments() {
        let points = [[-2.0, 0.5], [0.5, 0.5], [0.5, 3.0], [0.8, 3.0], [0.8, 0.5]];
        let points = points.map(|[x, y]| Point2::new(x, y));
        let mut segments = Vec::new();
        clip_line(&points, Point2::new(0.0, 0.0), Point2::new(1.0, 1.0), &mut segments);
        assert_eq!(segments.len(), 2);
        assert_eq!(segments[0].len(), 3);
        assert!((length(&segments[0]) - 1.0).abs() < 1e-6 && (length(&segments[1]) - 0.5).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn rings_cut_short_have_the_same_part_in_the_rectangle(
            radii in proptest::collection::vec(0.2_f64..6.0, 3..40),
            centre in (-4.0_f64..4.0, -4.0_f64..4.0),
        ) {
            let turn = std::f64::consts::TAU / radii.len() as f64;
            let at = |(i, r): (usize, &f64)| {
                let (sin, cos) = (turn * i as f64).sin_cos();
                [centre.0 + r * cos, centre.1 + r * sin]
            };
            let ring: Vec<[f64; 2]> = radii.iter().enumerate().map(at).collect();
            let rect = Bounds { min: [-1.0, -1.0], max: [1.0, 1.0] };
            let clipped = |ring: &[[f64; 2]]| {
                let points = ring.iter().map(|p| recentre([0.0; 2], p)).collect();
                let polygon = Polygon::from_exterior(points);
                polygon.clip_to_rect(Point2::new(-1.0, -1.0), Point2::new(1.0, 1.0)).unwrap_or_default()
            };
            let (whole, short) = (clipped(&ring), clipped(&near_ring(&ring, &rect)));
            prop_assert!((whole.area() - short.area()).abs() < 1e-4, "{} {}", whole.area(), short.area());
            for i in 0..100 {
                let point = Point2::new((i % 10) as Real * 0.199 - 0.9, (i / 10) as Real * 0.199 - 0.9);
                prop_assert_eq!(whole.contains(point), short.contains(point));
            }
        }

        #[test]
        fn clipped_lines_stay_inside_and_keep_the_length_that_sampling_finds(
            xy in proptest::collection::vec((-3.0_f32..3.0, -3.0_f32..3.0), 2..8),
        ) {
            let points: Vec<Point2> = xy.iter().map(|(x, y)| Point2::new(*x, *y)).collect();
            let (min, max) = (Point2::new(-1.0, -1.0), Point2::new(1.0, 1.0));
            let mut segments = Vec::new();
            clip_line(&points, min, max, &mut segments);
            let inside = |p: Point2, slack: f32| p.x.abs() <= 1.0 + slack && p.y.abs() <= 1.0 + slack;
            for segment in &segments {
                prop_assert!(segment.len() >= 2 && segment.iter().all(|p| inside(*p, 1e-5)));
            }
            let sampled: f32 = points.windows(2).map(|w| {
                let hits = (0..2000).filter(|i| inside(w[0] + (w[1] - w[0]) * ((*i as f32 + 0.5) / 2000.0), 0.0));
                (w[1] - w[0]).norm() * hits.count() as f32 / 2000.0
            }).sum();
            prop_assert!((segments.iter().map(|p| length(p)).sum::<f32>() - sampled).abs() < 0.06);
        }
    }
}
