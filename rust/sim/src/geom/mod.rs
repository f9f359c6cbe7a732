//! Two-dimensional geometry of the ground plane.
//!
//! Frames: x east, y north, metres, radians counter-clockwise from +x. Everything here is pure and
//! bit-reproducible on every machine: transcendental functions come from [`math`], never from the
//! platform's C library.

mod bitmap;
mod boundary;
pub mod math;
mod obb;
mod polygon;
mod polyline;
mod pose;
mod region;

pub use bitmap::Bitmap;
pub(crate) use bitmap::visit_band;
pub use boundary::Boundary;
pub use obb::OrientedBox;
pub use polygon::{BOUNDARY_TOLERANCE_M, Polygon};
pub(crate) use polygon::{edge_distance_sq, even_odd, ring_edges, signed_area};
pub use polyline::{Polyline, Projection};
pub use pose::Pose2;
pub(crate) use region::Grid;
pub use region::Region;

/// Precision of the running simulation. Loaders work in f64 and recentre before they round.
pub type Real = f32;
/// A position in a frame, metres.
pub type Point2 = nalgebra::Point2<Real>;
/// A displacement or a velocity, metres or metres per second.
pub type Vector2 = nalgebra::Vector2<Real>;

/// Lower left and upper right corner of the box round some points; `None` without any.
pub fn bounds(points: impl IntoIterator<Item = Point2>) -> Option<(Point2, Point2)> {
    let mut points = points.into_iter();
    let first = points.next()?;
    Some(points.fold((first, first), |(lo, hi), p| {
        (Point2::new(lo.x.min(p.x), lo.y.min(p.y)), Point2::new(hi.x.max(p.x), hi.y.max(p.y)))
    }))
}
