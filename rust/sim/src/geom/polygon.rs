//! Simple polygons with holes.

use super::{Point2, Real};
use serde::{Deserialize, Serialize};

/// Points this near to a ring count as inside, metres.
pub const BOUNDARY_TOLERANCE_M: Real = 1e-4;

/// A polygon: outer ring and holes, rings not closed (the last point is joined to the first).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Polygon {
    /// Outer ring, metres.
    pub exterior: Vec<Point2>,
    /// Inner rings.
    pub holes: Vec<Vec<Point2>>,
}

/// Edges of a ring, the closing one included; nothing for fewer than two points.
pub(crate) fn ring_edges(ring: &[Point2]) -> impl Iterator<Item = (Point2, Point2)> + '_ {
    let closing = ring.last().copied().filter(|_| ring.len() > 1);
    closing.into_iter().chain(ring.iter().copied()).zip(ring.iter().copied())
}

/// [`Polygon::contains`] by some edges of its rings; `inside` by those that are left out.
pub(crate) fn even_odd(
    mut inside: bool,
    edges: impl Iterator<Item = (Point2, Point2)>,
    point: Point2,
) -> bool {
    for (a, b) in edges {
        let (a, b) = (a - point, b - point);
        if near_origin(a.x, a.y, b.x, b.y) {
            return true;
        }
        if (a.y > 0.0) != (b.y > 0.0) {
            // the edge crosses the ray to +x where its intersection with y = 0 has x > 0
            let cross = a.x * b.y - a.y * b.x;
            inside ^= (cross > 0.0) == (b.y > a.y);
        }
    }
    inside
}

impl Polygon {
    /// Polygon without holes.
    pub fn from_exterior(exterior: Vec<Point2>) -> Self {
        Self { exterior, holes: Vec::new() }
    }

    /// Outer ring, then the holes.
    pub fn rings(&self) -> impl Iterator<Item = &[Point2]> {
        std::iter::once(self.exterior.as_slice()).chain(self.holes.iter().map(Vec::as_slice))
    }

    /// Whether a point is inside by the even-odd rule over all rings; within 0.1 mm of a ring counts as inside.
    ///
    /// Linear in the number of points: for many queries build a [`super::Region`].
    pub fn contains(&self, point: Point2) -> bool {
        even_odd(false, self.rings().flat_map(ring_edges), point)
    }

    /// Area of the outer ring minus that of the holes, square metres.
    pub fn area(&self) -> Real {
        let mut rings = self.rings().map(|ring| signed_area(ring).abs());
        let exterior = rings.next().unwrap_or(0.0);
        (exterior - rings.sum::<f64>()) as Real
    }

    /// Lower left and upper right corner of the box round the outer ring; `None` when it has no points.
    pub fn bounds(&self) -> Option<(Point2, Point2)> {
        super::bounds(self.exterior.iter().copied())
    }

    /// The part of the polygon in an axis-aligned rectangle; `None` where nothing is left.
    ///
    /// Sutherland and Hodgman (CACM 1974), ring by ring. Parts of a concave polygon stay joined by edges along the
    /// rectangle's sides; these enclose no area, so [`Self::contains`] and [`Self::area`] are right all the same.
    pub fn clip_to_rect(&self, min: Point2, max: Point2) -> Option<Self> {
        let exterior = clip_ring(&self.exterior, min, max);
        if exterior.len() < 3 {
            return None;
        }
        let holes = self.holes.iter().map(|h| clip_ring(h, min, max)).filter(|h| h.len() >= 3).collect();
        Some(Self { exterior, holes })
    }
}

/// Squared distance of a point from the edge between two others.
pub(crate) fn edge_distance_sq(a: Point2, b: Point2, point: Point2) -> Real {
    let (way, to) = (b - a, point - a);
    let share = to.dot(&way) / way.norm_squared().max(Real::MIN_POSITIVE);
    (to - way * share.clamp(0.0, 1.0)).norm_squared()
}

/// Whether the origin lies within the boundary tolerance of the segment from (ax, ay) to (bx, by).
#[inline]
pub(crate) fn near_origin(ax: Real, ay: Real, bx: Real, by: Real) -> bool {
    const TOLERANCE_SQ: Real = BOUNDARY_TOLERANCE_M * BOUNDARY_TOLERANCE_M;
    let (dx, dy) = (bx - ax, by - ay);
    let length_sq = dx * dx + dy * dy;
    let cross = ax * by - ay * bx;
    if cross * cross > TOLERANCE_SQ * length_sq {
        return false;
    }
    let along = if length_sq > 0.0 { (-(ax * dx + ay * dy) / length_sq).clamp(0.0, 1.0) } else { 0.0 };
    let (x, y) = (ax + along * dx, ay + along * dy);
    x * x + y * y <= TOLERANCE_SQ
}

/// Area of a ring, square metres; negative where it runs clockwise.
pub(crate) fn signed_area(ring: &[Point2]) -> f64 {
    let Some(origin) = ring.first() else { return 0.0 };
    let local = |p: Point2| (f64::from(p.x - origin.x), f64::from(p.y - origin.y));
    let twice: f64 = ring_edges(ring)
        .map(|(a, b)| {
            let ((ax, ay), (bx, by)) = (local(a), local(b));
            ax * by - ay * bx
        })
        .sum();
    0.5 * twice
}

fn clip_ring(ring: &[Point2], min: Point2, max: Point2) -> Vec<Point2> {
    let mut points = clip_side(ring, |p| p.x - min.x);
    points = clip_side(&points, |p| max.x - p.x);
    points = clip_side(&points, |p| p.y - min.y);
    points = clip_side(&points, |p| max.y - p.y);
    points.dedup();
    points
}

/// The part of a ring in a half plane, given by the signed distance into it.
fn clip_side(ring: &[Point2], distance: impl Fn(&Point2) -> Real) -> Vec<Point2> {
    let mut kept = Vec::with_capacity(ring.len() + 4);
    let Some(mut a) = ring.last().copied().filter(|_| ring.len() > 1) else { return kept };
    let mut da = distance(&a);
    for b in ring {
        let db = distance(b);
        if (da >= 0.0) != (db >= 0.0) {
            kept.push(a + (b - a) * (da / (da - db)));
        }
        if db >= 0.0 {
            kept.push(*b);
        }
        (a, da) = (*b, db);
    }
    kept
}
