//! A drivable area for maps that give none: from the edges of the road, and from lanes by their width.
//!
//! A grid of nodes holds how far inside the road each node is, metres: by the nearest piece of edge, which has the road on
//! its left, else by lanes and surfaces. Where the sign changes between two nodes the road ends; the lines through these
//! places, closed, are its polygons. Along straight pieces they lie on the edge itself, at corners within a cell.

use super::contour::{CELL_M, polygons};
use super::map::Lane;
use crate::geom::{self, Point2, Polygon, Real};

/// Most nodes of a grid: a square kilometre.
const MAX_NODES: f64 = 4e6;
/// How far the road reaches beyond lanes and vehicles that are given as `seeds`, metres.
const MARGIN_M: f64 = 100.0;
/// An edge says nothing about places farther away than this, metres.
const REACH_M: f64 = 25.0;
/// Distances are exact up to here from what makes the road, metres.
const EXACT_M: f64 = 1.5;
/// Half the width of a lane where nothing says how wide it is, metres.
pub(super) const HALF_LANE_M: Real = 1.75;
/// The middle of a lane is road even where an edge says otherwise, metres to either side.
const LANE_CORE_M: Real = 1.0;
/// The grid is wider than what makes the road by this on each side, metres.
const BORDER_M: f64 = 3.0;
/// Ends of two lines this near to each other are one corner, metres.
const SAME_CORNER_M: f64 = 0.05;
/// Pieces of lines are cut to this length along x and y, metres.
const LONGEST_PIECE_M: f64 = 10.0;
/// Most metres of lines, along x and y.
const MOST_LINES_M: f64 = 5e6;
/// Most nodes that all surfaces together may be asked for.
const MOST_SURFACE_NODES: f64 = 1e8;
/// Largest gap between lanes that is road, too, square metres; where edges tell, almost none is.
const GAP_M2: f64 = 60.0;
const GAP_BETWEEN_EDGES_M2: f64 = 2.0;

/// What a road is made of, in one frame, metres.
#[derive(Debug, Clone, Copy, Default)]
pub struct RoadParts<'a> {
    /// Edges of the road, which lies to the left of each; to the right of each where most lanes do.
    pub edges: &'a [Vec<Point2>],
    /// Lanes; those without a polygon are taken as 3.5 m wide.
    pub lanes: &'a [Lane],
    /// Other surfaces that vehicles use, such as driveways.
    pub surfaces: &'a [Polygon],
    /// Where vehicles were: pieces of road without a lane or one of these are left out, and without edges these are road.
    pub seeds: &'a [Point2],
}

/// Polygons of the road, which do not overlap; none where nothing makes one, or where the map is larger than any city's.
pub fn road_area(parts: RoadParts<'_>) -> Vec<Polygon> {
    let Some(mut field) = Field::new(&parts) else { return Vec::new() };
    field.join_edges(parts.edges, parts.lanes);
    field.join_lanes(&parts);
    if parts.edges.is_empty() {
        field.join_seeds(parts.seeds);
    }
    field.keep_used(&parts);
    let gap_m2 = if parts.edges.is_empty() { GAP_M2 } else { GAP_BETWEEN_EDGES_M2 };
    field.fill_gaps((gap_m2 / (CELL_M * CELL_M)) as usize);
    polygons(&field.inside_m, field.nodes.columns, field.nodes.min)
}

/// The nodes of a grid, row by row from the lower left.
#[derive(Clone, Copy)]
struct Nodes {
    min: [f64; 2],
    columns: usize,
    rows: usize,
}

struct Field {
    nodes: Nodes,
    /// How far inside the road a node is, metres; negative outside.
    inside_m: Vec<Real>,
    /// Distance from the nearest edge, metres; infinite beyond reach.
    edge_m: Vec<Real>,
}

