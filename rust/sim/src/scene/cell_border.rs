//! Which points of a cell of a grid a surface holds, found without most of the edges of its polygon.

use crate::geom::{Point2, Polygon, Real, Vector2, edge_distance_sq, even_odd, math, ring_edges};

/// Parts of a cell, 8 x 8, that a surface holds whole, and parts with none of it; see `Grid::part`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Parts {
    inside: u64,
    outside: u64,
}

impl Parts {
    /// Of the cell round a centre; `look` tells whether a point is held, and how far from the surface's border it is, metres.
    pub(super) fn new(centre: Point2, cell_m: Real, look: impl Fn(Point2) -> (bool, Real)) -> Self {
        // half the diagonal of a part; the margins cover rounding
        let reach_m = 0.065 * math::hypot(cell_m, cell_m) + 0.01;
        let mut parts = Self { inside: 0, outside: 0 };
        for part in 0..64 {
            let at = |k: usize| (k as Real - 3.5) / 8.0 * cell_m;
            let (holds, clear_m) = look(centre + Vector2::new(at(part % 8), at(part / 8)));
            parts.inside |= u64::from(holds && clear_m > reach_m) << part;
            parts.outside |= u64::from(!holds && clear_m > reach_m) << part;
        }
        parts
    }

    /// Whether the surface holds a part; `None` where its border goes through it.
    #[inline]
    pub(super) fn at(&self, part: u32) -> Option<bool> {
        let is_inside = self.inside >> part & 1 == 1;
        (is_inside || self.outside >> part & 1 == 1).then_some(is_inside)
    }
}

/// Edges of a polygon near a cell, and how often the ray to +x crosses others beyond the cell.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Border {
    near: Vec<(Point2, Point2)>,
    /// Whether the ray from the lower side of the cell crosses an odd number beyond it, and the y at which that changes.
    is_odd: bool,
    turns_m: Vec<Real>,
}

impl Border {
    /// Of the cell within some corners.
    pub(super) fn new(polygon: &Polygon, low: Point2, high: Point2) -> Self {
        let (beyond, rest): (Vec<_>, Vec<_>) =
            polygon.rings().flat_map(ring_edges).partition(|(a, b)| a.x.min(b.x) > high.x);
        let is_near = |(a, b): &(Point2, Point2)| {
            a.x.max(b.x) >= low.x && a.y.min(b.y) <= high.y && a.y.max(b.y) >= low.y
        };
        // of a line that goes on, the first and the last point are left
        let mut ends_m: Vec<Real> = beyond.iter().flat_map(|(a, b)| [a.y, b.y]).collect();
        ends_m.sort_by(Real::total_cmp);
        let odd = ends_m.chunk_by(|a, b| a == b).filter(|same| same.len() % 2 == 1).map(|same| same[0]);
        let (below, turns_m): (Vec<Real>, _) = odd.filter(|y| *y <= high.y).partition(|y| *y < low.y);
        Self { near: rest.into_iter().filter(is_near).collect(), is_odd: below.len() % 2 == 1, turns_m }
    }

    /// As `Polygon::contains`, of a point of the cell.
    pub(super) fn holds(&self, point: Point2) -> bool {
        let is_odd = self.turns_m.iter().fold(self.is_odd, |odd, turn_m| odd ^ (*turn_m <= point.y));
        even_odd(is_odd, self.near.iter().copied(), point)
    }

    /// Distance of a point of the cell to the edges near it, metres.
    pub(super) fn distance_m(&self, point: Point2) -> Real {
        let distances_sq = self.near.iter().map(|(a, b)| edge_distance_sq(*a, *b, point));
        distances_sq.fold(Real::INFINITY, Real::min).sqrt()
    }
}
