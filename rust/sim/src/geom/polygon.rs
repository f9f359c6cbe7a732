//! Simple polygons with holes.

use super::Point2;
use serde::{Deserialize, Serialize};

/// A polygon: outer ring and holes, rings not closed (the last point is joined to the first).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Polygon {
    /// Outer ring, metres.
    pub exterior: Vec<Point2>,
    /// Inner rings.
    pub holes: Vec<Vec<Point2>>,
}
