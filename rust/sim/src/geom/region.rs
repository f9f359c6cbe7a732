//! Containment in a union of polygons through a uniform grid.
//!
//! Every cell is wholly outside, wholly inside one polygon, or crossed by edges. The first two answer at once. A
//! crossed cell keeps a reference point and, per polygon, whether the reference point is inside and the edges that
//! meet the cell: the segment from the query to the reference point stays in the (convex) cell, so the query has the
//! reference point's parity flipped once per edge that the segment crosses.

use super::polygon::{near_origin, ring_edges};
use super::{OrientedBox, Point2, Polygon, Real, bounds};

/// Wanted side of a cell, metres.
const CELL_M: f64 = 2.0;
/// Most cells of a grid; larger scenes get larger cells.
const MAX_CELLS: f64 = 60_000.0;
/// Edges count as meeting a cell within this distance, metres: more than the boundary tolerance and rounding.
const EDGE_MARGIN_M: f64 = 2e-3;
/// Code of a cell without any polygon.
const OUTSIDE: u32 = u32::MAX;
/// Code of a cell wholly inside a polygon. Codes below are indices of crossed cells.
const INSIDE: u32 = u32::MAX - 1;

/// A set of points: the union of polygons, each by the even-odd rule over its rings. Immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    grid: Grid,
    /// Code per cell, row-major from the lower left.
    cells: Vec<u32>,
    crossed: Vec<CrossedCell>,
    parts: Vec<Part>,
    /// Ends of the edges relative to their cell's reference point: ax, ay, bx, by.
    edges: Vec<[Real; 4]>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct CrossedCell {
    reference: Point2,
    first_part: u32,
    num_parts: u32,
}

/// One polygon in one crossed cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    first_edge: u32,
    num_edges: u32,
    /// Whether the reference point is in the polygon.
    holds_reference: bool,
}

/// Uniform grid over a rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Grid {
    min: Point2,
    pub(crate) cell_m: Real,
    cells_per_m: Real,
    num_columns: usize,
    num_rows: usize,
}

impl Grid {
    pub(crate) fn new(min: Point2, max: Point2, wanted_cell_m: f64, max_cells: f64) -> Self {
        let (width, height) = (f64::from(max.x - min.x), f64::from(max.y - min.y));
        let cell_m = wanted_cell_m.max((width * height / max_cells).sqrt()).max((width + height) / max_cells);
        Self::with_cells(min, max, cell_m as Real)
    }

    /// Grid of cells of a given side, metres.
    pub(crate) fn with_cells(min: Point2, max: Point2, cell_m: Real) -> Self {
        let count = |extent: Real| (f64::from(extent) / f64::from(cell_m)) as usize + 1;
        let (num_columns, num_rows) = (count(max.x - min.x), count(max.y - min.y));
        Self { min, cell_m, cells_per_m: 1.0 / cell_m, num_columns, num_rows }
    }

    pub(crate) fn num_cells(&self) -> usize {
        self.num_columns * self.num_rows
    }

    /// The cell nearest to a point.
    pub(crate) fn nearest_cell(&self, point: Point2) -> usize {
        let index = |from: Real, to: Real, count: usize| {
            (((to - from) * self.cells_per_m).max(0.0) as usize).min(count - 1)
        };
        index(self.min.y, point.y, self.num_rows) * self.num_columns
            + index(self.min.x, point.x, self.num_columns)
    }

    /// Middle of a cell.
    pub(crate) fn middle(&self, cell: usize) -> Point2 {
        let at = |index: usize| (index as Real + 0.5) * self.cell_m;
        let (column, row) = (cell % self.num_columns, cell / self.num_columns);
        Point2::new(self.min.x + at(column), self.min.y + at(row))
    }

    /// Cell of a point; `None` off the grid and for NaN.
    #[inline]
    pub(crate) fn cell(&self, point: Point2) -> Option<usize> {
        self.column_and_row(point).map(|(column, row)| row * self.num_columns + column)
    }

    /// Column and row of that cell.
    #[inline]
    fn column_and_row(&self, point: Point2) -> Option<(usize, usize)> {
        let x = (point.x - self.min.x) * self.cells_per_m;
        let y = (point.y - self.min.y) * self.cells_per_m;
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        (column < self.num_columns && row < self.num_rows).then_some((column, row))
    }

