//! The map as short straight segments, and the nearest of them for every place.

use super::frame::F32x8;
use crate::geom::{Grid, Point2, Polygon, Real, Region, Vector2, bounds, math};
use crate::named::named;
use crate::scene::{LaneKind, Map};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Longest segment, metres, with room for rounding.
const PIECE_M: Real = 5.01;
/// A segment ends where its line has turned by more than 20 degrees since the segment began.
const MIN_COS: Real = 0.94;
/// Points nearer than this are one, metres.
const MIN_STEP_M: Real = 1e-3;
/// The two sides of an edge are looked at this far from it, metres.
const ASIDE_M: Real = 0.05;
/// Side of a cell, metres; larger on maps that would need more than [`MAX_CELLS`].
const CELL_M: Real = 4.0;
/// Most cells of a map.
const MAX_CELLS: Real = 65_536.0;
/// Most segments that a place knows.
pub(crate) const MAX_SEGMENTS: usize = 256;

named! {
    /// What a segment belongs to; observations name it after `is_`.
    pub enum SegmentKind {
        /// Centre line of a lane.
        Lane = "lane",
        /// Centre line of a lane connector.
        Connector = "connector",
        /// Line between directions.
        RoadDivider = "road_divider",
        /// Line between lanes.
        LaneDivider = "lane_divider",
        /// Edge of the drivable area.
        RoadEdge = "road_edge",
        /// Edge of a pedestrian crossing.
        Crossing = "crossing",
        /// Edge of a stop line area.
        StopLine = "stop_line",
        /// Edge of a walkway.
        Walkway = "walkway",
    }
}

/// Columns, and the numbers of all segments that rows of them are made from.
type NumbersOf = (Vec<usize>, Arc<[F32x8]>);

/// A short straight part of a line of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Middle, x, metres.
    pub x: Real,
    /// Middle, y, metres.
    pub y: Real,
    /// Cosine of the direction.
    pub cos: Real,
    /// Sine of the direction.
    pub sin: Real,
    /// Half the length, metres.
    pub half_length_m: Real,
    /// What it belongs to.
    pub kind: SegmentKind,
}

/// Segments of all lines of a map, with the nearest ones of each 4 m cell.
///
/// The list of a cell is made when it is first asked for, from the cell's centre, and shared by all worlds: so
/// "nearest" is meant up to the cell's half diagonal, 2.8 m (places off the map take the cell at its border). Ties go
/// to the lower index.
///
/// Memory: 24 bytes a segment, 32 more for each eight columns of rows, 24 bytes a cell and 1 KiB for each cell asked for.
#[derive(Debug, Default)]
pub struct MapSegments {
    segments: Vec<Segment>,
    /// What rows are made from, for each choice of columns.
    numbers: Mutex<Vec<NumbersOf>>,
    grid: Grid,
    cells: Vec<OnceLock<Box<[u32]>>>,
}

impl MapSegments {
    /// Cuts the lines of a map.
    ///
    /// Edges of areas that lie on the bounding box of all areas and dividers are left out: there the map was cut out,
    /// nothing ends. (Lanes are kept whole by the loaders, so they do not count.)
    pub fn new(map: &Map) -> Self {
        Self::on_level(map, map, None, None)
    }

    /// The same of the part of a map on the level of an elevation, without edges that have the `road` on both sides.
    pub(crate) fn on_level(map: &Map, part: &Map, elevation_m: Option<Real>, road: Option<&Region>) -> Self {
        let mut segments = Self::default();
        for lane in &part.lanes {
            let kind =
                if lane.kind == LaneKind::Connector { SegmentKind::Connector } else { SegmentKind::Lane };
            for run in lane.on_level(elevation_m) {
                segments.add_line(&lane.centreline[run], kind);
            }
        }
        for (lines, kind) in
            [(&part.road_dividers, SegmentKind::RoadDivider), (&part.lane_dividers, SegmentKind::LaneDivider)]
        {
            for line in lines {
                segments.add_line(line, kind);
            }
        }
        let whole = Cut::of(map);
        for (polygons, kind) in [
            (&part.drivable_area, SegmentKind::RoadEdge),
            (&part.ped_crossings, SegmentKind::Crossing),
            (&part.stop_lines, SegmentKind::StopLine),
            (&part.walkways, SegmentKind::Walkway),
        ] {
            let road = road.filter(|_| elevation_m.is_some() && kind == SegmentKind::RoadEdge);
            let cut = Cut { road, ..whole };
            for ring in polygons.iter().flat_map(Polygon::rings) {
                segments.add_ring(ring, &cut, kind);
            }
        }
        segments.make_cells();
        segments
    }

