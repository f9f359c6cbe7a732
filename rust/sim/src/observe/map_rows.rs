//! Rows of map pieces.

use super::frame::{Frame, clip};
use super::layout::{Layout, MAP};
use super::map_pieces::{MapPieces, Piece, PieceKind};
use crate::geom::{Point2, Real};

/// Columns that depend on the place of a piece; all others depend on its kind alone.
const NUM_PLACE: usize = 5;
const FACTOR: [Real; 4] = [1.0 / MAP[0].scale, 1.0 / MAP[1].scale, 1.0 / MAP[2].scale, 1.0 / MAP[3].scale];
const HALF_LENGTH_FACTOR: Real = 1.0 / MAP[4].scale;

/// Writes the nearest map pieces.
#[derive(Debug, Clone)]
pub(super) struct MapRows {
    chosen: Vec<usize>,
    num_rows: usize,
    /// A row of each kind of piece [kinds, width], with zeros for the place: of the chosen columns where rows are
    /// filled whole, of all columns otherwise.
    templates: Vec<Real>,
    /// The columns begin with the place, and there is a loop made for their number.
    fills_whole: bool,
}

impl MapRows {
    pub(super) fn new(layout: &Layout) -> Self {
        let chosen = layout.chosen[2].clone();
        let fills_whole = matches!(chosen.len(), 7 | 13)
            && chosen.starts_with(&[0, 1, 2, 3, 4])
            && chosen[NUM_PLACE..].iter().all(|column| *column >= NUM_PLACE);
        let all: Vec<usize> = (0..MAP.len()).collect();
        let columns = if fills_whole { &chosen } else { &all };
        let templates = (0..PieceKind::COUNT)
            .flat_map(|kind| columns.iter().map(move |c| if *c == kind + NUM_PLACE { 1.0 } else { 0.0 }))
            .collect();
        Self { num_rows: layout.config.num_map_pieces, chosen, templates, fills_whole }
    }

    /// Floats of all rows.
    pub(super) fn size(&self) -> usize {
        self.num_rows * self.chosen.len()
    }

    /// Fills [N, F] and the mask [N] (or nothing, where there is no mask).
    pub(super) fn write(&self, pieces: &MapPieces, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        let width = self.chosen.len();
        if out.is_empty() {
            return;
        }
        let nearest = pieces.nearest(Point2::new(frame.x, frame.y));
        let nearest = &nearest[..nearest.len().min(self.num_rows)];
        let (rows, absent) = out.split_at_mut(nearest.len() * width);
        let all = pieces.pieces();
        match width {
            7 if self.fills_whole => self.fill::<7>(all, nearest, frame, rows),
            13 if self.fills_whole => self.fill::<13>(all, nearest, frame, rows),
            _ => self.pick(all, nearest, frame, rows),
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..nearest.len()].fill(1.0);
            mask[nearest.len()..].fill(0.0);
        }
    }

    /// Rows that begin with the place.
    fn fill<const W: usize>(&self, all: &[Piece], nearest: &[u32], frame: &Frame, rows: &mut [Real]) {
        let (templates, _) = self.templates.as_chunks::<W>();
        for (row, k) in rows.as_chunks_mut::<W>().0.iter_mut().zip(nearest) {
            let piece = &all[*k as usize];
            *row = templates[piece.kind as usize];
            row[..NUM_PLACE].copy_from_slice(&place(piece, frame));
        }
    }

    /// Rows of any columns.
    fn pick(&self, all: &[Piece], nearest: &[u32], frame: &Frame, rows: &mut [Real]) {
        let (templates, _) = self.templates.as_chunks::<{ MAP.len() }>();
        for (row, k) in rows.chunks_exact_mut(self.chosen.len()).zip(nearest) {
            let piece = &all[*k as usize];
            let mut full = templates[piece.kind as usize];
            full[..NUM_PLACE].copy_from_slice(&place(piece, frame));
            for (to, column) in row.iter_mut().zip(&self.chosen) {
                *to = full[*column];
            }
        }
    }
}

#[inline(always)]
fn place(piece: &Piece, frame: &Frame) -> [Real; NUM_PLACE] {
    let [x, y, cos, sin] = frame.turn([piece.x - frame.x, piece.y - frame.y, piece.cos, piece.sin], FACTOR);
    [x, y, cos, sin, clip(piece.half_length_m * HALF_LENGTH_FACTOR, 0.0, 1.0)]
}