    /// The part of its cell that a point of the grid is in, one of 8 x 8, row by row.
    #[inline]
    pub(crate) fn part(&self, point: Point2) -> u32 {
        let eighth = |from: Real, to: Real| ((to - from) * self.cells_per_m * 8.0) as u32 % 8;
        eighth(self.min.y, point.y) * 8 + eighth(self.min.x, point.x)
    }

    /// Lower left corner of a cell in f64.
    fn corner(&self, column: usize, row: usize) -> [f64; 2] {
        let cell_m = f64::from(self.cell_m);
        [f64::from(self.min.x) + column as f64 * cell_m, f64::from(self.min.y) + row as f64 * cell_m]
    }

    /// First and last index along one axis of the cells between two distances from the lower left, clamped.
    fn span(&self, from_m: f64, to_m: f64, count: usize) -> (usize, usize) {
        let index = |v: f64| ((v / f64::from(self.cell_m)).max(0.0) as usize).min(count - 1);
        (index(from_m), index(to_m))
    }
}

type Edge = [f64; 4];

impl Region {
    /// Union of polygons; `None` when none has an area to speak of (three finite points).
    pub fn new<'a>(polygons: impl IntoIterator<Item = &'a Polygon>) -> Option<Self> {
        let finite = |p: &Polygon| p.rings().flatten().all(|q| q.x.is_finite() && q.y.is_finite());
        let polygons: Vec<&Polygon> =
            polygons.into_iter().filter(|p| p.exterior.len() >= 3 && finite(p)).collect();
        let (min, max) = bounds(polygons.iter().flat_map(|p| p.rings().flatten().copied()))?;
        let margin = 0.1;
        let (min, max) =
            (Point2::new(min.x - margin, min.y - margin), Point2::new(max.x + margin, max.y + margin));
        let grid = Grid::new(min, max, CELL_M, MAX_CELLS);
        let mut builder = Builder::new(grid);
        for (polygon_idx, polygon) in polygons.iter().enumerate() {
            builder.add(polygon_idx as u32, polygon);
        }
        Some(builder.finish())
    }

    /// Whether a point is in one of the polygons; within 0.1 mm of a ring counts as inside.
    #[inline]
    pub fn contains(&self, point: Point2) -> bool {
        let Some(cell) = self.grid.cell(point) else { return false };
        match self.cells[cell] {
            OUTSIDE => false,
            INSIDE => true,
            crossed => self.contains_in_crossed_cell(point, crossed as usize),
        }
    }

    fn contains_in_crossed_cell(&self, point: Point2, crossed: usize) -> bool {
        let cell = self.crossed[crossed];
        let (px, py) = (point.x - cell.reference.x, point.y - cell.reference.y);
        let parts = &self.parts[cell.first_part as usize..][..cell.num_parts as usize];
        for part in parts {
            let mut inside = part.holds_reference;
            for &[ax, ay, bx, by] in &self.edges[part.first_edge as usize..][..part.num_edges as usize] {
                if near_origin(ax - px, ay - py, bx - px, by - py) {
                    return true;
                }
                // the ends lie on different sides of the line through the reference point (origin) and the query …
                let sides_differ = (px * ay - py * ax >= 0.0) != (px * by - py * bx >= 0.0);
                // … and origin and query on different sides of the edge
                let at_origin = ax * by - ay * bx;
                let at_query = at_origin + (bx - ax) * py - (by - ay) * px;
                inside ^= sides_differ & ((at_origin > 0.0) != (at_query > 0.0));
            }
            if inside {
                return true;
            }
        }
        false
    }

    /// Whether all corners of a box are inside.
    #[inline]
    pub fn holds_box(&self, body: &OrientedBox) -> bool {
        body.corners().iter().all(|corner| self.contains(*corner))
    }

    /// Whether the axis-aligned square round a point is certainly inside; false also when that is not known.
    ///
    /// Looks at the cells' codes only: a cheap first test for boxes.
    #[inline]
    pub fn holds_square(&self, centre: Point2, half_side_m: Real) -> bool {
        let half_side_m = half_side_m.abs();
        let low = self.grid.column_and_row(Point2::new(centre.x - half_side_m, centre.y - half_side_m));
        let high = self.grid.column_and_row(Point2::new(centre.x + half_side_m, centre.y + half_side_m));
        let (Some((left, bottom)), Some((right, top))) = (low, high) else { return false };
        let row = |row: usize| &self.cells[row * self.grid.num_columns..][left..=right];
        (bottom..=top).all(|r| row(r).iter().all(|code| *code == INSIDE))
    }
}

