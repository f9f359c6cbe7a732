//! The static part of an image: layers of the map, prepared once per scene and drawn per image.

use crate::camera::Bounds;
use crate::canvas::{Canvas, Outline};
use crate::error::{RenderError, Result};
use crate::look::{CENTRE_DASH_M, CENTRE_GAP_M, CHEVRON_GAP_M, CHEVRON_M, LANE_DASH_M, STRIPE_M};
use crate::palette::Rgb;
use ccdiff_sim::geom::{Point2, Polygon, Real, Vector2, math};
use ccdiff_sim::scene::Map;

/// Most dashes or stripes of one line or crossing; a longer line is drawn solid.
const MAX_SEGMENTS: Real = 2000.0;
/// Points of a line that are looked at together when the image is cut to the view.
const CHUNK_POINTS: usize = 32;

/// Rings of one polygon: the outer one, then holes.
#[derive(Debug, Clone)]
struct Area {
    rings: Vec<Vec<Point2>>,
    bounds: Bounds,
}

/// A segment of a line.
#[derive(Debug, Clone)]
struct Segment {
    points: Vec<Point2>,
    bounds: Bounds,
}

/// The layers of a map, cut into segments that can be left out where the camera does not see them: dashes and
/// stripes are laid out once. Build it once per scene and use it for every image.
#[derive(Debug, Clone, Default)]
pub struct MapLayers {
    drivable_area: Vec<Area>,
    kerbs: Vec<Segment>,
    walkways: Vec<Area>,
    carpark_areas: Vec<Area>,
    stripes: Vec<Area>,
    stop_lines: Vec<Area>,
    centre_lines: Vec<Segment>,
    chevrons: Vec<Segment>,
    lane_dividers: Vec<Segment>,
    road_dividers: Vec<Segment>,
}

impl MapLayers {
    /// Prepares a map.
    ///
    /// # Errors
    /// [`RenderError::Map`] where [`Map::first_fault`] finds one.
    pub fn new(map: &Map) -> Result<Self> {
        if let Some(layer) = map.first_fault() {
            return Err(RenderError::Map { layer });
        }
        let areas = |polygons: &[Polygon]| polygons.iter().map(Area::new).collect::<Vec<_>>();
        let (centre_lines, dividers) = (map.lanes.iter().map(|l| &l.centreline), map.lane_dividers.iter());
        Ok(Self {
            drivable_area: areas(&map.drivable_area),
            kerbs: map.drivable_area.iter().flat_map(kerbs).collect(),
            walkways: areas(&map.walkways),
            carpark_areas: areas(&map.carpark_areas),
            stripes: map.ped_crossings.iter().flat_map(stripes).collect(),
            stop_lines: areas(&map.stop_lines),
            centre_lines: centre_lines.flat_map(|l| dashes(l, (CENTRE_DASH_M, CENTRE_GAP_M))).collect(),
            chevrons: map.lanes.iter().flat_map(|l| chevrons(&l.centreline)).collect(),
            lane_dividers: dividers.flat_map(|l| dashes(l, (LANE_DASH_M, LANE_DASH_M))).collect(),
            road_dividers: map.road_dividers.iter().flat_map(|l| chunks(l)).collect(),
        })
    }

    /// Draws what the camera sees.
    pub(crate) fn draw(&self, canvas: &mut Canvas) {
        let palette = canvas.palette();
        areas(canvas, &self.walkways, palette.walkway);
        // All edges first, the surface on top: only the edge of the union stays.
        segments(canvas, &self.kerbs, palette.kerb, (0.3, 1.6));
        areas(canvas, &self.drivable_area, palette.drivable);
        areas(canvas, &self.carpark_areas, palette.carpark);
        areas(canvas, &self.stop_lines, palette.stop);
        areas(canvas, &self.stripes, palette.stripe);
        segments(canvas, &self.lane_dividers, palette.lane_divider, (0.14, 1.0));
        segments(canvas, &self.road_dividers, palette.road_divider, (0.18, 1.0));
        segments(canvas, &self.centre_lines, palette.centre_line, (0.1, 0.9));
        if canvas.view.px_per_m > 3.3 {
            segments(canvas, &self.chevrons, palette.centre_line, (0.14, 1.0));
        }
    }
}

impl Area {
    /// Turns outer rings one way and holes the other: filled by the non-zero rule as one path, areas then give
    /// their union, without seams where they abut.
    fn new(polygon: &Polygon) -> Self {
        let outer = turned(&polygon.exterior, true);
        let bounds = Bounds::of(&outer);
        let holes = polygon.holes.iter().map(|hole| turned(hole, false));
        Self { rings: std::iter::once(outer).chain(holes).collect(), bounds }
    }
}

