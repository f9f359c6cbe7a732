//! Nearest lane centre line through a uniform grid.
//!
//! Each cell lists every segment that can be the nearest one, in any direction or among those that agree with some
//! heading, for some point of the cell. A query looks at its cell's list and nothing else. Lists are made when they are
//! first asked for. A second list of each cell holds the lanes whose surface reaches into it.

use super::cell_border::{Border, Parts};
use super::road_area::HALF_LANE_M;
use super::{LaneKind, Map};
use crate::geom::{Grid, Point2, Real, Vector2, bounds, edge_distance_sq, math, ring_edges};
use crate::simd_dispatch::{pick, simd_dispatch};
use std::sync::OnceLock;

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
/// Coordinates of what is nowhere near, metres.
const FAR_M: Real = 1e30;

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

/// Segments that are looked at together.
const LANES: usize = 8;

/// Segments of a list, by their numbers; none in the rest of the last block, infinitely far.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Block {
    x: [Real; LANES],
    y: [Real; LANES],
    cos: [Real; LANES],
    sin: [Real; LANES],
    length_m: [Real; LANES],
    segment_idx: [u32; LANES],
}

/// Finds the nearest lane centre line.
///
/// Memory: 28 bytes a segment, 48 bytes a cell, and 24 bytes for each segment that matters in a cell once asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct LaneIndex {
    grid: Grid,
    segments: Vec<Segment>,
    cells: Vec<Cell>,
    /// Number of the first segment of each lane, and that of all.
    first_segment: Vec<u32>,
    /// Limit of each lane, see [`Map`], close together.
    speed_limits_mps: Vec<Option<Real>>,
}

/// What may matter in a cell, next to each other in memory.
#[derive(Debug, Clone, PartialEq, Default)]
struct Cell {
    segments: OnceLock<Box<[Block]>>,
    surfaces: OnceLock<Box<[Surface]>>,
}

/// A lane whose surface reaches into a cell.
#[derive(Debug, Clone, PartialEq)]
struct Surface {
    lane_idx: u32,
    is_lane: bool,
    /// Its mean direction, and the cosine to that above which a heading agrees with all of the lane.
    direction: Vector2,
    agrees_above: Real,
    parts: Parts,
    /// Its border in the cell; `None` without a polygon.
    border: Option<Box<Border>>,
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
    /// Cosine and sine of the heading of the query minus the heading of the lane.
    turn: [Real; 2],
}

impl LaneHit {
    /// Whether the query points along the lane, within 90 degrees.
    #[inline]
    pub fn agrees(&self) -> bool {
        self.turn[0] >= 0.0
    }

    /// Cosine of the heading of the query minus that of the lane.
    #[inline]
    pub fn heading_cos(&self) -> Real {
        self.turn[0]
    }

    /// Heading of the query minus heading of the lane, radians in (−π, π].
    pub fn heading_error_rad(&self) -> Real {
        math::atan2(self.turn[1], self.turn[0])
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
        Self::on_level(map, None)
    }

    /// Index of the lanes that are on the level of an elevation; of all lanes without one.
    pub fn on_level(map: &Map, elevation_m: Option<Real>) -> Option<Self> {
        let (mut segments, mut first_segment) = (Vec::new(), vec![0]);
        for (lane_idx, lane) in map.lanes.iter().enumerate() {
            let runs = lane.on_level(elevation_m).filter(|run| run.len() > 1);
            let runs = runs.map(|run| (run.start, run.end - 1)).collect();
            add_segments(lane_idx as u32, &lane.centreline, runs, &mut segments);
            first_segment.push(segments.len() as u32);
        }
        let ends = |s: &Segment| [s.start, s.end()];
        let (min, max) = bounds(segments.iter().flat_map(ends))?;
        let (min, max) =
            (Point2::new(min.x - REACH_M, min.y - REACH_M), Point2::new(max.x + REACH_M, max.y + REACH_M));
        let grid = Grid::new(min, max, CELL_M, MAX_CELLS);
        let cells = vec![Cell::default(); grid.num_cells()];
        let speed_limits_mps = map.lanes.iter().map(|lane| lane.speed_limit_mps).collect();
        Some(Self { grid, segments, cells, first_segment, speed_limits_mps })
    }

    /// Lanes and connectors whose surface holds a point, in the order of the map. A lane without a polygon is 3.5 m wide.
    pub fn holding<'a>(&'a self, map: &'a Map, point: Point2) -> impl Iterator<Item = usize> + 'a {
        let list = self.grid.cell(point).map(|cell| self.surfaces(map, cell));
        let holds = move |s: &&Surface| self.surface_holds(map, s, point);
        list.into_iter().flatten().filter(holds).map(|s| s.lane_idx as usize)
    }