struct Builder {
    grid: Grid,
    is_inside: Vec<bool>,
    /// Edges that meet a cell: cell, polygon, index into `edges`. In order of polygon.
    meetings: Vec<(u32, u32, u32)>,
    edges: Vec<Edge>,
    /// Edges of each polygon by row of the grid, to find the parity of reference points.
    rows: Vec<Vec<Vec<u32>>>,
}

impl Builder {
    fn new(grid: Grid) -> Self {
        let is_inside = vec![false; grid.num_cells()];
        Self { grid, is_inside, meetings: Vec::new(), edges: Vec::new(), rows: Vec::new() }
    }

    fn add(&mut self, polygon_idx: u32, polygon: &Polygon) {
        let first_edge = self.edges.len();
        self.edges
            .extend(polygon.rings().flat_map(ring_edges).map(|(a, b)| [a.x, a.y, b.x, b.y].map(f64::from)));
        let mut rows = vec![Vec::new(); self.grid.num_rows];
        let mut meets = vec![false; self.is_inside.len()];
        for edge_idx in first_edge..self.edges.len() {
            let edge = self.edges[edge_idx];
            let bottom = edge[1].min(edge[3]) - f64::from(self.grid.min.y);
            let top = edge[1].max(edge[3]) - f64::from(self.grid.min.y);
            let (low, high) = self.grid.span(bottom - EDGE_MARGIN_M, top + EDGE_MARGIN_M, self.grid.num_rows);
            for row in low..=high {
                rows[row].push(edge_idx as u32);
                let (from, to) = self.columns_met(edge, row);
                for column in from..=to {
                    let cell = row * self.grid.num_columns + column;
                    meets[cell] = true;
                    self.meetings.push((cell as u32, polygon_idx, edge_idx as u32));
                }
            }
        }
        self.fill(&rows, &meets);
        self.rows.push(rows);
    }

    /// First and last column in which an edge meets a row of cells.
    fn columns_met(&self, [ax, ay, bx, by]: Edge, row: usize) -> (usize, usize) {
        let bottom = self.grid.corner(0, row)[1] - EDGE_MARGIN_M;
        let top = bottom + f64::from(self.grid.cell_m) + 2.0 * EDGE_MARGIN_M;
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        if ay != by {
            let (t0, t1) = ((bottom - ay) / (by - ay), (top - ay) / (by - ay));
            from = from.max(t0.min(t1)).min(1.0);
            to = to.min(t0.max(t1)).max(0.0);
        }
        let min_x = f64::from(self.grid.min.x);
        let (x0, x1) = (ax + from * (bx - ax) - min_x, ax + to * (bx - ax) - min_x);
        self.grid.span(x0.min(x1) - EDGE_MARGIN_M, x0.max(x1) + EDGE_MARGIN_M, self.grid.num_columns)
    }

    /// Marks the cells that lie wholly inside the polygon whose edges are given by row.
    fn fill(&mut self, rows: &[Vec<u32>], meets: &[bool]) {
        let mut crossings = Vec::new();
        for (row, edges) in rows.iter().enumerate().filter(|(_, edges)| !edges.is_empty()) {
            let [x, bottom] = self.grid.corner(0, row);
            let half_m = 0.5 * f64::from(self.grid.cell_m);
            crossings.clear();
            crossings
                .extend(edges.iter().filter_map(|e| crossing_x(self.edges[*e as usize], bottom + half_m)));
            crossings.sort_unstable_by(f64::total_cmp);
            let mut passed = 0;
            for column in 0..self.grid.num_columns {
                let centre = x + (2 * column + 1) as f64 * half_m;
                while passed < crossings.len() && crossings[passed] <= centre {
                    passed += 1;
                }
                let cell = row * self.grid.num_columns + column;
                self.is_inside[cell] |= passed % 2 == 1 && !meets[cell];
            }
        }
    }