/// Fills the union of the areas in sight.
fn areas(canvas: &mut Canvas, list: &[Area], rgb: Rgb) {
    let mut outline = Outline::new();
    for area in list.iter().filter(|a| canvas.view.sees(&a.bounds, 1.0)) {
        area.rings.iter().for_each(|ring| outline.ring(canvas.view, ring));
    }
    canvas.fill(outline, rgb, 1.0);
}

/// The ring, counter-clockwise or clockwise.
fn turned(ring: &[Point2], counter_clockwise: bool) -> Vec<Point2> {
    let Some(first) = ring.first() else { return Vec::new() };
    let area: f64 = ring.windows(2).map(|w| f64::from((w[0] - first).perp(&(w[1] - first)))).sum();
    let mut ring = ring.to_vec();
    if (area > 0.0) != counter_clockwise {
        ring.reverse();
    }
    ring
}

impl Segment {
    fn new(points: Vec<Point2>) -> Self {
        let bounds = Bounds::of(&points);
        Self { points, bounds }
    }
}

/// Strokes the segments in sight as one path, so many metres wide and at least so many pixels.
fn segments(canvas: &mut Canvas, list: &[Segment], rgb: Rgb, (width_m, min_px): (f32, f32)) {
    let mut outline = Outline::new();
    for segment in list.iter().filter(|p| canvas.view.sees(&p.bounds, 1.0)) {
        outline.polyline(canvas.view, &segment.points);
    }
    canvas.stroke(outline, rgb, 1.0, canvas.px(width_m, min_px), false);
}

/// Cuts a line into segments of a few points that share their ends.
fn chunks(line: &[Point2]) -> Vec<Segment> {
    let starts = (0..line.len().saturating_sub(1)).step_by(CHUNK_POINTS);
    starts.map(|i| Segment::new(line[i..line.len().min(i + CHUNK_POINTS + 1)].to_vec())).collect()
}

/// The edges of a polygon, in segments.
fn kerbs(polygon: &Polygon) -> Vec<Segment> {
    let closed = |ring: &[Point2]| ring.iter().chain(ring.first()).copied().collect::<Vec<_>>();
    polygon.rings().flat_map(|ring| chunks(&closed(ring))).collect()
}

/// Lays dashes along a line.
fn dashes(line: &[Point2], (dash_m, gap_m): (Real, Real)) -> Vec<Segment> {
    let length_m: Real = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    if length_m / (dash_m + gap_m) > MAX_SEGMENTS {
        return chunks(line);
    }
    let mut out = Vec::new();
    let (mut on, mut left_m) = (true, dash_m);
    let mut dash: Vec<Point2> = line.first().copied().into_iter().collect();
    for w in line.windows(2) {
        let segment_m = (w[1] - w[0]).norm();
        let mut done_m = 0.0;
        while segment_m - done_m > left_m {
            done_m += left_m;
            let at = w[0] + (w[1] - w[0]) * (done_m / segment_m);
            dash.push(at);
            if on {
                out.push(Segment::new(std::mem::take(&mut dash)));
            }
            on = !on;
            left_m = if on { dash_m } else { gap_m };
        }
        left_m -= segment_m - done_m;
        if on {
            dash.push(w[1]);
        }
    }
    if dash.len() >= 2 {
        out.push(Segment::new(dash));
    }
    out
}

/// Lays small arrows along a lane: the direction of traffic.
fn chevrons(line: &[Point2]) -> Vec<Segment> {
    let length_m: Real = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let mut out = Vec::new();
    if length_m / CHEVRON_GAP_M > MAX_SEGMENTS {
        return out;
    }
    let mut left_m = 0.5 * CHEVRON_GAP_M;
    for w in line.windows(2) {
        let segment_m = (w[1] - w[0]).norm();
        while left_m <= segment_m && segment_m > 0.0 {
            let ahead = (w[1] - w[0]) / segment_m;
            let (tip, side) = (w[0] + ahead * left_m, Vector2::new(-ahead.y, ahead.x));
            let arm = |side: Vector2| tip - (ahead + side) * CHEVRON_M;
            out.push(Segment::new(vec![arm(side), tip, arm(-side)]));
            left_m += CHEVRON_GAP_M;
        }
        left_m -= segment_m;
    }
    out
}

