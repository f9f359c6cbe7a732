//! Nearest lane centre line through a uniform grid.
//!
//! Each cell lists every segment that can be the nearest one, in any direction or among those that agree with some
//! heading, for some point of the cell. A query looks at its cell's list and nothing else.

use super::Map;
use crate::geom::{Grid, Point2, Real, math};

/// Side of a cell, metres.
const CELL_M: f64 = 4.0;
/// Most cells of a grid.
const MAX_CELLS: f64 = 40_000.0;
/// Lanes further away than this are not found, metres.
const REACH_M: Real = 10.0;
/// Points of a centre line that lie this near to the line through their neighbours are left out, metres.
const SIMPLIFY_M: Real = 0.01;
/// Headings are told apart in this many sectors when the lists are built.
const NUM_SECTORS: usize = 8;

/// A straight segment of a centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Segment {
    start: Point2,
    cos: Real,
    sin: Real,
    length_m: Real,
    /// Arc length of the lane at the start, and per metre of segment.
    s_m: Real,
    s_per_m: Real,
    lane_idx: u32,
}

/// Finds the nearest lane centre line. Immutable, built once per map.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneIndex {
    grid: Grid,
    segments: Vec<Segment>,
    /// Start of each cell's list in `entries` [cells + 1].
    starts: Vec<u32>,
    entries: Vec<u32>,
}

/// The nearest point of a lane's centre line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneHit {
    /// Index into [`Map::lanes`].
    pub lane_idx: u32,
    /// Arc length along the centre line, metres.
    pub s_m: Real,
    /// Offset from the centre line, metres, left positive.
    pub lateral_m: Real,
    /// Distance to the centre line, metres.
    pub distance_m: Real,
    /// Heading of the query minus heading of the lane, radians in (−π, π].
    pub heading_error_rad: Real,
}

impl LaneHit {
    /// Whether the query points along the lane, within 90 degrees.
    #[inline]
    pub fn agrees(&self) -> bool {
        self.heading_error_rad.abs() <= std::f32::consts::FRAC_PI_2
    }
}

/// Nearest lanes by direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NearLanes {
    /// The nearest lane whose direction agrees with the query's within 90 degrees.
    pub agreeing: Option<LaneHit>,
    /// The nearest lane of any direction.
    pub any: Option<LaneHit>,
}

impl LaneIndex {
    /// Index of a map's lanes; `None` when it has none.
    pub fn new(map: &Map) -> Option<Self> {
        let mut segments = Vec::new();
        for (lane_idx, lane) in map.lanes.iter().enumerate() {
            add_segments(lane_idx as u32, &lane.centreline, &mut segments);
        }
        let ends = |s: &Segment| [s.start, s.end()];
        let first = segments.first()?.start;
        let (min, max) = segments.iter().flat_map(ends).fold((first, first), |(lo, hi), p| {
            (Point2::new(lo.x.min(p.x), lo.y.min(p.y)), Point2::new(hi.x.max(p.x), hi.y.max(p.y)))
        });
        let (min, max) =
            (Point2::new(min.x - REACH_M, min.y - REACH_M), Point2::new(max.x + REACH_M, max.y + REACH_M));
        let grid = Grid::new(min, max, CELL_M, MAX_CELLS);
        let mut lists = vec![Vec::new(); grid.num_columns * grid.num_rows];
        let all: Vec<u32> = (0..segments.len() as u32).collect();
        let block = Block { column: 0, row: 0, num_columns: grid.num_columns, num_rows: grid.num_rows };
        fill_lists(&grid, &segments, block, &all, &mut lists);
        let mut starts = Vec::with_capacity(lists.len() + 1);
        let mut entries = Vec::with_capacity(lists.iter().map(Vec::len).sum());
        for list in lists {
            starts.push(entries.len() as u32);
            entries.extend(list);
        }
        starts.push(entries.len() as u32);
        Some(Self { grid, segments, starts, entries })
    }

    /// Nearest lane to a pose given by its position and the cosine and sine of its heading.
    ///
    /// Lanes whose direction agrees within 90 degrees come first, however near the others are; where there is none,
    /// the nearest of any direction. `None` when no lane is within `max_distance_m` (at most [`Self::reach_m`]).
    #[inline]
    pub fn nearest(&self, point: Point2, cos: Real, sin: Real, max_distance_m: Real) -> Option<LaneHit> {
        let near = self.nearest_by_direction(point, cos, sin, max_distance_m);
        near.agreeing.or(near.any)
    }