    /// All segments.
    pub fn segments(&self) -> impl ExactSizeIterator<Item = Segment> {
        self.segments.iter().copied()
    }

    /// What rows of some columns are made from, made when it is first asked for.
    pub(super) fn numbers(&self, columns: &[usize], make: impl FnOnce() -> Arc<[F32x8]>) -> Arc<[F32x8]> {
        let mut made = self.numbers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, numbers)) = made.iter().find(|(of, _)| of == columns) {
            return Arc::clone(numbers);
        }
        let numbers = make();
        made.push((columns.to_vec(), Arc::clone(&numbers)));
        numbers
    }

    /// Number of segments.
    pub fn len(&self) -> usize {
        self.segments.len()
    }

    /// Whether the map has no line.
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty()
    }

    /// Indices of the segments nearest to a place, nearest first, at most 256.
    pub fn nearest(&self, at: Point2) -> &[u32] {
        if self.is_empty() {
            return &[];
        }
        let cell = self.grid.nearest_cell(at);
        self.cells[cell].get_or_init(|| self.sorted_from(self.grid.middle(cell)))
    }

    fn sorted_from(&self, centre: Point2) -> Box<[u32]> {
        let key = |(k, segment): (usize, &Segment)| {
            let (dx, dy) = (segment.x - centre.x, segment.y - centre.y);
            // distances are not negative, so their bits sort as they do
            u64::from((dx * dx + dy * dy).to_bits()) << 32 | k as u64
        };
        let mut keys: Vec<u64> = self.segments.iter().enumerate().map(key).collect();
        if keys.len() > MAX_SEGMENTS {
            keys.select_nth_unstable(MAX_SEGMENTS);
            keys.truncate(MAX_SEGMENTS);
        }
        keys.sort_unstable();
        keys.iter().map(|k| (k & 0xffff_ffff) as u32).collect()
    }

    fn add(&mut self, a: Point2, b: Point2, kind: SegmentKind) {
        let d = b - a;
        let length = math::hypot(d.x, d.y);
        if length < MIN_STEP_M {
            return;
        }
        let middle = nalgebra::center(&a, &b);
        let (cos, sin) = (d.x / length, d.y / length);
        self.segments.push(Segment { x: middle.x, y: middle.y, cos, sin, half_length_m: 0.5 * length, kind });
    }

    /// Joins the short edges of a line to segments up to a bend, and cuts the long ones.
    fn add_line(&mut self, line: &[Point2], kind: SegmentKind) {
        let Some((mut from, rest)) = line.split_first().map(|(p, rest)| (*p, rest)) else { return };
        let (mut last, mut travelled_m) = (from, 0.0);
        let mut direction: Option<Vector2> = None;
        for p in rest {
            let step = p - last;
            let length_m = math::hypot(step.x, step.y);
            if length_m < MIN_STEP_M {
                continue;
            }
            let unit = step / length_m;
            let bends = direction.is_some_and(|d| d.dot(&unit) < MIN_COS);
            if bends || travelled_m + length_m > PIECE_M {
                self.add(from, last, kind);
                (from, travelled_m, direction) = (last, 0.0, None);
            }
            if length_m > PIECE_M {
                let n = (length_m / PIECE_M).ceil();
                for k in 0..n as usize {
                    self.add(last + step * (k as Real / n), last + step * ((k + 1) as Real / n), kind);
                }
                from = *p;
            } else {
                travelled_m += length_m;
                direction.get_or_insert(unit);
            }
            last = *p;
        }
        self.add(from, last, kind);
    }

    /// Adds a ring, but for its edges on the cut.
    fn add_ring(&mut self, ring: &[Point2], cut: &Cut<'_>, kind: SegmentKind) {
        let Some(last) = ring.last() else { return };
        let mut run = vec![*last];
        let mut previous = *last;
        for p in ring {
            if cut.holds(&previous, p) {
                self.add_line(&run, kind);
                run.clear();
            }
            run.push(*p);
            previous = *p;
        }
        self.add_line(&run, kind);
    }

    fn make_cells(&mut self) {
        let middles = self.segments.iter().map(|s| Point2::new(s.x, s.y));
        let Some((low, high)) = bounds(middles) else { return };
        let (width, height) = (high.x - low.x, high.y - low.y);
        let mut cell_m = CELL_M;
        while (width / cell_m + 1.0) * (height / cell_m + 1.0) > MAX_CELLS {
            cell_m *= 2.0;
        }
        self.grid = Grid::with_cells(low, high, cell_m);
        self.cells = (0..self.grid.num_cells()).map(|_| OnceLock::new()).collect();
    }
}