/// Lays stripes over a crossing, at right angles to its longer extent (the way people walk).
fn stripes(crossing: &Polygon) -> Vec<Area> {
    let ring = &crossing.exterior;
    let along = longer_extent(ring);
    let spread = |axis: Vector2| {
        let dots = ring.iter().map(|p| p.coords.dot(&axis));
        dots.fold((Real::INFINITY, Real::NEG_INFINITY), |(lo, hi), d| (lo.min(d), hi.max(d)))
    };
    let (low, high) = spread(along);
    let period = 2.0 * STRIPE_M;
    let count = ((high - low) / period).floor();
    if !(1.0..=MAX_SEGMENTS).contains(&count) {
        return Vec::new();
    }
    // Centred, so that both ends of the crossing look the same.
    let start = low + 0.5 * (high - low - count * period + STRIPE_M);
    (0..count as usize)
        .filter_map(|i| {
            let from = start + i as Real * period;
            let cut = clip(&clip(ring, along, from), -along, -(from + STRIPE_M));
            (cut.len() >= 3).then(|| Area::new(&Polygon::from_exterior(cut)))
        })
        .collect()
}

/// Unit vector of the first principal axis of a ring's edges: each edge weighs as long as it is.
fn longer_extent(ring: &[Point2]) -> Vector2 {
    // Doubled angles: a direction and its opposite are one axis.
    let (mut c, mut s) = (0.0, 0.0);
    for (i, p) in ring.iter().enumerate() {
        let e = ring[(i + 1) % ring.len()] - p;
        let len = e.norm().max(1e-6);
        c += (e.x * e.x - e.y * e.y) / len;
        s += 2.0 * e.x * e.y / len;
    }
    let (sin, cos) = math::sin_cos(0.5 * math::atan2(s, c));
    Vector2::new(cos, sin)
}

/// The part of a ring where `axis · p >= from` (Sutherland and Hodgman, one plane).
fn clip(ring: &[Point2], axis: Vector2, from: Real) -> Vec<Point2> {
    let mut out = Vec::with_capacity(ring.len() + 4);
    for (i, p) in ring.iter().enumerate() {
        let q = ring[(i + 1) % ring.len()];
        let (dp, dq) = (p.coords.dot(&axis) - from, q.coords.dot(&axis) - from);
        if dp >= 0.0 {
            out.push(*p);
        }
        if (dp < 0.0) != (dq < 0.0) {
            out.push(p + (q - p) * (dp / (dp - dq)));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(xy: &[(Real, Real)]) -> Vec<Point2> {
        xy.iter().map(|(x, y)| Point2::new(*x, *y)).collect()
    }

    #[test]
    fn dashes_cover_the_line_in_the_ratio_asked_for_and_follow_its_bends() {
        let line = points(&[(0.0, 0.0), (10.0, 0.0), (10.0, 20.0)]);
        let laid = dashes(&line, (2.0, 3.0));
        assert_eq!(laid.len(), 6);
        let total: Real =
            laid.iter().map(|d| d.points.windows(2).map(|w| (w[1] - w[0]).norm()).sum::<Real>()).sum();
        assert!((total - 12.0).abs() < 1e-3);
        assert_eq!(laid[2].points, points(&[(10.0, 0.0), (10.0, 2.0)]));
    }

    #[test]
    fn chevrons_point_along_the_lane_at_even_ways() {
        let laid = chevrons(&points(&[(0.0, 0.0), (10.0, 0.0), (10.0, 30.0)]));
        let tips: Vec<Point2> = laid.iter().map(|c| c.points[1]).collect();
        assert_eq!(tips, points(&[(7.0, 0.0), (10.0, 11.0), (10.0, 25.0)]));
        assert!(laid[0].points[0].x < 7.0 && laid[0].points[2].x < 7.0);
        assert!(laid[1].points[0].y < 11.0 && laid[1].points[2].y < 11.0);
    }

    #[test]
    fn stripes_stand_across_the_way_people_walk() {
        let corners = points(&[(0.0, 0.0), (12.0, 0.0), (12.0, 3.0), (0.0, 3.0)]);
        let laid = stripes(&Polygon::from_exterior(corners));
        assert_eq!(laid.len(), 10);
        for s in &laid {
            let (xs, ys): (Vec<_>, Vec<_>) = s.rings[0].iter().map(|p| (p.x, p.y)).unzip();
            let width = |v: &[Real]| {
                v.iter().copied().fold(Real::MIN, Real::max) - v.iter().copied().fold(Real::MAX, Real::min)
            };
            assert!((width(&xs) - 0.55).abs() < 1e-3 && (width(&ys) - 3.0).abs() < 1e-3);
        }
    }
}
