//! Lines of points: arc length, points along, projection onto.

use super::{Point2, Pose2, Real, Vector2, math};
use crate::simd_dispatch::simd_dispatch;

/// Points nearer to each other than this count as one, metres.
const MIN_SPACING_M: Real = 1e-3;
/// Points from one that is looked at to the next, see [`Polyline::project_sparsely`].
const SPARSE: usize = 4;

/// A line through at least two distinct points, with arc length. Immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyline {
    /// P distinct points.
    points: Vec<Point2>,
    /// Arc length at each point, metres [P].
    s_m: Vec<Real>,
    /// Unit direction and heading of each segment [P - 1].
    directions: Vec<(Vector2, Real)>,
    /// The segments once more, for searches.
    segments: Segments,
    /// Segment at each multiple of `bin_m` along the line, so that a position is found without a search.
    bins: Vec<u32>,
    /// Spacing of `bins`, metres.
    bin_m: Real,
}

/// Segments as columns of numbers [P - 1]: start, unit direction, length.
#[derive(Debug, Clone, PartialEq)]
struct Segments {
    x: Vec<Real>,
    y: Vec<Real>,
    cos: Vec<Real>,
    sin: Vec<Real>,
    length_m: Vec<Real>,
}

impl Segments {
    fn new(points: &[Point2], s_m: &[Real], directions: &[(Vector2, Real)]) -> Self {
        let column = |of: &dyn Fn(usize) -> Real| (0..directions.len()).map(of).collect();
        Self {
            x: column(&|i| points[i].x),
            y: column(&|i| points[i].y),
            cos: column(&|i| directions[i].0.x),
            sin: column(&|i| directions[i].0.y),
            length_m: column(&|i| s_m[i + 1] - s_m[i]),
        }
    }
}

/// The nearest point of a segment to one at (x, y) from its start: squared distance, and arc length from the start.
#[inline(always)]
fn nearest_on(x: Real, y: Real, cos: Real, sin: Real, length_m: Real) -> (Real, Real) {
    let along = x * cos + y * sin;
    // one instruction each, which `min` and `max` are not
    let along = if along < length_m { along } else { length_m };
    let along = if along > 0.0 { along } else { 0.0 };
    let (x, y) = (x - cos * along, y - sin * along);
    (x * x + y * y, along)
}

#[derive(Debug, Clone, Copy)]
struct Nearest {
    distance_sq: Real,
    segment_idx: usize,
    along_m: Real,
}

/// Segments that are looked at together.
const LANES: usize = 8;

/// Puts the nearest of some segments in the place of `best` if it is nearer; the first of those equally near.
#[inline(always)]
fn nearest_of(segments: &Segments, first: usize, end: usize, point: Point2, best: &mut Nearest) {
    let [x, y, cos, sin, length_m] =
        [&segments.x, &segments.y, &segments.cos, &segments.sin, &segments.length_m]
            .map(|column| column[first..end].as_chunks::<LANES>().0);
    let mut distance_sq = [best.distance_sq; LANES];
    let (mut along_m, mut blocks) = ([0.0; LANES], [0u32; LANES]);
    for block in 0..x.len() {
        for lane in 0..LANES {
            let (x, y) = (point.x - x[block][lane], point.y - y[block][lane]);
            let (d, along) = nearest_on(x, y, cos[block][lane], sin[block][lane], length_m[block][lane]);
            let nearer = d < distance_sq[lane];
            distance_sq[lane] = if nearer { d } else { distance_sq[lane] };
            along_m[lane] = if nearer { along } else { along_m[lane] };
            blocks[lane] = if nearer { block as u32 } else { blocks[lane] };
        }
    }
    for lane in 0..LANES {
        let segment_idx = first + blocks[lane] as usize * LANES + lane;
        let d = distance_sq[lane];
        if d < best.distance_sq || (d == best.distance_sq && segment_idx < best.segment_idx) {
            *best = Nearest { distance_sq: d, segment_idx, along_m: along_m[lane] };
        }
    }
    for segment_idx in first + x.len() * LANES..end {
        let (x, y) = (point.x - segments.x[segment_idx], point.y - segments.y[segment_idx]);
        let (cos, sin) = (segments.cos[segment_idx], segments.sin[segment_idx]);
        let (d, along_m) = nearest_on(x, y, cos, sin, segments.length_m[segment_idx]);
        if d < best.distance_sq {
            *best = Nearest { distance_sq: d, segment_idx, along_m };
        }
    }
}

