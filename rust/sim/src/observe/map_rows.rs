//! Rows of map segments.

use super::columns::MAP;
use super::frame::{F32x8, Frame, Group, KINDS, LANES, fill_segments};
use super::map_segments::MapSegments;
use super::source::OfSegment;
use crate::geom::{Point2, Real};

/// Chosen columns that are written at once.
#[derive(Debug, Clone)]
struct Columns {
    /// Those that depend on the place.
    of_places: Group,
    /// For each kind of segment the columns of kinds, zeros elsewhere.
    of_kinds: [F32x8; KINDS],
}

/// Writes the nearest map segments.
#[derive(Debug, Clone)]
pub(super) struct MapRows {
    num_rows: usize,
    width: usize,
    groups: Vec<Columns>,
}

impl MapRows {
    pub(super) fn new(chosen: &[usize], num_rows: usize) -> Self {
        Self { num_rows, width: chosen.len(), groups: chosen.chunks(LANES).map(Columns::new).collect() }
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
        let origin = F32x8([frame.x, frame.y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        for (pass, columns) in self.groups.chunks(2).enumerate().rev() {
            let first = pass * 2 * LANES;
            let (width, room, places) = (self.width, self.width - first, segments.places());
            let Some(rows) = rows.get_mut(first..) else { break };
            match columns {
                [a, b] if b.of_places.moves() => {
                    let (groups, added) = ([&a.of_places, &b.of_places], [&a.of_kinds, &b.of_kinds]);
                    fill_segments::<2, 2>(
                        &groups, frame, &origin, &added, places, nearest, width, room, rows,
                    );
                }
                [a, b] => {
                    let (groups, added) = ([&a.of_places, &b.of_places], [&a.of_kinds, &b.of_kinds]);
                    fill_segments::<2, 1>(
                        &groups, frame, &origin, &added, places, nearest, width, room, rows,
                    );
                }
                [a] => fill_segments::<1, 1>(
                    &[&a.of_places],
                    frame,
                    &origin,
                    &[&a.of_kinds],
                    places,
                    nearest,
                    width,
                    room,
                    rows,
                ),
                _ => {}
            }
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..nearest.len()].fill(1.0);
            mask[nearest.len()..].fill(0.0);
        }
    }
}

impl Columns {
    fn new(chosen: &[usize]) -> Self {
        let mut columns = Self { of_places: Group::new(), of_kinds: [F32x8::default(); KINDS] };
        for (lane, entry) in chosen.iter().map(|c| &MAP[*c]).enumerate() {
            let (places, column) = (&mut columns.of_places, &entry.column);
            match entry.source {
                OfSegment::Place(axis) => places.set_vector(lane, MapSegments::PLACE, axis, column),
                OfSegment::Direction(axis) => places.set_vector(lane, MapSegments::DIRECTION, axis, column),
                OfSegment::HalfLength => places.set_number(lane, MapSegments::HALF_LENGTH, column),
                OfSegment::Is(kind) => columns.of_kinds[kind as usize].0[lane] = 1.0,
            }
        }
        columns
    }
}