    /// Whether the surface of a cell holds a point of the cell.
    fn surface_holds(&self, map: &Map, surface: &Surface, point: Point2) -> bool {
        surface.parts.at(self.grid.part(point)).unwrap_or_else(|| match &surface.border {
            Some(border) => border.holds(point),
            None => self.holds(map, surface.lane_idx as usize, point),
        })
    }

    /// Whether a lane's surface holds a point.
    pub fn holds(&self, map: &Map, lane_idx: usize, point: Point2) -> bool {
        let surface = &map.lanes[lane_idx].polygon;
        match surface.exterior.len() < 3 {
            true => self.distance_sq(lane_idx, point) <= HALF_LANE_M * HALF_LANE_M,
            // lanes of another level have no segments
            false => !self.of_lane(lane_idx).is_empty() && surface.contains(point),
        }
    }

    /// Distance of a point from a lane's surface, metres; 0 in it.
    pub(super) fn surface_distance_m(&self, map: &Map, lane_idx: usize, point: Point2) -> Real {
        let surface = &map.lanes[lane_idx].polygon;
        if self.holds(map, lane_idx, point) {
            return 0.0;
        }
        if surface.exterior.len() < 3 {
            return self.distance_sq(lane_idx, point).sqrt() - HALF_LANE_M;
        }
        let edges = surface.rings().flat_map(ring_edges);
        edges.map(|(a, b)| edge_distance_sq(a, b, point)).fold(Real::INFINITY, Real::min).sqrt()
    }

    /// The nearest point of one lane's centre line to a pose given by its position, cosine and sine of its heading.
    pub fn on_lane(&self, lane_idx: usize, point: Point2, cos: Real, sin: Real) -> Option<LaneHit> {
        let with_distance = self.of_lane(lane_idx).iter().map(|s| (s.distance_sq(point), s));
        let (distance_sq, nearest) = with_distance.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(nearest.hit(point, cos, sin, distance_sq))
    }

    /// The point of a lane's centre line that is nearest to another one; that one itself where the lane has no length.
    pub(super) fn foot(&self, lane_idx: usize, point: Point2) -> Point2 {
        let nearest = self
            .of_lane(lane_idx)
            .iter()
            .min_by(|a, b| a.distance_sq(point).total_cmp(&b.distance_sq(point)));
        nearest.map_or(point, |s| s.start + Vector2::new(s.cos, s.sin) * s.along(point))
    }

    fn of_lane(&self, lane_idx: usize) -> &[Segment] {
        &self.segments[self.first_segment[lane_idx] as usize..self.first_segment[lane_idx + 1] as usize]
    }

    fn distance_sq(&self, lane_idx: usize, point: Point2) -> Real {
        self.of_lane(lane_idx).iter().map(|s| s.distance_sq(point)).fold(Real::INFINITY, Real::min)
    }

    /// The lanes whose surfaces reach into a cell, found when they are first asked for.
    fn surfaces(&self, map: &Map, cell: usize) -> &[Surface] {
        self.cells[cell].surfaces.get_or_init(|| self.surfaces_in(map, cell))
    }

    fn surfaces_in(&self, map: &Map, cell: usize) -> Box<[Surface]> {
        let (centre, half_m) = self.middle(cell);
        let (low, high) = (centre - Vector2::new(half_m, half_m), centre + Vector2::new(half_m, half_m));
        let meets = |lane_idx: usize| {
            let is_near = |(least, most): (Point2, Point2)| {
                most.x >= low.x && least.x <= high.x && most.y >= low.y && least.y <= high.y
            };
            let polygon = &map.lanes[lane_idx].polygon;
            // lanes of another level have no segments
            !self.of_lane(lane_idx).is_empty()
                && (polygon.exterior.len() < 3 || polygon.bounds().is_some_and(is_near))
                && self.surface_distance_m(map, lane_idx, centre) <= half_m
        };
        let found = (0..map.lanes.len()).filter(|lane_idx| meets(*lane_idx));
        let surface = |lane_idx: usize| {
            let along = |s: &Segment| Vector2::new(s.cos, s.sin);
            let sum: Vector2 = self.of_lane(lane_idx).iter().map(|s| along(s) * s.length_m).sum();
            let direction = sum / sum.norm().max(1e-9);
            let least = self.of_lane(lane_idx).iter().map(|s| along(s).dot(&direction)).fold(1.0, Real::min);
            // within 90 degrees of the direction that is farthest from the mean; the margin covers rounding
            let agrees_above = if least > 0.0 { (1.0 - least * least).max(0.0).sqrt() + 1e-3 } else { 2.0 };
            let is_lane = map.lanes[lane_idx].kind == LaneKind::Lane;
            let polygon = &map.lanes[lane_idx].polygon;
            let border = (polygon.exterior.len() >= 3).then(|| Box::new(Border::new(polygon, low, high)));
            let look = |point: Point2| match &border {
                Some(border) => (border.holds(point), border.distance_m(point)),
                None => {
                    let depth_m = HALF_LANE_M - self.distance_sq(lane_idx, point).sqrt();
                    (depth_m > 0.0, depth_m.abs())
                }
            };
            let parts = Parts::new(centre, self.grid.cell_m, look);
            Surface { lane_idx: lane_idx as u32, is_lane, direction, agrees_above, parts, border }
        };
        found.map(surface).collect()
    }

