//! A piece of ground as pixels of eight flags, drawn from polygons and lines.

use super::{Point2, Polygon, Real};

/// Bounds of a bitmap's size; larger grounds get larger pixels.
const MAX_PX: Real = 16e6;

/// Flags of each pixel of a rectangle of the ground, row-major from the lower left; nothing is set outside.
#[derive(Debug, Clone, PartialEq)]
pub struct Bitmap {
    /// Lower left corner of the pixel (0, 0), metres.
    min: Point2,
    px_per_m: Real,
    width: usize,
    height: usize,
    /// The outermost pixels stay 0, so that whatever lies outside can be read from them.
    flags: Vec<u8>,
}

impl Bitmap {
    /// An empty bitmap from `min` to `max` with `px_per_m` pixels per metre, or fewer where it would not stay below
    /// 16 million pixels.
    pub fn new(min: Point2, max: Point2, px_per_m: Real) -> Self {
        let (width_m, height_m) = ((max.x - min.x).max(0.0), (max.y - min.y).max(0.0));
        let most =
            (MAX_PX / (width_m * height_m).max(1.0)).sqrt().min(MAX_PX / (width_m + height_m).max(1.0));
        let px_per_m = px_per_m.min(most);
        let count = |extent: Real| (extent * px_per_m).ceil() as usize + 2;
        let (width, height) = (count(width_m), count(height_m));
        let border_m = 1.0 / px_per_m;
        let min = Point2::new(min.x - border_m, min.y - border_m);
        Self { min, px_per_m, width, height, flags: vec![0; width * height] }
    }

    /// Pixels per metre.
    #[inline]
    pub fn px_per_m(&self) -> Real {
        self.px_per_m
    }

    /// Column and row of a point; their integer parts are those of its pixel.
    #[inline]
    pub fn to_px(&self, p: Point2) -> [Real; 2] {
        [(p.x - self.min.x) * self.px_per_m, (p.y - self.min.y) * self.px_per_m]
    }

    /// Flags of the pixel at a column and row; 0 outside and for NaN.
    #[inline]
    pub fn at_px(&self, column: Real, row: Real) -> u8 {
        // the conversion takes what is negative or NaN to 0, into the border
        let (column, row) = ((column as usize).min(self.width - 1), (row as usize).min(self.height - 1));
        self.flags[row * self.width + column]
    }

    /// Sets flags at every pixel whose centre lies in a polygon (even-odd over all rings).
    pub fn fill(&mut self, polygon: &Polygon, flags: u8) {
        if polygon.exterior.len() < 3 {
            return;
        }
        let rings: Vec<Vec<[Real; 2]>> = polygon
            .rings()
            .filter(|r| r.len() > 2)
            .map(|r| r.iter().map(|p| self.to_px(*p)).collect())
            .collect();
        let corners = || rings.iter().flatten();
        let (low, high) =
            corners().fold((Real::MAX, 0.0), |(l, h): (Real, Real), p| (l.min(p[1]), h.max(p[1])));
        let last = (high as usize).min(self.height - 2);
        let mut crossings: Vec<Real> = Vec::new();
        for row in (low as usize).max(1)..=last {
            let y = row as Real + 0.5;
            crossings.clear();
            for ring in &rings {
                for (k, a) in ring.iter().enumerate() {
                    let b = ring[(k + 1) % ring.len()];
                    if (a[1] > y) != (b[1] > y) {
                        crossings.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
                    }
                }
            }
            crossings.sort_by(Real::total_cmp);
            for span in crossings.chunks_exact(2) {
                let first = ((span[0] - 0.5).ceil() as usize).max(1);
                let end = (((span[1] + 0.5).floor()) as usize).min(self.width - 1);
                for column in first..end {
                    self.flags[row * self.width + column] |= flags;
                }
            }
        }
    }

    /// Sets flags along a line.
    pub fn stroke(&mut self, line: &[Point2], half_width_m: Real, flags: u8) {
        let half_width = half_width_m * self.px_per_m;
        for ends in line.windows(2) {
            let (a, b) = (self.to_px(ends[0]), self.to_px(ends[1]));
            let bounds = [self.width as Real - 1.0, self.height as Real - 1.0];
            visit_band(a, b, half_width, bounds, |x, y| {
                if x >= 1.0 && y >= 1.0 {
                    self.flags[y as usize * self.width + x as usize] |= flags;
                }
            });
        }
    }
}

/// Visits places at most half a pixel apart in the band round a segment and in the rectangle from the origin to `bounds`.
pub(crate) fn visit_band(
    a: [Real; 2],
    b: [Real; 2],
    half_width: Real,
    bounds: [Real; 2],
    mut visit: impl FnMut(Real, Real),
) {
    let outside = |i: usize| a[i].max(b[i]) + half_width < 0.0 || a[i].min(b[i]) - half_width >= bounds[i];
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length = (dx * dx + dy * dy).sqrt();
    if outside(0) || outside(1) || !(length > 1e-6 && length.is_finite()) {
        return;
    }
    let (ux, uy) = (dx / length, dy / length);
    let across = (half_width * 2.0).round() as i32;
    for step in 0..=(length * 2.0).ceil() as i32 {
        let s = (step as Real * 0.5).min(length);
        for side in -across..=across {
            let o = side as Real * 0.5;
            let (x, y) = (a[0] + s * ux - o * uy, a[1] + s * uy + o * ux);
            if x >= 0.0 && y >= 0.0 && x < bounds[0] && y < bounds[1] {
                visit(x, y);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_ground_gets_large_pixels() {
        let bitmap = Bitmap::new(Point2::new(-1e5, -1e5), Point2::new(1e5, 1e5), 10.0);
        assert!(bitmap.flags.len() < 17_000_000);
    }
}
