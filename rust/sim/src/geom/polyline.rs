//! Lines of points: arc length, points along, projection onto.

use super::{Point2, Pose2, Real, Vector2, math};
use crate::simd_dispatch::{pick, simd_dispatch};

/// Points nearer to each other than this count as one, metres.
const MIN_SPACING_M: Real = 1e-3;
/// Points from one that is looked at to the next, see [`Polyline::project_sparsely`].
const SPARSE: usize = 4;

/// A line through at least two distinct points, with arc length. Immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyline {
    points: Vec<Point2>,
    /// Arc length at each point, metres [P].
    s_m: Vec<Real>,
    length_m: Real,
    /// The segments one by one, for places along the line [P - 1].
    parts: Vec<Part>,
    /// The segments once more, for searches.
    segments: Segments,
    /// Segment at each multiple of `bin_m` along the line, so that a position is found without a search.
    bins: Vec<u32>,
    /// Spacing of `bins`, metres.
    bin_m: Real,
}

/// A segment, all of it in one line of the cache.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
struct Part {
    start: Point2,
    direction: Vector2,
    heading_rad: Real,
    /// Arc length at the start, and up to which the segment goes: for ever for the last one.
    s_m: Real,
    end_s_m: Real,
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
    fn new(parts: &[Part], s_m: &[Real]) -> Self {
        let column = |of: fn(&Part) -> Real| parts.iter().map(of).collect();
        Self {
            x: column(|part| part.start.x),
            y: column(|part| part.start.y),
            cos: column(|part| part.direction.x),
            sin: column(|part| part.direction.y),
            length_m: s_m.windows(2).map(|ends| ends[1] - ends[0]).collect(),
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

/// The nearest of some segments; the first of those equally near.
#[inline(always)]
fn nearest_of(segments: &Segments, first: usize, end: usize, point: Point2) -> Nearest {
    let [x, y, cos, sin, length_m] =
        [&segments.x, &segments.y, &segments.cos, &segments.sin, &segments.length_m]
            .map(|column| &column[first..end]);
    let num_segments = x.len();
    let mut best = Nearest { distance_sq: Real::INFINITY, segment_idx: first, along_m: 0.0 };
    if num_segments < LANES {
        for i in 0..num_segments {
            let (d, along_m) = nearest_on(point.x - x[i], point.y - y[i], cos[i], sin[i], length_m[i]);
            if d < best.distance_sq {
                best = Nearest { distance_sq: d, segment_idx: first + i, along_m };
            }
        }
        return best;
    }
    let (mut distance_sq, mut along_m) = ([Real::INFINITY; LANES], [0.0; LANES]);
    let mut froms = [0u32; LANES];
    for block in 0..num_segments.div_ceil(LANES) {
        // the last eight overlap those before
        let from = (block * LANES).min(num_segments - LANES);
        let (x, y, cos) = (&x[from..][..LANES], &y[from..][..LANES], &cos[from..][..LANES]);
        let (sin, length_m) = (&sin[from..][..LANES], &length_m[from..][..LANES]);
        for lane in 0..LANES {
            let (x, y) = (point.x - x[lane], point.y - y[lane]);
            let (d, along) = nearest_on(x, y, cos[lane], sin[lane], length_m[lane]);
            let nearer = u32::from(d < distance_sq[lane]).wrapping_neg();
            distance_sq[lane] = pick(nearer, d, distance_sq[lane]);
            along_m[lane] = pick(nearer, along, along_m[lane]);
            froms[lane] = from as u32 & nearer | froms[lane] & !nearer;
        }
    }
    // distances are not negative, so their bits sort as they do
    let key = |lane: usize| {
        let at = u64::from(froms[lane]) + lane as u64;
        u64::from(distance_sq[lane].to_bits()) << 32 | at << 3 | lane as u64
    };
    let least = (0..LANES).map(key).fold(u64::MAX, u64::min);
    let (distance_sq, at) = (Real::from_bits((least >> 32) as u32), least as u32 as usize);
    Nearest { distance_sq, segment_idx: first + (at >> 3), along_m: along_m[at % LANES] }
}

simd_dispatch! {
    fn nearest_segment(segments: &Segments, first: usize, end: usize, point: Point2, best: &mut Nearest) {
        *best = nearest_of(segments, first, end, point);
    }

    /// The nearest segment to each of up to eight places among those next to the nearest of every fourth point.
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
                let nearer = u32::from(d < least_sq[lane]).wrapping_neg();
                least_sq[lane] = pick(nearer, d, least_sq[lane]);
                best[lane] = k as u32 & nearer | best[lane] & !nearer;
            }
        }
        for (lane, (place, nearest)) in places.iter().zip(nearest).enumerate() {
            let at = first + best[lane] as usize * SPARSE;
            let from = at.saturating_sub(SPARSE).max(first);
            *nearest = nearest_of(segments, from, (at + SPARSE - 1).min(last) + 1, *place);
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
        Some(Self::of(points, s_m, &directions, bins, bin_m))
    }

    fn of(
        points: Vec<Point2>,
        s_m: Vec<Real>,
        directions: &[(Vector2, Real)],
        bins: Vec<u32>,
        bin_m: Real,
    ) -> Self {
        let part = |(i, (direction, heading_rad)): (usize, &(Vector2, Real))| {
            let end_s_m = if i + 1 < directions.len() { s_m[i + 1] } else { Real::INFINITY };
            let (direction, heading_rad) = (*direction, *heading_rad);
            Part { start: points[i], direction, heading_rad, s_m: s_m[i], end_s_m }
        };
        let parts: Vec<Part> = directions.iter().enumerate().map(part).collect();
        let (segments, length_m) = (Segments::new(&parts, &s_m), s_m[directions.len()]);
        Self { points, s_m, length_m, parts, segments, bins, bin_m }
    }

    /// Straight line from a pose along its heading, at least a metre long.
    pub fn straight(pose: &Pose2, length_m: Real) -> Self {
        let length_m = if length_m.is_finite() { length_m.max(1.0) } else { 1.0 };
        let direction = Vector2::new(pose.cos, pose.sin);
        let points = vec![pose.position, pose.position + direction * length_m];
        let s_m = vec![0.0, length_m];
        Self::of(points, s_m, &[(direction, pose.heading_rad)], vec![0, 0], 0.5 * length_m)
    }

    /// Length, metres.
    #[inline]
    pub fn length_m(&self) -> Real {
        self.length_m
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
        // it is hardly ever more than one: no branch to guess
        let mut segment = first + usize::from(self.parts[first].end_s_m < s_m);
        while self.parts[segment].end_s_m < s_m {
            segment += 1;
        }
        segment
    }

    /// Point and direction at an arc length, clamped to the ends. The heading lies in (−π, π].
    #[inline]
    pub fn at(&self, s_m: Real) -> Pose2 {
        let s_m = if s_m < 0.0 { 0.0 } else { s_m };
        let s_m = if s_m > self.length_m { self.length_m } else { s_m };
        let Part { start, direction, heading_rad, s_m: start_s_m, .. } = self.parts[self.segment_at(s_m)];
        let position = start + direction * (s_m - start_s_m);
        Pose2 { position, heading_rad, cos: direction.x, sin: direction.y }
    }

    /// Unit direction at an arc length, clamped to the ends.
    #[inline]
    pub fn tangent_at(&self, s_m: Real) -> Vector2 {
        self.parts[self.segment_at(s_m)].direction
    }

    /// Nearest point of the whole line; the earliest one where several are equally near. Linear in P.
    pub fn project(&self, point: Point2) -> Projection {
        self.project_onto(point, 0, self.parts.len() - 1)
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
        let Part { start, direction, s_m, .. } = self.parts[best.segment_idx];
        let offset = point - start;
        Projection {
            s_m: s_m + best.along_m,
            lateral_m: direction.x * offset.y - direction.y * offset.x,
            distance_m: best.distance_sq.sqrt(),
            segment_idx: best.segment_idx,
        }
    }
}