    /// Nearest lane among those that agree with the heading, and nearest lane of all; on equal distances the lane
    /// of lower index.
    pub fn nearest_by_direction(
        &self,
        point: Point2,
        cos: Real,
        sin: Real,
        max_distance_m: Real,
    ) -> NearLanes {
        let Some(cell) = self.grid.cell(point) else { return NearLanes::default() };
        let list = &self.entries[self.starts[cell] as usize..self.starts[cell + 1] as usize];
        // bits of the squared distance (ordered like the distance, which is not negative), then the segment: the
        // smaller key is the nearer segment, without a branch
        let (mut any, mut agreeing) = (u64::MAX, u64::MAX);
        for &segment_idx in list {
            let segment = &self.segments[segment_idx as usize];
            let key = u64::from(segment.distance_sq(point).to_bits()) << 32 | u64::from(segment_idx);
            let agrees = segment.cos * cos + segment.sin * sin >= 0.0;
            any = any.min(key);
            agreeing = agreeing.min(if agrees { key } else { u64::MAX });
        }
        let reach_m = max_distance_m.min(REACH_M);
        let hit = |key: u64| {
            let (distance_sq, segment_idx) = (Real::from_bits((key >> 32) as u32), key as u32 as usize);
            // no segment: the distance is not a number
            let segment = self.segments.get(segment_idx).filter(|_| distance_sq <= reach_m * reach_m)?;
            Some(segment.hit(point, cos, sin, distance_sq))
        };
        let any_hit = hit(any);
        NearLanes { agreeing: if agreeing == any { any_hit } else { hit(agreeing) }, any: any_hit }
    }

    /// Lanes further away than this are never found, metres.
    pub fn reach_m(&self) -> Real {
        REACH_M
    }

    /// Bytes held on the heap.
    pub fn num_bytes(&self) -> usize {
        size_of_val(self.segments.as_slice())
            + size_of_val(self.starts.as_slice())
            + size_of_val(self.entries.as_slice())
    }
}

impl Segment {
    fn end(&self) -> Point2 {
        Point2::new(self.start.x + self.cos * self.length_m, self.start.y + self.sin * self.length_m)
    }

    /// Distance along the segment of the point nearest to a point, metres.
    #[inline]
    fn along(&self, point: Point2) -> Real {
        let (dx, dy) = (point.x - self.start.x, point.y - self.start.y);
        (dx * self.cos + dy * self.sin).min(self.length_m).max(0.0)
    }

    #[inline]
    fn distance_sq(&self, point: Point2) -> Real {
        let along = self.along(point);
        let dx = point.x - self.start.x - along * self.cos;
        let dy = point.y - self.start.y - along * self.sin;
        dx * dx + dy * dy
    }

    fn hit(&self, point: Point2, cos: Real, sin: Real, distance_sq: Real) -> LaneHit {
        let (dx, dy) = (point.x - self.start.x, point.y - self.start.y);
        LaneHit {
            lane_idx: self.lane_idx,
            s_m: self.s_m + self.along(point) * self.s_per_m,
            lateral_m: self.cos * dy - self.sin * dx,
            distance_m: distance_sq.sqrt(),
            heading_error_rad: math::atan2(self.cos * sin - self.sin * cos, self.cos * cos + self.sin * sin),
        }
    }

    /// Sector of the segment's direction.
    fn sector(&self) -> usize {
        let turns = math::atan2(self.sin, self.cos) / std::f32::consts::TAU;
        ((turns + 1.0) * NUM_SECTORS as Real) as usize % NUM_SECTORS
    }
}

