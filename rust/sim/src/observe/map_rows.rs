//! Rows of map segments.

use super::column::clip;
use super::columns::MAP;
use super::frame::{F32x8, Frame, Group, LANES, MOST_GROUPS, Part, fill_rows};
use super::map_segments::{MapSegments, Segment};
use super::source::OfSegment;
use crate::geom::{Point2, Real};
use std::sync::Arc;

#[derive(Debug, Clone)]
pub(super) struct MapRows {
    num_rows: usize,
    chosen: Vec<usize>,
    groups: Vec<Group>,
    /// The numbers of each segment [N, groups].
    numbers: Arc<[F32x8]>,
}

// all columns, and all four components once more
const _: () = assert!(MAP.len() + 4 <= MOST_GROUPS * (LANES - 1));

/// Places of the vectors of a segment among the numbers of an origin.
const PLACE: usize = 0;
const DIRECTION: usize = 2;

impl MapRows {
    pub(super) fn new(chosen: &[usize], num_rows: usize) -> Self {
        let part = |column: &usize| {
            let part = match MAP[*column].source {
                OfSegment::Place(axis) => Part::Component(PLACE, axis),
                OfSegment::Direction(axis) => Part::Component(DIRECTION, axis),
                OfSegment::HalfLength | OfSegment::Is(_) => Part::Constant,
            };
            (part, &MAP[*column].column)
        };
        let groups = Group::of_row(&chosen.iter().map(part).collect::<Vec<_>>());
        Self { num_rows, chosen: chosen.to_vec(), groups, numbers: Arc::default() }
    }

    /// Takes the numbers of a scene's segments.
    pub(super) fn enter(&mut self, segments: &MapSegments) {
        self.numbers =
            segments.numbers(&self.chosen, || segments.segments().flat_map(|s| self.of(s)).collect());
    }

    fn of(&self, segment: Segment) -> impl Iterator<Item = F32x8> {
        let mut constants = self.chosen.iter().map(move |column| match MAP[*column].source {
            OfSegment::HalfLength => {
                let column = &MAP[*column].column;
                clip(segment.half_length_m * (1.0 / column.scale), column.low, column.high)
            }
            OfSegment::Is(kind) => f32::from(u8::from(kind == segment.kind)),
            OfSegment::Place(_) | OfSegment::Direction(_) => 0.0,
        });
        self.groups.iter().map(move |group| {
            let mut numbers = F32x8::default();
            for (lane, part) in group.parts.iter().enumerate() {
                let constant = if lane < group.num_columns { constants.next() } else { None };
                numbers.0[lane] = match *part {
                    Part::Component(PLACE, axis) => axis.own_and_other([segment.x, segment.y]).0,
                    Part::Component(_, axis) => axis.own_and_other([segment.cos, segment.sin]).0,
                    Part::Constant => constant.unwrap_or(0.0),
                };
            }
            numbers
        })
    }

    pub(super) fn size(&self) -> usize {
        self.num_rows * self.chosen.len()
    }

    /// Fills [N, F] and the mask [N] (or nothing, where there is no mask).
    pub(super) fn write(&self, segments: &MapSegments, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        if out.is_empty() {
            return;
        }
        let nearest = segments.nearest(Point2::new(frame.x, frame.y));
        let nearest = &nearest[..nearest.len().min(self.num_rows)];
        let width = self.chosen.len();
        let (rows, absent) = out.split_at_mut(nearest.len() * width);
        let origin = F32x8([frame.x, frame.y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        fill_rows(&self.groups, frame, &origin, &self.numbers, nearest, width, rows);
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..nearest.len()].fill(1.0);
            mask[nearest.len()..].fill(0.0);
        }
    }
}