    /// Whether the surface of a lane holds a point, and all lanes whose surface does run against a direction; `agrees` tells
    /// it of one. Connectors say nothing. Most lanes of a cell agree for certain, without a look at their surface.
    pub fn all_against(
        &self,
        map: &Map,
        point: Point2,
        (cos, sin): (Real, Real),
        agrees: impl Fn(usize) -> bool,
    ) -> bool {
        let Some(cell) = self.grid.cell(point) else { return false };
        let agrees_surely = |s: &&Surface| s.along(cos, sin) > s.agrees_above;
        let holds = |s: &Surface| self.surface_holds(map, s, point);
        let lanes = || self.surfaces(map, cell).iter().filter(|s| s.is_lane);
        let mut is_held = false;
        for s in lanes().filter(|s| !agrees_surely(s) && holds(s)) {
            if s.along(cos, sin) > -s.agrees_above && agrees(s.lane_idx as usize) {
                return false;
            }
            is_held = true;
        }
        is_held && !lanes().any(|s| agrees_surely(&s) && holds(s))
    }

    /// The middle of a cell, and a bit more than half its diagonal, metres.
    fn middle(&self, cell: usize) -> (Point2, Real) {
        // the margin covers rounding
        (self.grid.middle(cell), 0.5 * math::hypot(self.grid.cell_m, self.grid.cell_m) + 0.01)
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
        let list = self.cells[cell].segments.get_or_init(|| self.list(cell));
        let mut keys = [u64::MAX; 2];
        nearest_of(list, point, [cos, sin], &mut keys);
        let reach_m = max_distance_m.min(REACH_M);
        let hit = |key: u64| {
            let (distance_sq, at) = (Real::from_bits((key >> 32) as u32), key as u32 as usize);
            let block = list.get(at / LANES).filter(|_| distance_sq <= reach_m * reach_m)?;
            let segment = &self.segments[block.segment_idx[at % LANES] as usize];
            Some(segment.hit(point, cos, sin, distance_sq))
        };
        let [any, agreeing] = keys;
        let any_hit = hit(any);
        NearLanes { agreeing: if agreeing == any { any_hit } else { hit(agreeing) }, any: any_hit }
    }

    /// Limit of a lane, m/s, where the map has one.
    #[inline]
    pub fn speed_limit_mps(&self, lane_idx: u32) -> Option<Real> {
        self.speed_limits_mps[lane_idx as usize]
    }

    /// Lanes further away than this are never found, metres.
    pub fn reach_m(&self) -> Real {
        REACH_M
    }

    /// The segments that may matter in a cell of half diagonal h: at a distance d from its centre, a segment can be nearest
    /// to a point of it only if d − h does not exceed the smallest d + h, likewise among those that agree with a heading.
    fn list(&self, cell: usize) -> Box<[Block]> {
        let (centre, half_m) = self.middle(cell);
        let farthest_m = REACH_M + 2.0 * half_m;
        let near: Vec<(u32, Real, usize)> = (0u32..)
            .zip(&self.segments)
            .map(|(i, segment)| (i, segment.distance_sq(centre).sqrt(), segment))
            .filter(|(_, distance_m, _)| *distance_m <= farthest_m)
            .map(|(i, distance_m, segment)| (i, distance_m, segment.sector()))
            .collect();
        // a direction d sectors away agrees with all headings of the sector (d < 2), with some (d = 2), with none
        let apart = |a: usize, b: usize| {
            let d = a.abs_diff(b);
            d.min(NUM_SECTORS - d)
        };
        let nearest = |of: &dyn Fn(usize) -> bool| {
            near.iter().filter(|(_, _, sector)| of(*sector)).map(|(_, d, _)| *d).fold(REACH_M, Real::min)
        };
        let limit: [Real; NUM_SECTORS] =
            std::array::from_fn(|sector| nearest(&|of| apart(of, sector) < 2) + 2.0 * half_m);
        let limit_any = nearest(&|_| true) + 2.0 * half_m;
        let matters = |(_, distance_m, of): &&(u32, Real, usize)| {
            let may_agree = |sector: usize| apart(*of, sector) <= 2 && *distance_m <= limit[sector];
            *distance_m <= limit_any || (0..NUM_SECTORS).any(may_agree)
        };
        let kept: Vec<u32> = near.iter().filter(matters).map(|(i, ..)| *i).collect();
        kept.chunks(LANES).map(|indices| self.block(indices)).collect()
    }