/// Appends the segments of a centre line, straight runs merged (Douglas and Peucker 1973).
fn add_segments(lane_idx: u32, points: &[Point2], segments: &mut Vec<Segment>) {
    let mut s_m = vec![0.0_f64; points.len()];
    for i in 1..points.len() {
        s_m[i] = s_m[i - 1] + f64::from((points[i] - points[i - 1]).norm());
    }
    let mut runs = Vec::new();
    if points.len() > 1 {
        runs.push((0, points.len() - 1));
    }
    while let Some((from, to)) = runs.pop() {
        let chord = points[to] - points[from];
        let length_m = math::hypot(chord.x, chord.y);
        let unit = if length_m > 0.0 { chord / length_m } else { chord };
        let deviation = |i: usize| {
            let d = points[i] - points[from];
            // past the ends of the chord (a line that turns back) the distance to the chord's line says nothing
            let along = d.dot(&unit);
            let beyond = if length_m > 0.0 { (-along).max(along - length_m).max(0.0) } else { d.norm() };
            (unit.x * d.y - unit.y * d.x).abs() + beyond
        };
        let furthest = (from + 1..to).map(|i| (deviation(i), i)).max_by(|a, b| a.0.total_cmp(&b.0));
        match furthest {
            Some((distance_m, middle)) if distance_m > SIMPLIFY_M => {
                runs.push((middle, to));
                runs.push((from, middle));
            }
            _ if length_m > 0.0 => segments.push(Segment {
                start: points[from],
                cos: unit.x,
                sin: unit.y,
                length_m,
                s_m: s_m[from] as Real,
                s_per_m: (s_m[to] - s_m[from]) as Real / length_m,
                lane_idx,
            }),
            _ => {}
        }
    }
}

/// A rectangle of cells.
#[derive(Clone, Copy)]
struct Block {
    column: usize,
    row: usize,
    num_columns: usize,
    num_rows: usize,
}

impl Block {
    fn halves(self) -> [Self; 2] {
        let (mut a, mut b) = (self, self);
        if self.num_columns >= self.num_rows {
            a.num_columns = self.num_columns / 2;
            b.num_columns -= a.num_columns;
            b.column += a.num_columns;
        } else {
            a.num_rows = self.num_rows / 2;
            b.num_rows -= a.num_rows;
            b.row += a.num_rows;
        }
        [a, b]
    }
}

/// Fills the lists of a block's cells from the segments that may matter there, block by smaller block.
///
/// With c the centre of the block and h half its diagonal, a segment at distance d from c lies within [d − h, d + h]
/// of every point of the block. It can be nearest somewhere only if d − h does not exceed the smallest d + h, and
/// nearest among those that agree with a heading only if that holds among the segments that agree with every heading
/// of the heading's sector.
fn fill_lists(grid: &Grid, segments: &[Segment], block: Block, candidates: &[u32], lists: &mut [Vec<u32>]) {
    let (width, height) = (block.num_columns as Real * grid.cell_m, block.num_rows as Real * grid.cell_m);
    let centre = Point2::new(
        grid.min.x + block.column as Real * grid.cell_m + 0.5 * width,
        grid.min.y + block.row as Real * grid.cell_m + 0.5 * height,
    );
    // the margin covers rounding
    let half_m = 0.5 * math::hypot(width, height) + 0.01;
    let distances: Vec<Real> =
        candidates.iter().map(|i| segments[*i as usize].distance_sq(centre).sqrt()).collect();
    let sectors: Vec<usize> = candidates.iter().map(|i| segments[*i as usize].sector()).collect();
    // a direction d sectors away agrees with all headings of the sector (d < 2), with some (d = 2), with none
    let apart = |a: usize, b: usize| {
        let d = a.abs_diff(b);
        d.min(NUM_SECTORS - d)
    };
    let nearest = |of: &dyn Fn(usize) -> bool| {
        (0..candidates.len()).filter(|i| of(*i)).map(|i| distances[i]).fold(REACH_M, Real::min)
    };
    let mut limit = [0.0; NUM_SECTORS];
    for (sector, limit) in limit.iter_mut().enumerate() {
        *limit = nearest(&|i| apart(sectors[i], sector) < 2) + 2.0 * half_m;
    }
    let limit_any = nearest(&|_| true) + 2.0 * half_m;
    let kept: Vec<u32> = (0..candidates.len())
        .filter(|i| {
            let may_agree = |s: usize| apart(sectors[*i], s) <= 2 && distances[*i] <= limit[s];
            distances[*i] <= limit_any || (0..NUM_SECTORS).any(may_agree)
        })
        .map(|i| candidates[i])
        .collect();
    if block.num_columns * block.num_rows > 1 && !kept.is_empty() {
        for half in block.halves() {
            fill_lists(grid, segments, half, &kept, lists);
        }
    } else if block.num_columns * block.num_rows == 1 {
        lists[block.row * grid.num_columns + block.column] = kept;
    }
}