impl Nodes {
    /// Each node of a box that is wider by a distance, and its place.
    fn near(self, corners: [[f64; 2]; 2], wider_m: f64) -> impl Iterator<Item = (usize, [f64; 2])> {
        let index =
            |v: f64, i: usize, count: usize| ((v - self.min[i]) / CELL_M).clamp(0.0, (count - 1) as f64);
        let span = |i: usize, count: usize| {
            let from = index(corners[0][i] - wider_m, i, count).ceil() as usize;
            from..=index(corners[1][i] + wider_m, i, count).floor() as usize
        };
        let (rows, columns) = (span(1, self.rows), span(0, self.columns));
        let nodes = rows.flat_map(move |row| columns.clone().map(move |column| (column, row)));
        nodes.map(move |(column, row)| (row * self.columns + column, self.place(column, row)))
    }

    /// The node nearest to a place; `None` off the grid.
    fn node(&self, at: [f64; 2]) -> Option<usize> {
        let [x, y] = [0, 1].map(|i| ((at[i] - self.min[i]) / CELL_M).round());
        let within = x >= 0.0 && y >= 0.0 && x < self.columns as f64 && y < self.rows as f64;
        within.then(|| y as usize * self.columns + x as usize)
    }

    fn place(&self, column: usize, row: usize) -> [f64; 2] {
        [self.min[0] + column as f64 * CELL_M, self.min[1] + row as f64 * CELL_M]
    }
}

impl Field {
    fn new(parts: &RoadParts<'_>) -> Option<Self> {
        let lines = parts.lanes.iter().map(|lane| &lane.centreline).chain(parts.edges);
        let rings = parts.surfaces.iter().chain(parts.lanes.iter().map(|lane| &lane.polygon));
        let made = lines.chain(rings.map(|ring| &ring.exterior)).flatten();
        bounds(made.clone())?;
        let all = bounds(made.chain(parts.seeds))?;
        let near = bounds(parts.seeds).map_or(all, |[lo, hi]| {
            [[0, 1].map(|i| all[0][i].max(lo[i] - MARGIN_M)), [0, 1].map(|i| all[1][i].min(hi[i] + MARGIN_M))]
        });
        // half a lane and some cells more on each side: what lies on the border is outside
        let min = near[0].map(|v| v - BORDER_M);
        let [columns, rows] = [0, 1].map(|i| ((near[1][i] - min[i] + BORDER_M) / CELL_M + 1.0).max(0.0));
        if !(columns * rows <= MAX_NODES && columns >= 2.0 && rows >= 2.0) {
            return None;
        }
        let nodes_of = |surface: &Polygon| {
            let corners = bounds(&surface.exterior).unwrap_or_default();
            let side = |i: usize, most: f64| ((corners[1][i] - corners[0][i]) / CELL_M + 8.0).min(most);
            side(0, columns) * side(1, rows)
        };
        let surfaces = parts.lanes.iter().map(|lane| &lane.polygon).chain(parts.surfaces);
        let lines = parts.lanes.iter().map(|lane| &lane.centreline).chain(parts.edges);
        let rings = surfaces.clone().flat_map(Polygon::rings);
        if surfaces.map(nodes_of).sum::<f64>() > MOST_SURFACE_NODES
            || lines.map(|line| length_m(line)).chain(rings.map(length_m)).sum::<f64>() > MOST_LINES_M
        {
            return None;
        }
        let (columns, rows) = (columns as usize, rows as usize);
        let (inside_m, edge_m) =
            (vec![Real::NEG_INFINITY; columns * rows], vec![Real::INFINITY; columns * rows]);
        Some(Self { nodes: Nodes { min, columns, rows }, inside_m, edge_m })
    }

    /// Takes a node to be so far inside at least.
    fn join(&mut self, node: usize, inside_m: Real) {
        self.inside_m[node] = self.inside_m[node].max(inside_m);
    }

