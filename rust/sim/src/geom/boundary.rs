//! The edge of a union of polygons, for distances to it.

use super::polygon::{edge_distance_sq, ring_edges};
use super::{Point2, Polygon, Real, Region};

/// Side of a cell, and longest piece of an edge, metres.
const CELL_M: f64 = 4.0;
/// An edge bounds the union where one of the places so far to its left and right is in it and the other is not, metres.
const ASIDE_M: f64 = 1e-3;
/// The same for places far from the origin, in shares of their coordinates.
const ASIDE_SHARE: f64 = 1e-6;
/// Cells round a point that are looked at one by one; a point farther away looks at all pieces.
const NEAR_CELLS: i64 = 8;

/// A cell: column and row.
type Cell = (i64, i64);

/// What bounds a union of polygons: straight pieces with points of the union on one side alone. Immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    pieces: Vec<[Point2; 2]>,
    /// Pieces by the cells that the box round them meets, sorted.
    cells: Vec<(Cell, u32)>,
}

impl Boundary {
    /// What bounds the union of polygons whose region is given.
    ///
    /// What several polygons share is no boundary; nor is a gap or an overlap of less than two millimetres.
    pub fn new(polygons: &[&Polygon], region: &Region) -> Self {
        let rings = polygons.iter().flat_map(|polygon| polygon.rings());
        let edges: Vec<[Point2; 2]> = rings.flat_map(pieces_of).collect();
        let cells = by_cell(&edges);
        let mut pieces = Vec::new();
        let mut others = Vec::new();
        for edge in &edges {
            others.clear();
            for cell in cells_of(edge) {
                others.extend(in_cell(&cells, cell).iter().map(|(_, i)| *i));
            }
            others.sort_unstable();
            others.dedup();
            let ends = cuts(edge, others.iter().map(|i| &edges[*i as usize]));
            for (from, to) in ends.iter().zip(&ends[1..]) {
                if bounds(edge, 0.5 * (from + to), region) {
                    pieces.push([along(edge, *from), along(edge, *to)]);
                }
            }
        }
        let cells = by_cell(&pieces);
        Self { pieces, cells }
    }

    /// Distance of a point to the nearest piece, metres; infinite where there is none.
    pub fn distance_m(&self, point: Point2) -> Real {
        let nearer =
            |least: Real, piece: &[Point2; 2]| least.min(edge_distance_sq(piece[0], piece[1], point));
        let (mut least, (column, row)) = (Real::INFINITY, cell(point));
        for ring in 0..=NEAR_CELLS {
            for i in -ring..=ring {
                // whole sides to the left and right, two ends between them
                let step = if i.abs() == ring { 1 } else { 2 * ring };
                for j in (-ring..=ring).step_by(step as usize) {
                    let here = in_cell(&self.cells, (column + i, row + j));
                    least = here.iter().map(|(_, k)| &self.pieces[*k as usize]).fold(least, nearer);
                }
            }
            // whatever was not looked at is farther away than the cells that were
            let reach_m = ring as Real * CELL_M as Real;
            if least <= reach_m * reach_m {
                return least.sqrt();
            }
        }
        self.pieces.iter().fold(least, nearer).sqrt()
    }
}

/// Edges of a ring cut into pieces of at most [`CELL_M`].
fn pieces_of(ring: &[Point2]) -> impl Iterator<Item = [Point2; 2]> + '_ {
    ring_edges(ring).flat_map(|(a, b)| {
        let n = (f64::from((b - a).norm()) / CELL_M).ceil().max(1.0);
        let n = if n.is_finite() { n as usize } else { 1 };
        let at = move |k: usize| if k == n { b } else { along(&[a, b], k as f64 / n as f64) };
        (0..n).map(move |k| [at(k), at(k + 1)])
    })
}

fn cell(point: Point2) -> Cell {
    let of = |v: Real| (f64::from(v) / CELL_M).floor() as i64;
    (of(point.x), of(point.y))
}

fn cells_of(piece: &[Point2; 2]) -> impl Iterator<Item = Cell> {
    let (a, b) = (cell(piece[0]), cell(piece[1]));
    let (columns, rows) = (a.0.min(b.0)..=a.0.max(b.0), a.1.min(b.1)..=a.1.max(b.1));
    columns.flat_map(move |column| rows.clone().map(move |row| (column, row)))
}

fn by_cell(pieces: &[[Point2; 2]]) -> Vec<(Cell, u32)> {
    let mut cells: Vec<(Cell, u32)> =
        pieces.iter().zip(0..).flat_map(|(piece, i)| cells_of(piece).map(move |cell| (cell, i))).collect();
    cells.sort_unstable();
    cells
}

fn in_cell(cells: &[(Cell, u32)], cell: Cell) -> &[(Cell, u32)] {
    let from = cells.partition_point(|(c, _)| *c < cell);
    let to = from + cells[from..].partition_point(|(c, _)| *c == cell);
    &cells[from..to]
}

/// The point at a share of the way from one end of a piece to the other.
fn along([a, b]: &[Point2; 2], share: f64) -> Point2 {
    let mix = |a: Real, b: Real| (f64::from(a) + share * (f64::from(b) - f64::from(a))) as Real;
    Point2::new(mix(a.x, b.x), mix(a.y, b.y))
}

/// Shares of a piece's way at which another one crosses it or ends on it, from 0 to 1 in rising order, both included.
fn cuts<'a>([a, b]: &[Point2; 2], others: impl Iterator<Item = &'a [Point2; 2]>) -> Vec<f64> {
    let mut cuts = vec![0.0, 1.0];
    let vector = |from: &Point2, to: &Point2| {
        [f64::from(to.x) - f64::from(from.x), f64::from(to.y) - f64::from(from.y)]
    };
    let cross = |u: [f64; 2], v: [f64; 2]| u[0] * v[1] - u[1] * v[0];
    let own = vector(a, b);
    let length_sq = own[0] * own[0] + own[1] * own[1];
    for [c, d] in others {
        let other = vector(c, d);
        let (to_c, turn) = (vector(a, c), cross(own, other));
        let (share, place) = (cross(to_c, other) / turn, cross(to_c, own) / turn);
        if turn != 0.0 && (0.0..=1.0).contains(&place) {
            cuts.push(share);
        }
        for end in [to_c, vector(a, d)] {
            let beside = cross(own, end);
            if beside * beside <= ASIDE_M * ASIDE_M * length_sq {
                cuts.push((own[0] * end[0] + own[1] * end[1]) / length_sq);
            }
        }
    }
    cuts.retain(|share| (0.0..=1.0).contains(share));
    cuts.sort_unstable_by(f64::total_cmp);
    cuts.dedup();
    cuts
}

/// Whether the union is on one side alone of the place at a share of a piece's way.
fn bounds(piece: &[Point2; 2], share: f64, region: &Region) -> bool {
    let (at, d) = (along(piece, share), piece[1] - piece[0]);
    let aside_m = ASIDE_M.max(ASIDE_SHARE * f64::from(at.x.abs().max(at.y.abs()))) as Real;
    let Some(unit) = d.try_normalize(0.0) else { return false };
    let side = Point2::new(-unit.y * aside_m, unit.x * aside_m).coords;
    region.contains(at + side) != region.contains(at - side)
}
