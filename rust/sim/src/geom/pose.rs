//! Position and heading.

use super::{Point2, Real, Vector2, math};
use serde::{Deserialize, Serialize};

/// A pose in a frame; also the transform from the pose's own frame to that frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    /// Position, metres.
    pub position: Point2,
    /// Heading, radians counter-clockwise from +x.
    pub heading_rad: Real,
    /// Cosine of the heading, kept so that it is computed once.
    pub cos: Real,
    /// Sine of the heading.
    pub sin: Real,
}

impl Pose2 {
    /// Pose from x, y (metres) and heading (radians).
    #[inline]
    pub fn new(x: Real, y: Real, heading_rad: Real) -> Self {
        let (sin, cos) = math::sin_cos(heading_rad);
        Self { position: Point2::new(x, y), heading_rad, cos, sin }
    }

    /// Rotates a vector of the pose's own frame into the outer frame.
    #[inline]
    pub fn rotate(&self, v: Vector2) -> Vector2 {
        Vector2::new(self.cos * v.x - self.sin * v.y, self.sin * v.x + self.cos * v.y)
    }

    /// Rotates a vector of the outer frame into the pose's own frame.
    #[inline]
    pub fn rotate_inverse(&self, v: Vector2) -> Vector2 {
        Vector2::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x)
    }

    /// A point of the pose's own frame in the outer frame.
    #[inline]
    pub fn to_outer(&self, p: Point2) -> Point2 {
        self.position + self.rotate(p.coords)
    }

    /// A point of the outer frame in the pose's own frame.
    #[inline]
    pub fn to_local(&self, p: Point2) -> Point2 {
        Point2::from(self.rotate_inverse(p - self.position))
    }
}
