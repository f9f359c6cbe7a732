//! Rows of map segments.

use super::column::clip;
use super::columns::{Entry, MAP};
use super::frame::{F32x8, Frame, Group, LANES, ZERO, fill_segments};
use super::map_segments::{MapSegments, Segment};
use super::source::OfSegment;
use crate::geom::{Point2, Real};
use std::sync::Arc;

/// Chosen columns that are written at once. In lanes that are left are the components of vectors that these columns need
/// and that are not among them.
#[derive(Debug, Clone)]
struct Columns {
    lanes: Vec<OfSegment>,
    chosen: Vec<usize>,
    group: Group,
}

/// Writes the nearest map segments.
#[derive(Debug, Clone)]
pub(super) struct MapRows {
    num_rows: usize,
    width: usize,
    chosen: Vec<usize>,
    groups: Vec<Columns>,
    /// The numbers of each segment [N, groups].
    numbers: Arc<[F32x8]>,
}

impl MapRows {
    pub(super) fn new(chosen: &[usize], num_rows: usize) -> Self {
        let mut groups = Vec::new();
        let mut rest = chosen;
        while !rest.is_empty() {
            // a vector's component and the other one fit always
            let fits = |n: &usize| lanes(&rest[..*n]).len() <= LANES;
            let (columns, others) = rest.split_at((1..=rest.len()).rev().find(fits).unwrap_or(1));
            groups.push(Columns::new(columns));
            rest = others;
        }
        let numbers = Arc::default();
        Self { num_rows, width: chosen.len(), chosen: chosen.to_vec(), groups, numbers }
    }

    /// Takes the numbers of a scene's segments.
    pub(super) fn enter(&mut self, segments: &MapSegments) {
        let of_segment = |segment| self.groups.iter().map(move |columns| columns.numbers(&segment));
        self.numbers = segments.numbers(&self.chosen, || segments.segments().flat_map(of_segment).collect());
    }

    /// Floats of all rows.
    pub(super) fn size(&self) -> usize {
        self.num_rows * self.width
    }

    /// Fills [N, F] and the mask [N] (or nothing, where there is no mask).
    pub(super) fn write(&self, segments: &MapSegments, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        if out.is_empty() {
            return;
        }
        let nearest = segments.nearest(Point2::new(frame.x, frame.y));
        let nearest = &nearest[..nearest.len().min(self.num_rows)];
        let (rows, absent) = out.split_at_mut(nearest.len() * self.width);
        let (numbers, width) = (&*self.numbers, self.width);
        match &self.groups[..] {
            [a] => fill_segments::<1, 1>(&[&a.group], &[0], frame, numbers, nearest, width, rows),
            [a, b] => {
                let (groups, firsts) = ([&a.group, &b.group], [0, a.chosen.len()]);
                if b.group.turns() {
                    fill_segments::<2, 2>(&groups, &firsts, frame, numbers, nearest, width, rows);
                } else {
                    fill_segments::<2, 1>(&groups, &firsts, frame, numbers, nearest, width, rows);
                }
            }
            [a, b, c] => {
                let firsts = [0, a.chosen.len(), a.chosen.len() + b.chosen.len()];
                let groups = [&a.group, &b.group, &c.group];
                fill_segments::<3, 3>(&groups, &firsts, frame, numbers, nearest, width, rows);
            }
            _ => {}
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..nearest.len()].fill(1.0);
            mask[nearest.len()..].fill(0.0);
        }
    }
}

// all columns, each in a lane, and all four components once more
const _: () = assert!(MAP.len() + 4 <= 3 * (LANES - 1));

/// The entries of columns.
fn entries(chosen: &[usize]) -> impl Iterator<Item = &'static Entry<OfSegment>> {
    chosen.iter().map(|c| &MAP[*c])
}

/// What columns are made from, and the other components of their vectors where these are not among them.
fn lanes(chosen: &[usize]) -> Vec<OfSegment> {
    let mut lanes: Vec<OfSegment> = entries(chosen).map(|e| e.source).collect();
    for lane in 0..lanes.len() {
        let other = lanes[lane].other();
        if !lanes.contains(&other) {
            lanes.push(other);
        }
    }
    lanes
}

impl Columns {
    fn new(chosen: &[usize]) -> Self {
        let (lanes, mut group) = (lanes(chosen), Group::new());
        for (lane, source) in lanes.iter().enumerate() {
            let column = entries(chosen).nth(lane).map(|e| &e.column);
            let other = lanes.iter().position(|l| *l == source.other()).unwrap_or(lane);
            match source {
                OfSegment::Place(axis) => {
                    group.set_component(lane, [axis.own_and_other([0, 1]).0, other], *axis, column);
                }
                OfSegment::Direction(axis) => group.set_component(lane, [ZERO, other], *axis, column),
                OfSegment::HalfLength | OfSegment::Is(_) => group.set_constant(lane),
            }
        }
        Self { lanes, chosen: chosen.to_vec(), group }
    }

    /// The numbers of a segment, lane by lane.
    fn numbers(&self, segment: &Segment) -> F32x8 {
        let mut numbers = F32x8::default();
        for (lane, source) in self.lanes.iter().enumerate() {
            numbers.0[lane] = match source {
                OfSegment::Place(axis) => axis.own_and_other([segment.x, segment.y]).0,
                OfSegment::Direction(axis) => axis.own_and_other([segment.cos, segment.sin]).0,
                OfSegment::HalfLength => {
                    let column = &MAP[self.chosen[lane]].column;
                    clip(segment.half_length_m * (1.0 / column.scale), column.low, column.high)
                }
                OfSegment::Is(kind) => f32::from(u8::from(*kind == segment.kind)),
            };
        }
        numbers
    }
}