    fn block(&self, indices: &[u32]) -> Block {
        let of = |number: fn(&Segment) -> Real, none: Real| {
            std::array::from_fn(|lane| {
                indices.get(lane).map_or(none, |i| number(&self.segments[*i as usize]))
            })
        };
        Block {
            x: of(|s| s.start.x, FAR_M),
            y: of(|s| s.start.y, FAR_M),
            cos: of(|s| s.cos, 0.0),
            sin: of(|s| s.sin, 0.0),
            length_m: of(|s| s.length_m, 0.0),
            segment_idx: std::array::from_fn(|lane| indices.get(lane).copied().unwrap_or(u32::MAX)),
        }
    }
}

simd_dispatch! {
    /// Keys of the nearest of all segments and of those that agree with a direction: bits of the squared distance, which
    /// are ordered like it, then the place in the list.
    fn nearest_of(list: &[Block], point: Point2, direction: [Real; 2], keys: &mut [u64; 2]) {
        let (mut any_sq, mut agreeing_sq) = ([Real::INFINITY; LANES], [Real::INFINITY; LANES]);
        let (mut any, mut agreeing) = ([0u32; LANES], [0u32; LANES]);
        for (k, block) in list.iter().enumerate() {
            for lane in 0..LANES {
                let (cos, sin) = (block.cos[lane], block.sin[lane]);
                let (dx, dy) = (point.x - block.x[lane], point.y - block.y[lane]);
                let along = dx * cos + dy * sin;
                // one instruction each, which `min` and `max` are not
                let along = if along < block.length_m[lane] { along } else { block.length_m[lane] };
                let along = if along > 0.0 { along } else { 0.0 };
                let (ox, oy) = (dx - along * cos, dy - along * sin);
                let distance_sq = ox * ox + oy * oy;
                let nearer = u32::from(distance_sq < any_sq[lane]).wrapping_neg();
                any_sq[lane] = pick(nearer, distance_sq, any_sq[lane]);
                any[lane] = k as u32 & nearer | any[lane] & !nearer;
                let agrees = cos * direction[0] + sin * direction[1] >= 0.0;
                let distance_sq = if agrees { distance_sq } else { Real::INFINITY };
                let nearer = u32::from(distance_sq < agreeing_sq[lane]).wrapping_neg();
                agreeing_sq[lane] = pick(nearer, distance_sq, agreeing_sq[lane]);
                agreeing[lane] = k as u32 & nearer | agreeing[lane] & !nearer;
            }
        }
        *keys = [(any_sq, any), (agreeing_sq, agreeing)].map(|(distance_sq, blocks)| {
            let key = |lane: usize| {
                let at = blocks[lane] as usize * LANES + lane;
                u64::from(distance_sq[lane].to_bits()) << 32 | at as u64
            };
            (0..LANES).map(key).fold(u64::MAX, u64::min)
        });
    }
}

impl Surface {
    /// Cosine between the lane's mean direction and a heading.
    fn along(&self, cos: Real, sin: Real) -> Real {
        self.direction.x * cos + self.direction.y * sin
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
            turn: [self.cos * cos + self.sin * sin, self.cos * sin - self.sin * cos],
        }
    }

    fn sector(&self) -> usize {
        let turns = math::atan2(self.sin, self.cos) / std::f32::consts::TAU;
        ((turns + 1.0) * NUM_SECTORS as Real) as usize % NUM_SECTORS
    }
}

/// Appends the segments of runs of a centre line, straight ones merged (Douglas and Peucker 1973).
fn add_segments(
    lane_idx: u32,
    points: &[Point2],
    mut runs: Vec<(usize, usize)>,
    segments: &mut Vec<Segment>,
) {
    let mut s_m = vec![0.0_f64; points.len()];
    for i in 1..points.len() {
        s_m[i] = s_m[i - 1] + f64::from((points[i] - points[i - 1]).norm());
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
