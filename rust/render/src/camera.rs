//! Where the image is taken from.

use crate::error::{RenderError, Result};
use ccdiff_sim::geom::{Point2, Real, Vector2, math};
use std::f32::consts::FRAC_PI_2;

/// Longest side of an image, pixels.
pub const MAX_SIDE_PX: u32 = 8192;
/// The `up_rad` of an image with +y (north) at the top.
pub const NORTH_UP_RAD: Real = FRAC_PI_2;

/// A camera that looks straight down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Point of the scene frame in the middle of the image, metres.
    pub centre: Point2,
    /// Direction of the scene frame that points to the top of the image, radians counter-clockwise from +x:
    /// [`NORTH_UP_RAD`], or the heading of an agent for a heading-up image.
    pub up_rad: Real,
    /// Scale, metres per pixel, > 0.
    pub metres_per_pixel: Real,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
}

impl Camera {
    /// North-up camera over a point, `span_m` metres across the image's width.
    pub fn over(centre: Point2, span_m: Real, width: u32, height: u32) -> Self {
        let metres_per_pixel = span_m / width.max(1) as Real;
        Self { centre, up_rad: NORTH_UP_RAD, metres_per_pixel, width, height }
    }

    /// The same camera turned so that a heading points to the top.
    #[must_use]
    pub fn heading_up(self, heading_rad: Real) -> Self {
        Self { up_rad: heading_rad, ..self }
    }

    /// Checks the camera and prepares its map from metres to pixels.
    pub(crate) fn view(&self) -> Result<View> {
        let sides = 1..=MAX_SIDE_PX;
        if !(sides.contains(&self.width) && sides.contains(&self.height)) {
            return Err(RenderError::size(self.width, self.height));
        }
        let fail = |field, got, expected: &str| Err(RenderError::value(field, got, expected));
        if !self.centre.coords.iter().all(|v| v.abs() < 1e6) {
            return fail("camera: centre", self.centre.to_string(), "finite numbers within 1000 km");
        }
        if !self.up_rad.is_finite() {
            return fail("camera: up_rad", self.up_rad.to_string(), "a finite angle");
        }
        if !(1e-4..=1e4).contains(&self.metres_per_pixel) {
            let got = self.metres_per_pixel.to_string();
            return fail("camera: metres_per_pixel", got, "0.0001 to 10000 metres");
        }
        let (sin, cos) = math::sin_cos(self.up_rad);
        let (width_px, height_px) = (self.width as Real, self.height as Real);
        Ok(View {
            centre: self.centre,
            up: Vector2::new(cos, sin),
            px_per_m: 1.0 / self.metres_per_pixel,
            half_px: Vector2::new(0.5 * width_px, 0.5 * height_px),
            reach_m: 0.5 * math::hypot(width_px, height_px) * self.metres_per_pixel,
        })
    }
}

/// A checked camera: the map from the scene frame (metres, y up) to the image (pixels, y down).
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    centre: Point2,
    up: Vector2,
    /// Pixels per metre.
    pub(crate) px_per_m: Real,
    half_px: Vector2,
    /// Radius of the circle round what the image shows, metres.
    reach_m: Real,
}

impl View {
    /// A point of the scene frame in pixels.
    #[inline]
    pub(crate) fn to_px(self, p: Point2) -> (f32, f32) {
        let d = p - self.centre;
        let right = d.x * self.up.y - d.y * self.up.x;
        let up = d.x * self.up.x + d.y * self.up.y;
        (self.half_px.x + right * self.px_per_m, self.half_px.y - up * self.px_per_m)
    }

    /// Whether bounds, widened by a margin in metres, can touch the image.
    pub(crate) fn sees(self, bounds: &Bounds, margin_m: Real) -> bool {
        let reach = self.reach_m + margin_m;
        bounds.max.x >= self.centre.x - reach
            && bounds.min.x <= self.centre.x + reach
            && bounds.max.y >= self.centre.y - reach
            && bounds.min.y <= self.centre.y + reach
    }
}

/// Axis-aligned bounds in the scene frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    min: Point2,
    max: Point2,
}

impl Bounds {
    /// Bounds of points; of no points, bounds that nothing sees.
    pub(crate) fn of(points: &[Point2]) -> Self {
        let start = Self {
            min: Point2::new(Real::INFINITY, Real::INFINITY),
            max: Point2::new(Real::NEG_INFINITY, Real::NEG_INFINITY),
        };
        points.iter().fold(start, |b, p| Self {
            min: Point2::new(b.min.x.min(p.x), b.min.y.min(p.y)),
            max: Point2::new(b.max.x.max(p.x), b.max.y.max(p.y)),
        })
    }
}
