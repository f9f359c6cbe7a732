//! Oriented boxes: overlap, containment, time to contact, edges inside another box.
//!
//! All tests are separating-axis tests on the four face normals, which is exact for two rectangles (Gottschalk,
//! Lin and Manocha, "OBBTree", SIGGRAPH 1996, in the plane). Touching counts as overlapping.

use super::{Point2, Real, Vector2};

/// How far outside a box an edge may lie and still count as running along it, metres (rounding of f32 poses).
const EDGE_TOLERANCE_M: Real = 1e-3;

/// A rectangle with a heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientedBox {
    /// Centre.
    pub centre: Point2,
    /// Cosine of the heading.
    pub cos: Real,
    /// Sine of the heading.
    pub sin: Real,
    /// Half the length (along the heading), metres.
    pub half_length_m: Real,
    /// Half the width, metres.
    pub half_width_m: Real,
}

/// Another box as seen by one box: what every separating-axis test of the pair needs.
struct Relative {
    /// Centre of the other box in the frame of the first.
    in_first: Vector2,
    /// Centre difference (other minus first) in the frame of the other box.
    in_other: Vector2,
    /// Half extents of the pair added up along the four axes: first's length and width, other's length and width.
    reach: [Real; 4],
}

impl OrientedBox {
    /// Unit vector along the heading.
    #[inline]
    pub fn forward(&self) -> Vector2 {
        Vector2::new(self.cos, self.sin)
    }

    /// Rotates a vector of the outer frame into the box's own frame.
    #[inline]
    fn rotate_inverse(&self, v: Vector2) -> Vector2 {
        Vector2::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x)
    }

    /// Corners counter-clockwise from the front left: front left, rear left, rear right, front right.
    #[inline]
    pub fn corners(&self) -> [Point2; 4] {
        let along = Vector2::new(self.cos * self.half_length_m, self.sin * self.half_length_m);
        let left = Vector2::new(-self.sin * self.half_width_m, self.cos * self.half_width_m);
        let c = self.centre;
        [c + along + left, c - along + left, c - along - left, c + along - left]
    }

    #[inline]
    fn relative(&self, other: &Self) -> Relative {
        let offset = other.centre - self.centre;
        // cosine and sine of the heading difference, without their signs
        let c = (self.cos * other.cos + self.sin * other.sin).abs();
        let s = (self.cos * other.sin - self.sin * other.cos).abs();
        Relative {
            in_first: self.rotate_inverse(offset),
            in_other: other.rotate_inverse(offset),
            reach: [
                self.half_length_m + other.half_length_m * c + other.half_width_m * s,
                self.half_width_m + other.half_length_m * s + other.half_width_m * c,
                other.half_length_m + self.half_length_m * c + self.half_width_m * s,
                other.half_width_m + self.half_length_m * s + self.half_width_m * c,
            ],
        }
    }

    /// Whether two boxes share a point; touching and containment count.
    #[inline]
    pub fn overlaps(&self, other: &Self) -> bool {
        let r = self.relative(other);
        (r.in_first.x.abs() <= r.reach[0])
            & (r.in_first.y.abs() <= r.reach[1])
            & (r.in_other.x.abs() <= r.reach[2])
            & (r.in_other.y.abs() <= r.reach[3])
    }

    /// First time at which two boxes that keep their headings and velocities touch, seconds.
    ///
    /// 0 when they touch already, `None` when they do not touch within `horizon_s`. Exact: on each of the four
    /// axes the shadows overlap during one time interval; the boxes overlap while all four do.
    pub fn time_to_contact(
        &self,
        velocity: Vector2,
        other: &Self,
        other_velocity: Vector2,
        horizon_s: Real,
    ) -> Option<Real> {
        let (offset, closing) = (other.centre - self.centre, other_velocity - velocity);
        // most pairs go out here: circles round the boxes that never meet
        let circles_m =
            1.001 * (self.half_length_m + self.half_width_m + other.half_length_m + other.half_width_m);
        let (gap_sq, reach_sq) = (offset.norm_squared(), circles_m * circles_m);
        if gap_sq > reach_sq {
            let miss = offset.x * closing.y - offset.y * closing.x;
            if offset.dot(&closing) >= 0.0 || miss * miss > reach_sq * closing.norm_squared() {
                return None;
            }
        }
        let r = self.relative(other);
        let (in_first, in_other) = (self.rotate_inverse(closing), other.rotate_inverse(closing));
        let axes = [
            (r.in_first.x, in_first.x, r.reach[0]),
            (r.in_first.y, in_first.y, r.reach[1]),
            (r.in_other.x, in_other.x, r.reach[2]),
            (r.in_other.y, in_other.y, r.reach[3]),
        ];
        let (mut enter_s, mut exit_s): (Real, Real) = (0.0, horizon_s);
        for (distance, speed, reach) in axes {
            if speed.abs() < 1e-9 {
                if distance.abs() > reach {
                    return None;
                }
                continue;
            }
            let s_per_m = speed.recip();
            let (t0, t1) = ((-reach - distance) * s_per_m, (reach - distance) * s_per_m);
            enter_s = enter_s.max(t0.min(t1));
            exit_s = exit_s.min(t0.max(t1));
            if enter_s > exit_s {
                return None;
            }
        }
        Some(enter_s)
    }

    /// Lengths of the parts of this box's edges that lie in another box, metres: front, left, rear, right.
    ///
    /// Edges within a millimetre of the other box count, so that boxes that just touch have a touched edge.
    pub fn edge_lengths_inside(&self, other: &Self) -> [Real; 4] {
        let [front_left, rear_left, rear_right, front_right] =
            self.corners().map(|corner| other.rotate_inverse(corner - other.centre));
        [
            (front_right, front_left),
            (front_left, rear_left),
            (rear_left, rear_right),
            (rear_right, front_right),
        ]
        .map(|(a, b)| other.length_inside(a, b))
    }

    /// Length of the part of the segment a b, given in this box's own frame, that lies in the box.
    fn length_inside(&self, a: Vector2, b: Vector2) -> Real {
        let d = b - a;
        let (mut from, mut to): (Real, Real) = (0.0, 1.0);
        for (start, slope, half) in [(a.x, d.x, self.half_length_m), (a.y, d.y, self.half_width_m)] {
            let half = half + EDGE_TOLERANCE_M;
            if slope.abs() < 1e-9 {
                if start.abs() > half {
                    return 0.0;
                }
                continue;
            }
            let (t0, t1) = ((-half - start) / slope, (half - start) / slope);
            from = from.max(t0.min(t1));
            to = to.min(t0.max(t1));
        }
        (to - from).max(0.0) * super::math::hypot(d.x, d.y)
    }

    /// Direction in which the two boxes overlap least, pointing from this box to the other; a unit vector.
    pub fn contact_normal(&self, other: &Self) -> Vector2 {
        let r = self.relative(other);
        let axes = [
            (r.in_first.x, r.reach[0], self.forward()),
            (r.in_first.y, r.reach[1], Vector2::new(-self.sin, self.cos)),
            (r.in_other.x, r.reach[2], other.forward()),
            (r.in_other.y, r.reach[3], Vector2::new(-other.sin, other.cos)),
        ];
        let mut best = (Real::INFINITY, Vector2::zeros());
        for (distance, reach, axis) in axes {
            let depth = reach - distance.abs();
            if depth < best.0 {
                best = (depth, if distance < 0.0 { -axis } else { axis });
            }
        }
        best.1
    }
}