    fn finish(mut self) -> Region {
        let mut cells: Vec<u32> =
            self.is_inside.iter().map(|inside| if *inside { INSIDE } else { OUTSIDE }).collect();
        self.meetings.sort_unstable();
        let meetings = std::mem::take(&mut self.meetings);
        let (mut crossed, mut parts, mut edges) = (Vec::new(), Vec::<Part>::new(), Vec::new());
        for in_cell in meetings.chunk_by(|a, b| a.0 == b.0) {
            let cell = in_cell[0].0 as usize;
            if cells[cell] == INSIDE {
                continue;
            }
            cells[cell] = crossed.len() as u32;
            let reference = self.reference_point(cell, in_cell);
            let first_part = parts.len() as u32;
            for of_polygon in in_cell.chunk_by(|a, b| a.1 == b.1) {
                let first_edge = edges.len() as u32;
                edges.extend(of_polygon.iter().map(|(_, _, edge)| {
                    let [ax, ay, bx, by] = self.edges[*edge as usize].map(|v| v as Real);
                    [ax - reference.x, ay - reference.y, bx - reference.x, by - reference.y]
                }));
                let holds_reference = self.holds(of_polygon[0].1, cell, reference);
                parts.push(Part { first_edge, num_edges: of_polygon.len() as u32, holds_reference });
            }
            crossed.push(CrossedCell { reference, first_part, num_parts: parts.len() as u32 - first_part });
        }
        edges.shrink_to_fit();
        parts.shrink_to_fit();
        crossed.shrink_to_fit();
        Region { grid: self.grid, cells, crossed, parts, edges }
    }

    /// The point of a few spread over the cell that is furthest from the cell's edges.
    fn reference_point(&self, cell: usize, meetings: &[(u32, u32, u32)]) -> Point2 {
        const NUM_CANDIDATES: usize = 12;
        let [x, y] = self.grid.corner(cell % self.grid.num_columns, cell / self.grid.num_columns);
        let cell_m = f64::from(self.grid.cell_m);
        let mut best = (-1.0, Point2::new(x as Real, y as Real));
        for i in 0..NUM_CANDIDATES {
            // the R2 sequence (Roberts 2018): evenly spread, on no common line
            let along = (0.5 + 0.754_877_666_246_693 * i as f64).fract();
            let across = (0.5 + 0.569_840_290_998_053 * i as f64).fract();
            let candidate = Point2::new(
                (x + (0.05 + 0.9 * along) * cell_m) as Real,
                (y + (0.05 + 0.9 * across) * cell_m) as Real,
            );
            let distance = |m: &(u32, u32, u32)| distance_sq(self.edges[m.2 as usize], candidate);
            let nearest = meetings.iter().map(distance).fold(f64::INFINITY, f64::min);
            if nearest > best.0 {
                best = (nearest, candidate);
            }
        }
        best.1
    }

    /// Whether a point of a cell is in a polygon: crossings of the ray to −x with the edges of the cell's row.
    fn holds(&self, polygon_idx: u32, cell: usize, point: Point2) -> bool {
        let row = &self.rows[polygon_idx as usize][cell / self.grid.num_columns];
        let crossings = row.iter().filter_map(|e| crossing_x(self.edges[*e as usize], f64::from(point.y)));
        crossings.filter(|x| *x <= f64::from(point.x)).count() % 2 == 1
    }
}

/// Where an edge crosses a horizontal line, its lower end included and its upper end not.
fn crossing_x([ax, ay, bx, by]: Edge, y: f64) -> Option<f64> {
    ((ay <= y) != (by <= y)).then(|| ax + (bx - ax) * ((y - ay) / (by - ay)))
}

fn distance_sq([ax, ay, bx, by]: Edge, point: Point2) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let (px, py) = (f64::from(point.x) - ax, f64::from(point.y) - ay);
    let length_sq = dx * dx + dy * dy;
    let along = if length_sq > 0.0 { ((px * dx + py * dy) / length_sq).clamp(0.0, 1.0) } else { 0.0 };
    let (ox, oy) = (px - along * dx, py - along * dy);
    ox * ox + oy * oy
}