    /// Nodes to the left of their nearest edge are road.
    fn join_edges(&mut self, edges: &[Vec<Point2>], lanes: &[Lane]) {
        let pieces: Vec<Piece> = edges.iter().flat_map(|line| Piece::of_line(line)).collect();
        let mut nearest = vec![Nearest::NONE; self.inside_m.len()];
        for (i, piece) in pieces.iter().enumerate() {
            for (node, at) in self.nodes.near(piece.corners(), EXACT_M) {
                nearest[node].offer(piece.seen(i, at));
            }
        }
        // neighbours have the same nearest piece, or almost: two sweeps there and back (Danielsson 1980)
        let (columns, rows) = (self.nodes.columns as isize, self.nodes.rows as isize);
        for sweep in 0..4 {
            let back = sweep % 2 == 1;
            for i in 0..columns * rows {
                let node = if back { columns * rows - 1 - i } else { i };
                let (column, row) = (node % columns, node / columns);
                let at = self.nodes.place(column as usize, row as usize);
                for (dx, dy) in [(-1, 0), (-1, -1), (0, -1), (1, -1)] {
                    let (x, y) = if back { (column - dx, row - dy) } else { (column + dx, row + dy) };
                    if x < 0 || y < 0 || x >= columns || y >= rows {
                        continue;
                    }
                    let other = nearest[(y * columns + x) as usize].piece;
                    if other != usize::MAX && other != nearest[node as usize].piece {
                        nearest[node as usize].offer(pieces[other].seen(other, at));
                    }
                }
            }
        }
        // the middles of lanes are road: where they lie to the right of most edges, the data draws edges the other way
        let told = lanes.iter().flat_map(|lane| Piece::of_line(&lane.centreline)).filter_map(|piece| {
            let near = nearest[self.nodes.node(piece.middle())?];
            (near.distance_m <= REACH_M).then_some(near.left_m >= 0.0)
        });
        let (left, right): (Vec<_>, Vec<_>) = told.partition(|left| *left);
        let reversed = left.len() < right.len();
        for (node, near) in nearest.iter().enumerate().filter(|(_, near)| near.distance_m <= REACH_M) {
            self.edge_m[node] = near.distance_m as Real;
            let left = (near.left_m >= 0.0) != reversed;
            self.inside_m[node] = if left { near.distance_m } else { -near.distance_m } as Real;
        }
    }

    /// Lanes and surfaces are road, up to an edge.
    fn join_lanes(&mut self, parts: &RoadParts<'_>) {
        for lane in parts.lanes.iter().filter(|lane| lane.polygon.exterior.len() < 3) {
            for piece in Piece::of_line(&lane.centreline) {
                for (node, at) in self.nodes.near(piece.corners(), f64::from(HALF_LANE_M) + EXACT_M) {
                    let half_m = self.edge_m[node].clamp(LANE_CORE_M, HALF_LANE_M);
                    self.join(node, half_m - piece.seen(0, at).distance_m as Real);
                }
            }
        }
        let surfaces = parts.lanes.iter().map(|lane| &lane.polygon).chain(parts.surfaces);
        for surface in surfaces.filter(|surface| surface.exterior.len() >= 3) {
            self.join_surface(surface);
        }
    }

    /// Where no edge tells, the places of vehicles are road, as wide as a lane.
    fn join_seeds(&mut self, seeds: &[Point2]) {
        let reach_m = f64::from(HALF_LANE_M) + EXACT_M;
        for seed in seeds {
            let at = [f64::from(seed.x), f64::from(seed.y)];
            for (node, [x, y]) in self.nodes.near([at, at], reach_m) {
                let distance_m = ((x - at[0]).powi(2) + (y - at[1]).powi(2)).sqrt() as Real;
                self.join(node, HALF_LANE_M - distance_m);
            }
        }
    }

