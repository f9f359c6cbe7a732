//! Rows of map pieces.

use super::frame::{Eight, Frame, Lanes, Unturned, put_rows};
use super::layout::{Layout, MAP};
use super::map_pieces::{MapPieces, PieceKind};
use crate::geom::{Point2, Real};
use crate::wide::wide;

/// Columns that depend on the place of a piece; all others depend on its kind alone.
const NUM_PLACE: usize = 5;
const FACTOR: [Real; 8] = [
    1.0 / MAP[0].scale,
    1.0 / MAP[1].scale,
    1.0 / MAP[2].scale,
    1.0 / MAP[3].scale,
    1.0 / MAP[4].scale,
    0.0,
    0.0,
    0.0,
];

/// For each kind of piece the columns that depend on it, with zeros for the place: the first eight, then the others.
type Templates = [[Eight; PieceKind::COUNT]; 2];

/// Writes the nearest map pieces.
#[derive(Debug, Clone)]
pub(super) struct MapRows {
    chosen: Vec<usize>,
    num_rows: usize,
    /// Of the chosen columns where rows are filled whole, of all columns otherwise.
    templates: Templates,
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
        let mut templates = Templates::default();
        for kind in 0..PieceKind::COUNT {
            for (i, column) in columns.iter().enumerate() {
                let of_kind = *column == kind + NUM_PLACE;
                templates[i / 8][kind].0[i % 8] = if of_kind { 1.0 } else { 0.0 };
            }
        }
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
        let lanes = frame.lanes(FACTOR);
        match width {
            7 if self.fills_whole => fill_7(pieces, nearest, &lanes, &self.templates, rows),
            13 if self.fills_whole => fill_13(pieces, nearest, &lanes, &self.templates, rows),
            _ => self.pick(pieces, nearest, &lanes, rows),
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..nearest.len()].fill(1.0);
            mask[nearest.len()..].fill(0.0);
        }
    }

    /// Rows of any columns.
    fn pick(&self, pieces: &MapPieces, nearest: &[u32], lanes: &Lanes, rows: &mut [Real]) {
        for (row, k) in rows.chunks_exact_mut(self.chosen.len()).zip(nearest) {
            let (piece, kind) = pieces.row(*k);
            let first = lanes.turn((piece, &self.templates[0][kind]));
            let mut full = [0.0; 16];
            full[..8].copy_from_slice(&first);
            full[8..].copy_from_slice(&self.templates[1][kind].0);
            for (to, column) in row.iter_mut().zip(&self.chosen) {
                *to = full[*column];
            }
        }
    }
}

wide! {
    fn fill_7(pieces: &MapPieces, nearest: &[u32], lanes: &Lanes, templates: &Templates, rows: &mut [Real])
    with turn [Fn(&Lanes, (&Unturned, &Eight)) -> [Real; 8]] = Lanes::turn, Lanes::turn_avx2 {
        put_rows::<_, 7, 8, 29>(rows, nearest, |k| {
            let (piece, kind) = pieces.row(k);
            turn(lanes, (piece, &templates[0][kind]))
        });
    }

    fn fill_13(pieces: &MapPieces, nearest: &[u32], lanes: &Lanes, templates: &Templates, rows: &mut [Real])
    with turn [Fn(&Lanes, (&Unturned, &Eight)) -> [Real; 8]] = Lanes::turn, Lanes::turn_avx2 {
        put_rows::<_, 13, 16, 55>(rows, nearest, |k| {
            let (piece, kind) = pieces.row(k);
            let mut row = [0.0; 16];
            row[..8].copy_from_slice(&turn(lanes, (piece, &templates[0][kind])));
            row[8..].copy_from_slice(&templates[1][kind].0);
            row
        });
    }
}