/// The rectangle that the map was cut out with.
#[derive(Clone, Copy)]
struct Cut<'a> {
    low: Point2,
    high: Point2,
    /// Edges with this on both sides end nothing either.
    road: Option<&'a Region>,
}

impl Cut<'_> {
    fn of(map: &Map) -> Self {
        let areas: [&[Polygon]; 5] =
            [&map.drivable_area, &map.ped_crossings, &map.walkways, &map.stop_lines, &map.carpark_areas];
        let of_areas = areas.into_iter().flatten().flat_map(|p| &p.exterior);
        let of_lines = map.road_dividers.iter().chain(&map.lane_dividers).flatten();
        let none = (Point2::new(Real::MAX, Real::MAX), Point2::new(Real::MIN, Real::MIN));
        let (low, high) = bounds(of_areas.chain(of_lines).copied()).unwrap_or(none);
        Self { low, high, road: None }
    }

    /// Whether an edge lies on one side of the rectangle.
    fn holds(&self, a: &Point2, b: &Point2) -> bool {
        let both = |u: Real, v: Real, at: Real| (u - at).abs() < 1e-3 && (v - at).abs() < 1e-3;
        both(a.x, b.x, self.low.x)
            || both(a.x, b.x, self.high.x)
            || both(a.y, b.y, self.low.y)
            || both(a.y, b.y, self.high.y)
            || self.road.is_some_and(|road| {
                let (middle, way) = (nalgebra::center(a, b), b - a);
                let aside = Vector2::new(-way.y, way.x) * (ASIDE_M / way.norm().max(MIN_STEP_M));
                road.contains(middle + aside) && road.contains(middle - aside)
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: Real, y: Real, side_m: Real) -> Polygon {
        let at = |dx, dy| Point2::new(x + dx * side_m, y + dy * side_m);
        Polygon::from_exterior(vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)])
    }

    fn length_of(segments: &MapSegments, kind: SegmentKind) -> Real {
        segments.segments().filter(|p| p.kind == kind).map(|p| 2.0 * p.half_length_m).sum()
    }

    #[test]
    fn small_rings_and_sharp_corners_keep_their_outline() {
        let map = Map {
            walkways: vec![square(-50.0, -50.0, 100.0)],
            ped_crossings: vec![square(3.0, 2.0, 1.0)],
            road_dividers: vec![vec![Point2::new(0.0, 0.0), Point2::new(2.0, 0.0), Point2::new(2.0, 2.0)]],
            ..Map::default()
        };
        let segments = MapSegments::new(&map);
        assert!((length_of(&segments, SegmentKind::Crossing) - 4.0).abs() < 1e-3);
        assert!((length_of(&segments, SegmentKind::RoadDivider) - 4.0).abs() < 1e-3);
        // the walkway is the cut itself
        assert_eq!(length_of(&segments, SegmentKind::Walkway), 0.0);
    }

    #[test]
    fn a_road_along_the_axes_keeps_its_edges_where_other_layers_reach_further() {
        let road = square(-10.0, -10.0, 20.0);
        let map =
            Map { drivable_area: vec![road], walkways: vec![square(-15.0, -15.0, 30.0)], ..Map::default() };
        assert!((length_of(&MapSegments::new(&map), SegmentKind::RoadEdge) - 80.0).abs() < 1e-2);
    }

    #[test]
    fn maps_of_any_extent_have_few_cells() {
        let far = vec![Point2::new(-9e5, 0.0), Point2::new(-9e5, 1.0)];
        let near = vec![Point2::new(9e5, 9e5), Point2::new(9e5, 9e5 + 1.0)];
        let segments = MapSegments::new(&Map { lane_dividers: vec![far, near], ..Map::default() });
        assert!(segments.cells.len() <= MAX_CELLS as usize);
        assert_eq!(segments.nearest(Point2::new(1e6, 1e6)), [1, 0]);
        assert!(MapSegments::new(&Map::default()).nearest(Point2::origin()).is_empty());
    }
}