simd_dispatch! {
    /// See [`nearest_of`].
    fn nearest_segment(segments: &Segments, first: usize, end: usize, point: Point2, best: &mut Nearest) {
        nearest_of(segments, first, end, point, best);
    }

    /// The nearest segment to each of up to eight places among those next to the nearest of every fourth point from the
    /// start of segment `first` to that of `last`.
    fn nearest_segments(
        segments: &Segments, first: usize, last: usize, places: &[Point2], nearest: &mut [Nearest; LANES],
    ) {
        let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
        for (lane, place) in places.iter().enumerate().take(LANES) {
            (x[lane], y[lane]) = (place.x, place.y);
        }
        let mut least_sq = [Real::INFINITY; LANES];
        let mut best = [0u32; LANES];
        let starts = segments.x[first..=last].iter().zip(&segments.y[first..=last]);
        for (k, (at_x, at_y)) in starts.step_by(SPARSE).enumerate() {
            for lane in 0..LANES {
                let (dx, dy) = (x[lane] - at_x, y[lane] - at_y);
                let d = dx * dx + dy * dy;
                let nearer = d < least_sq[lane];
                least_sq[lane] = if nearer { d } else { least_sq[lane] };
                best[lane] = if nearer { k as u32 } else { best[lane] };
            }
        }
        for (lane, (place, nearest)) in places.iter().zip(nearest).enumerate() {
            let at = first + best[lane] as usize * SPARSE;
            let from = at.saturating_sub(SPARSE).max(first);
            *nearest = Nearest { distance_sq: Real::INFINITY, segment_idx: from, along_m: 0.0 };
            nearest_of(segments, from, (at + SPARSE - 1).min(last) + 1, *place, nearest);
        }
    }
}

/// Where a point lies relative to a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point of the line, metres, in [0, length].
    pub s_m: Real,
    /// Offset from the (prolonged) segment, metres, left positive.
    pub lateral_m: Real,
    /// Distance to the nearest point of the line, metres; above |lateral| past the ends and outside of corners.
    pub distance_m: Real,
    /// Segment of the nearest point.
    pub segment_idx: usize,
}