    fn join_surface(&mut self, surface: &Polygon) {
        let Some(corners) = bounds(surface.rings().flatten()) else { return };
        let (nodes, pieces) = (self.nodes, surface.rings().flat_map(Piece::of_ring).collect::<Vec<_>>());
        let mut near = std::collections::BTreeMap::<usize, f64>::new();
        for piece in &pieces {
            for (node, at) in self.nodes.near(piece.corners(), EXACT_M) {
                let distance_m = piece.seen(0, at).distance_m;
                near.entry(node).and_modify(|least| *least = least.min(distance_m)).or_insert(distance_m);
            }
        }
        // crossings of each row of nodes with the rings: between the first and the second it is inside, and so on
        let mut crossings: Vec<(usize, f64)> = Vec::new();
        for piece in &pieces {
            let (lo, hi) = (piece.from[1].min(piece.to[1]), piece.from[1].max(piece.to[1]));
            let first = ((lo - nodes.min[1]) / CELL_M).ceil().max(0.0) as usize;
            for row in (first..nodes.rows).take_while(|row| nodes.place(0, *row)[1] < hi) {
                let share = (nodes.place(0, row)[1] - piece.from[1]) / (piece.to[1] - piece.from[1]);
                crossings.push((row, piece.from[0] + share * (piece.to[0] - piece.from[0])));
            }
        }
        crossings.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for (node, at) in nodes.near(corners, EXACT_M) {
            let row = node / nodes.columns;
            let count = |x: f64| crossings.partition_point(|c| c.0 < row || (c.0 == row && c.1 <= x));
            let before = count(at[0]) - count(f64::NEG_INFINITY);
            let distance_m = near.get(&node).copied().unwrap_or(EXACT_M).min(EXACT_M) as Real;
            self.join(node, if before % 2 == 1 { distance_m } else { -distance_m });
        }
    }

    /// Takes away what is not joined to a lane or to where a vehicle was.
    fn keep_used(&mut self, parts: &RoadParts<'_>) {
        let Nodes { columns, rows, .. } = self.nodes;
        for node in 0..self.inside_m.len() {
            let (column, row) = (node % columns, node / columns);
            if column == 0 || row == 0 || column + 1 == columns || row + 1 == rows {
                self.inside_m[node] = -CELL_M as Real;
            }
        }
        let pieces = parts.lanes.iter().flat_map(|lane| Piece::of_line(&lane.centreline));
        let seeds = parts.seeds.iter().map(|p| [f64::from(p.x), f64::from(p.y)]);
        let starts: Vec<usize> =
            pieces.map(|piece| piece.middle()).chain(seeds).filter_map(|at| self.nodes.node(at)).collect();
        if starts.is_empty() {
            return;
        }
        let mut used = vec![false; self.inside_m.len()];
        self.flood(starts, &mut used, |inside_m| inside_m > 0.0);
        for (inside_m, used) in self.inside_m.iter_mut().zip(used) {
            if !used {
                *inside_m = inside_m.min(-1e-3);
            }
        }
    }

    /// Makes gaps of at most so many nodes part of the road.
    fn fill_gaps(&mut self, most_nodes: usize) {
        let mut seen = vec![false; self.inside_m.len()];
        for start in 0..seen.len() {
            if seen[start] || self.inside_m[start] > 0.0 {
                continue;
            }
            let gap = self.flood(vec![start], &mut seen, |inside_m| inside_m <= 0.0);
            // the outside is one gap, too: it holds the corner
            if gap.len() <= most_nodes && !gap.contains(&0) {
                gap.into_iter().for_each(|node| self.inside_m[node] = CELL_M as Real);
            }
        }
    }

    /// Marks the nodes that fit and are joined to the starts by others that do, and returns them.
    fn flood(&self, starts: Vec<usize>, seen: &mut [bool], fits: impl Fn(Real) -> bool) -> Vec<usize> {
        let (Nodes { columns, rows, .. }, mut todo, mut found) = (self.nodes, starts, Vec::new());
        while let Some(node) = todo.pop() {
            if seen[node] || !fits(self.inside_m[node]) {
                continue;
            }
            seen[node] = true;
            found.push(node);
            let (column, row) = (node % columns, node / columns);
            let neighbours = [
                (column > 0).then(|| node - 1),
                (column + 1 < columns).then(|| node + 1),
                (row > 0).then(|| node - columns),
                (row + 1 < rows).then(|| node + columns),
            ];
            todo.extend(neighbours.into_iter().flatten());
        }
        found
    }
}

