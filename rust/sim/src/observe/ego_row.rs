//! The numbers about the observing agent itself.

use super::column::clip;
use super::columns::{EGO, Entry};
use super::source::{Ego, OfEgo};
use super::view::View;
use crate::geom::Real;

/// Writes the numbers about the observing agent.
#[derive(Debug, Clone)]
pub(super) struct EgoRow {
    /// Entries and factors.
    chosen: Vec<(&'static Entry<OfEgo>, Real)>,
}

impl EgoRow {
    pub(super) fn new(chosen: &[usize]) -> Self {
        Self { chosen: chosen.iter().map(|c| (&EGO[*c], 1.0 / EGO[*c].column.scale)).collect() }
    }

    /// Floats of the row.
    pub(super) fn size(&self) -> usize {
        self.chosen.len()
    }

    pub(super) fn write(&self, view: &View<'_>, out: &mut [Real]) {
        let ego = Ego::new(view);
        for (to, (entry, factor)) in out.iter_mut().zip(&self.chosen) {
            *to = clip((entry.source)(&ego) * factor, entry.column.low, entry.column.high);
        }
    }
}
