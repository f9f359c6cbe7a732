//! Oriented boxes.

use super::{Point2, Real};

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
