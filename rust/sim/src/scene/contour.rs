//! Where a function on a grid is positive, as polygons: marching squares with linear interpolation (Lorensen and Cline 1987).

use crate::geom::{Point2, Polygon, Real, signed_area};

/// Distance between nodes, metres.
pub(super) const CELL_M: f64 = 0.5;
/// Points of a ring are left out where the line stays within this distance without them, metres.
const TOLERANCE_M: f64 = 0.04;
/// Sides of a cell (bottom, right, top, left) by their corners: lower left, lower right, upper right, upper left.
const SIDES: [[usize; 2]; 4] = [[0, 1], [1, 2], [3, 2], [0, 3]];

/// Polygons round the nodes with positive values; nodes on the border must not be positive.
pub(super) fn polygons(values: &[Real], columns: usize, min: [f64; 2]) -> Vec<Polygon> {
    let grid = Grid { values, columns, min };
    let rings = grid.rings();
    let areas: Vec<f64> = rings.iter().map(|ring| signed_area(ring)).collect();
    // outer rings run counter-clockwise, the largest first: a hole belongs to the smallest that holds it
    let mut outer: Vec<usize> = (0..rings.len()).filter(|i| areas[*i] > 0.0).collect();
    outer.sort_by(|a, b| areas[*b].total_cmp(&areas[*a]).then(a.cmp(b)));
    let mut polygons: Vec<Polygon> =
        outer.iter().map(|i| Polygon::from_exterior(rings[*i].clone())).collect();
    for hole in (0..rings.len()).filter(|i| areas[*i] < 0.0) {
        let holds =
            |polygon: &Polygon| Polygon::from_exterior(polygon.exterior.clone()).contains(rings[hole][0]);
        if let Some(owner) = polygons.iter().rposition(holds) {
            polygons[owner].holes.push(rings[hole].clone());
        }
    }
    polygons
}

struct Grid<'a> {
    values: &'a [Real],
    columns: usize,
    min: [f64; 2],
}

impl Grid<'_> {
    /// Closed lines with the positive side on their left.
    fn rings(&self) -> Vec<Vec<Point2>> {
        let mut steps = self.steps();
        steps.sort_unstable();
        let mut seen = vec![false; steps.len()];
        let mut rings = Vec::new();
        for first in 0..steps.len() {
            let (mut ring, mut here) = (Vec::new(), first);
            while !seen[here] {
                seen[here] = true;
                ring.push(self.crossing(steps[here].0));
                match steps.binary_search_by_key(&steps[here].1, |step| step.0) {
                    Ok(next) => here = next,
                    Err(_) => break,
                }
            }
            let ring = simplified(&ring);
            if ring.len() >= 3 {
                rings.push(ring);
            }
        }
        rings
    }

    /// Pairs of sides of a cell: a side is twice its lower or left node, plus one where it runs up.
    fn steps(&self) -> Vec<(usize, usize)> {
        let mut steps = Vec::new();
        let rows = self.values.len() / self.columns;
        for row in 0..rows.saturating_sub(1) {
            for column in 0..self.columns - 1 {
                let node = row * self.columns + column;
                let corners = [node, node + 1, node + 1 + self.columns, node + self.columns];
                let values = corners.map(|i| self.values[i]);
                let is_in = |i: usize| values[i % 4] > 0.0;
                // a line leaves where the way round the cell leaves the positive part, and ends where it comes back: farther
                // on where the middle is positive, else before
                let middle = values.iter().map(|v| v.clamp(-1.0, 1.0)).sum::<Real>() > 0.0;
                let turn = if middle { 1 } else { 3 };
                let lines = (0..4).filter(|i| is_in(*i) && !is_in(i + 1)).filter_map(|from| {
                    let mut others = (1..4).map(|k| (from + k * turn) % 4);
                    Some((from, others.find(|to| !is_in(*to) && is_in(to + 1))?))
                });
                let side = |i: usize| corners[SIDES[i][0]] * 2 + i % 2;
                steps.extend(lines.map(|(from, to)| (side(from), side(to))));
            }
        }
        steps
    }

    /// Where the function is zero on a side.
    fn crossing(&self, side: usize) -> Point2 {
        let (node, up) = (side / 2, side % 2 == 1);
        let other = if up { node + self.columns } else { node + 1 };
        let [a, b] = [node, other].map(|i| f64::from(self.values[i].clamp(-1.0, 1.0)));
        let share = (a / (a - b)).clamp(0.01, 0.99);
        let (column, row) = ((node % self.columns) as f64, (node / self.columns) as f64);
        let (x, y) = if up { (column, row + share) } else { (column + share, row) };
        Point2::new((self.min[0] + x * CELL_M) as Real, (self.min[1] + y * CELL_M) as Real)
    }
}

/// A ring with fewer points (Douglas and Peucker 1973), from its first point and the one farthest from it.
fn simplified(ring: &[Point2]) -> Vec<Point2> {
    if ring.len() < 4 {
        return ring.to_vec();
    }
    let place = |i: usize| [f64::from(ring[i % ring.len()].x), f64::from(ring[i % ring.len()].y)];
    let distance = |a: [f64; 2], b: [f64; 2]| ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt();
    let far = (1..ring.len()).fold(0, |best, i| {
        if distance(place(i), place(0)) > distance(place(best), place(0)) { i } else { best }
    });
    let mut kept = vec![false; ring.len()];
    (kept[0], kept[far]) = (true, true);
    let mut todo = vec![(0, far), (far, ring.len())];
    while let Some((from, to)) = todo.pop() {
        let (a, b) = (place(from), place(to));
        let length = distance(a, b).max(1e-9);
        let off = |i: usize| {
            let p = place(i);
            ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])).abs() / length
        };
        let worst = (from + 1..to).map(|i| (off(i), i)).fold((0.0, 0), |w, o| if o.0 > w.0 { o } else { w });
        if worst.0 > TOLERANCE_M {
            kept[worst.1] = true;
            todo.extend([(from, worst.1), (worst.1, to)]);
        }
    }
    ring.iter().zip(kept).filter_map(|(p, kept)| kept.then_some(*p)).collect()
}
