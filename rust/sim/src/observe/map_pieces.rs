//! The map as short straight pieces, and the nearest of them for every place.

use crate::geom::{Point2, Polygon, Real, math};
use crate::scene::{LaneKind, Map};
use std::sync::OnceLock;

/// Longest piece, metres.
const PIECE_M: Real = 5.0;
/// Side of a cell, metres.
const CELL_M: Real = 4.0;
/// Most pieces that a place knows.
pub(crate) const MAX_PIECES: usize = 256;

/// What a piece belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum PieceKind {
    /// Centre line of a lane.
    Lane = 0,
    /// Centre line of a lane connector.
    Connector = 1,
    /// Line between directions.
    RoadDivider = 2,
    /// Line between lanes.
    LaneDivider = 3,
    /// Edge of the drivable area.
    RoadEdge = 4,
    /// Edge of a pedestrian crossing.
    Crossing = 5,
    /// Edge of a stop line area.
    StopLine = 6,
    /// Edge of a walkway.
    Walkway = 7,
}

/// Pieces of all lines of a map, structure of arrays, with the nearest ones of each 4 m cell.
///
/// The list of a cell is made when it is first asked for, from the cell's centre, and shared by all worlds: so
/// "nearest" is meant up to the cell's half diagonal, 2.8 m. Ties go to the lower index.
#[derive(Debug, Default)]
pub struct MapPieces {
    /// Middles, x, metres.
    pub x: Vec<Real>,
    /// Middles, y, metres.
    pub y: Vec<Real>,
    /// Cosines of the directions.
    pub cos: Vec<Real>,
    /// Sines of the directions.
    pub sin: Vec<Real>,
    /// Half lengths, metres.
    pub half_length_m: Vec<Real>,
    /// What each piece belongs to.
    pub kind: Vec<PieceKind>,
    low: [Real; 2],
    num_cells: [usize; 2],
    cells: Vec<OnceLock<Box<[u32]>>>,
}

impl MapPieces {
    /// Cuts the lines of a map.
    pub fn new(map: &Map) -> Self {
        let mut pieces = Self::default();
        for lane in &map.lanes {
            let kind = if lane.kind == LaneKind::Connector { PieceKind::Connector } else { PieceKind::Lane };
            pieces.add_line(&lane.centreline, kind);
        }
        for (lines, kind) in
            [(&map.road_dividers, PieceKind::RoadDivider), (&map.lane_dividers, PieceKind::LaneDivider)]
        {
            for line in lines {
                pieces.add_line(line, kind);
            }
        }
        for (polygons, kind) in [
            (&map.drivable_area, PieceKind::RoadEdge),
            (&map.ped_crossings, PieceKind::Crossing),
            (&map.stop_lines, PieceKind::StopLine),
            (&map.walkways, PieceKind::Walkway),
        ] {
            pieces.add_edges(polygons, kind);
        }
        pieces.make_cells();
        pieces
    }

    /// Number of pieces.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether the map has no line.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Indices of the pieces nearest to a place, nearest first, at most 256.
    pub fn nearest(&self, at: Point2) -> &[u32] {
        if self.is_empty() {
            return &[];
        }
        let cell = |v: Real, axis: usize| {
            (((v - self.low[axis]) / CELL_M).max(0.0) as usize).min(self.num_cells[axis] - 1)
        };
        let (i, j) = (cell(at.x, 0), cell(at.y, 1));
        self.cells[j * self.num_cells[0] + i].get_or_init(|| {
            let centre = Point2::new(
                self.low[0] + (i as Real + 0.5) * CELL_M,
                self.low[1] + (j as Real + 0.5) * CELL_M,
            );
            self.sorted_from(centre)
        })
    }

    fn sorted_from(&self, centre: Point2) -> Box<[u32]> {
        let mut keys: Vec<u64> = (0..self.len())
            .map(|k| {
                let (dx, dy) = (self.x[k] - centre.x, self.y[k] - centre.y);
                u64::from((dx * dx + dy * dy).to_bits()) << 32 | k as u64
            })
            .collect();
        if keys.len() > MAX_PIECES {
            keys.select_nth_unstable(MAX_PIECES);
            keys.truncate(MAX_PIECES);
        }
        keys.sort_unstable();
        keys.iter().map(|k| (k & 0xffff_ffff) as u32).collect()
    }

    fn add(&mut self, a: Point2, b: Point2, kind: PieceKind) {
        let d = b - a;
        let length = math::hypot(d.x, d.y);
        if length < 1e-3 {
            return;
        }
        let middle = nalgebra::center(&a, &b);
        self.x.push(middle.x);
        self.y.push(middle.y);
        self.cos.push(d.x / length);
        self.sin.push(d.y / length);
        self.half_length_m.push(0.5 * length);
        self.kind.push(kind);
    }

    /// Joins the short segments of a line to pieces, and cuts the long ones.
    fn add_line(&mut self, line: &[Point2], kind: PieceKind) {
        let Some(mut from) = line.first().copied() else { return };
        let mut last = from;
        for p in &line[1..] {
            let whole = (p - from).norm();
            if whole > PIECE_M && last != from {
                self.add(from, last, kind);
                from = last;
            }
            let rest = p - from;
            let n = (rest.norm() / PIECE_M).ceil() as usize;
            if n > 1 {
                for k in 0..n {
                    let at = |k: usize| from + rest * (k as Real / n as Real);
                    self.add(at(k), at(k + 1), kind);
                }
                from = *p;
            }
            last = *p;
        }
        self.add(from, last, kind);
    }

    /// Adds rings but for the edges on the rectangle that the map was cut out with.
    fn add_edges(&mut self, polygons: &[Polygon], kind: PieceKind) {
        let points = polygons.iter().flat_map(|p| &p.exterior);
        let (low, high) = points.fold(
            (Point2::new(Real::MAX, Real::MAX), Point2::new(Real::MIN, Real::MIN)),
            |(low, high), p| (low.inf(p), high.sup(p)),
        );
        let on_cut = |a: &Point2, b: &Point2| {
            let both = |u: Real, v: Real, at: Real| (u - at).abs() < 1e-3 && (v - at).abs() < 1e-3;
            both(a.x, b.x, low.x) || both(a.x, b.x, high.x) || both(a.y, b.y, low.y) || both(a.y, b.y, high.y)
        };
        let cut = kind == PieceKind::RoadEdge;
        for polygon in polygons {
            for ring in std::iter::once(&polygon.exterior).chain(&polygon.holes) {
                let Some(last) = ring.last() else { continue };
                let mut run = vec![*last];
                for p in ring {
                    if cut && on_cut(&run[run.len() - 1], p) {
                        self.add_line(&run, kind);
                        run.clear();
                    }
                    run.push(*p);
                }
                self.add_line(&run, kind);
            }
        }
    }

    fn make_cells(&mut self) {
        let extent = |values: &[Real]| {
            let low = values.iter().copied().fold(Real::MAX, Real::min);
            (low, values.iter().copied().fold(Real::MIN, Real::max) - low)
        };
        if self.is_empty() {
            return;
        }
        let ((low_x, width), (low_y, height)) = (extent(&self.x), extent(&self.y));
        let count = |length: Real| ((length / CELL_M) as usize + 1).min(4096);
        self.low = [low_x, low_y];
        self.num_cells = [count(width), count(height)];
        self.cells = (0..self.num_cells[0] * self.num_cells[1]).map(|_| OnceLock::new()).collect();
    }
}