impl Polyline {
    /// Line through the points in order, repeated points dropped; `None` when fewer than two distinct ones remain
    /// or a coordinate is not finite.
    pub fn new(mut points: Vec<Point2>) -> Option<Self> {
        if !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
            return None;
        }
        points.dedup_by(|next, kept| (*next - *kept).norm_squared() < MIN_SPACING_M * MIN_SPACING_M);
        if points.len() < 2 {
            return None;
        }
        let mut s_m = Vec::with_capacity(points.len());
        let mut directions = Vec::with_capacity(points.len() - 1);
        let mut total_m = 0.0_f64;
        s_m.push(0.0);
        for pair in points.windows(2) {
            let d = pair[1] - pair[0];
            let length_m = math::hypot(d.x, d.y);
            total_m += f64::from(length_m);
            s_m.push(total_m as Real);
            directions.push((d / length_m, math::atan2(d.y, d.x)));
        }
        let num_bins = 2 * directions.len();
        let bin_m = total_m as Real / num_bins as Real;
        let mut bins = Vec::with_capacity(num_bins);
        let mut segment = 0;
        for bin in 0..num_bins {
            while segment + 1 < directions.len() && s_m[segment + 1] <= bin as Real * bin_m {
                segment += 1;
            }
            bins.push(segment as u32);
        }
        let segments = Segments::new(&points, &s_m, &directions);
        Some(Self { points, s_m, directions, segments, bins, bin_m })
    }

    /// Straight line from a pose along its heading, at least a metre long.
    pub fn straight(pose: &Pose2, length_m: Real) -> Self {
        let length_m = if length_m.is_finite() { length_m.max(1.0) } else { 1.0 };
        let direction = Vector2::new(pose.cos, pose.sin);
        let points = vec![pose.position, pose.position + direction * length_m];
        let (s_m, directions) = (vec![0.0, length_m], vec![(direction, pose.heading_rad)]);
        let segments = Segments::new(&points, &s_m, &directions);
        Self { points, s_m, directions, segments, bins: vec![0, 0], bin_m: 0.5 * length_m }
    }

    /// Length, metres.
    #[inline]
    pub fn length_m(&self) -> Real {
        self.s_m.last().copied().unwrap_or(0.0)
    }

    /// The distinct points.
    pub fn points(&self) -> &[Point2] {
        &self.points
    }

    /// Arc length at each point of [`Self::points`], metres.
    pub fn arc_lengths_m(&self) -> &[Real] {
        &self.s_m
    }

    /// Segment that holds an arc length; the ends are clamped. Constant time on evenly spaced points.
    #[inline]
    pub fn segment_at(&self, s_m: Real) -> usize {
        // a NaN or negative arc length becomes bin 0
        let bin = ((s_m / self.bin_m) as u32 as usize).min(self.bins.len() - 1);
        let first = self.bins[bin] as usize;
        let ends = &self.s_m[first + 1..self.directions.len()];
        first + ends.iter().take_while(|end| **end < s_m).count()
    }

    /// Point and direction at an arc length, clamped to the ends. The heading lies in (−π, π].
    #[inline]
    pub fn at(&self, s_m: Real) -> Pose2 {
        let length_m = self.length_m();
        let s_m = if s_m < 0.0 { 0.0 } else { s_m };
        let s_m = if s_m > length_m { length_m } else { s_m };
        let segment = self.segment_at(s_m);
        let (direction, heading_rad) = self.directions[segment];
        let position = self.points[segment] + direction * (s_m - self.s_m[segment]);
        Pose2 { position, heading_rad, cos: direction.x, sin: direction.y }
    }

    /// Unit direction at an arc length, clamped to the ends.
    #[inline]
    pub fn tangent_at(&self, s_m: Real) -> Vector2 {
        self.directions[self.segment_at(s_m)].0
    }

    /// Nearest point of the whole line; the earliest one where several are equally near. Linear in P.
    pub fn project(&self, point: Point2) -> Projection {
        self.project_onto(point, 0, self.directions.len() - 1)
    }

    /// Nearest point among the segments that touch [hint − window, hint + window], metres of arc length.
    ///
    /// Cheap, and it stays on the right branch where a line crosses itself: made for following a line tick by tick.
    pub fn project_near(&self, point: Point2, hint_s_m: Real, window_m: Real) -> Projection {
        let first = self.segment_at(hint_s_m - window_m);
        let last = self.segment_at(hint_s_m + window_m).max(first);
        self.project_onto(point, first, last)
    }

    /// As [`Self::project_near`] of many points, but only the segments next to the nearest of every fourth point of the
    /// line are looked at. Fills `out` [points].
    ///
    /// For wide windows and lines of evenly spaced points that bend little within four of them: there it finds what
    /// `project_near` finds, except where two places of the line are about equally near.
    pub fn project_sparsely(
        &self,
        points: &[Point2],
        hint_s_m: Real,
        window_m: Real,
        out: &mut Vec<Projection>,
    ) {
        let first = self.segment_at(hint_s_m - window_m);
        let last = self.segment_at(hint_s_m + window_m).max(first);
        out.clear();
        let mut nearest = [Nearest { distance_sq: 0.0, segment_idx: first, along_m: 0.0 }; LANES];
        for places in points.chunks(LANES) {
            nearest_segments(&self.segments, first, last, places, &mut nearest);
            out.extend(places.iter().zip(&nearest).map(|(place, nearest)| self.projection(*place, nearest)));
        }
    }

    fn project_onto(&self, point: Point2, first: usize, last: usize) -> Projection {
        let mut best = Nearest { distance_sq: Real::INFINITY, segment_idx: first, along_m: 0.0 };
        nearest_segment(&self.segments, first, last + 1, point, &mut best);
        self.projection(point, &best)
    }

    #[inline]
    fn projection(&self, point: Point2, best: &Nearest) -> Projection {
        let direction = self.directions[best.segment_idx].0;
        let offset = point - self.points[best.segment_idx];
        Projection {
            s_m: self.s_m[best.segment_idx] + best.along_m,
            lateral_m: direction.x * offset.y - direction.y * offset.x,
            distance_m: best.distance_sq.sqrt(),
            segment_idx: best.segment_idx,
        }
    }
}