/// Lower left and upper right of points.
fn bounds<'a>(points: impl IntoIterator<Item = &'a Point2>) -> Option<[[f64; 2]; 2]> {
    let (low, high) = geom::bounds(points.into_iter().copied())?;
    Some([low, high].map(|p| [f64::from(p.x), f64::from(p.y)]))
}

/// Length of a line along x and y, metres.
fn length_m(line: &[Point2]) -> f64 {
    line.windows(2).filter_map(|pair| Piece::new(pair[0], pair[1])).map(|piece| piece.corners_m()).sum()
}

/// A piece of a line with a length.
#[derive(Debug, Clone, Copy)]
struct Piece {
    from: [f64; 2],
    to: [f64; 2],
}

/// The piece nearest to a node.
#[derive(Debug, Clone, Copy)]
struct Nearest {
    piece: usize,
    distance_m: f64,
    /// How far to the left of the piece's straight line, metres.
    left_m: f64,
}

impl Nearest {
    const NONE: Self = Self { piece: usize::MAX, distance_m: f64::INFINITY, left_m: 0.0 };

    /// Takes the nearer one; at a corner the one whose straight line is farther, which is on the right side of the corner.
    fn offer(&mut self, other: Self) {
        let at_corner = (self.distance_m - other.distance_m).abs() <= SAME_CORNER_M
            && self.is_at_end()
            && other.is_at_end();
        let takes = if at_corner {
            other.left_m.abs() > self.left_m.abs()
        } else {
            other.distance_m < self.distance_m
        };
        if takes {
            *self = other;
        }
    }

    fn is_at_end(&self) -> bool {
        self.left_m.abs() < self.distance_m * (1.0 - 1e-9)
    }
}

impl Piece {
    fn new(from: Point2, to: Point2) -> Option<Self> {
        let pair = |p: Point2| [f64::from(p.x), f64::from(p.y)];
        (from != to).then(|| Self { from: pair(from), to: pair(to) })
    }

    fn of_line(line: &[Point2]) -> impl Iterator<Item = Self> + '_ {
        line.windows(2).filter_map(|pair| Self::new(pair[0], pair[1])).flat_map(Self::cut)
    }

    /// Parts that are short, so that few nodes lie in the box round each.
    fn cut(self) -> impl Iterator<Item = Self> {
        let length_m = self.corners_m();
        let count = (length_m / LONGEST_PIECE_M).ceil().max(1.0);
        let at = move |i: f64| [0, 1].map(|k| self.from[k] + (self.to[k] - self.from[k]) * (i / count));
        (0..count as usize).map(move |i| Self { from: at(i as f64), to: at(i as f64 + 1.0) })
    }

    /// Width and height of the box round it, metres.
    fn corners_m(&self) -> f64 {
        (self.to[0] - self.from[0]).abs() + (self.to[1] - self.from[1]).abs()
    }

    fn of_ring(ring: &[Point2]) -> impl Iterator<Item = Self> + '_ {
        let closing = ring.last().and_then(|last| Self::new(*last, ring[0]));
        Self::of_line(ring).chain(closing.into_iter().flat_map(Self::cut))
    }

    fn middle(&self) -> [f64; 2] {
        [0, 1].map(|i| (self.from[i] + self.to[i]) / 2.0)
    }

    fn corners(&self) -> [[f64; 2]; 2] {
        [[0, 1].map(|i| self.from[i].min(self.to[i])), [0, 1].map(|i| self.from[i].max(self.to[i]))]
    }

    fn seen(&self, piece: usize, at: [f64; 2]) -> Nearest {
        let (dx, dy) = (self.to[0] - self.from[0], self.to[1] - self.from[1]);
        let (px, py) = (at[0] - self.from[0], at[1] - self.from[1]);
        let length_sq = dx * dx + dy * dy;
        let along = ((px * dx + py * dy) / length_sq).clamp(0.0, 1.0);
        let (x, y) = (px - along * dx, py - along * dy);
        Nearest { piece, distance_m: (x * x + y * y).sqrt(), left_m: (dx * py - dy * px) / length_sq.sqrt() }
    }
}
