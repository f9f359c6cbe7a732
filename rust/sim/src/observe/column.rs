//! A column of a row: what one number means.

use crate::geom::Real;
use serde::Serialize;

/// One number of a row: what it is, and value = clip(quantity / scale, low, high).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObservationColumn {
    /// Name.
    pub name: &'static str,
    /// Unit of the quantity.
    pub unit: &'static str,
    /// Divisor.
    pub scale: Real,
    /// Least value.
    pub low: Real,
    /// Greatest value.
    pub high: Real,
    /// What it is.
    pub doc: &'static str,
    /// Whether rows have it without being asked for it by name.
    #[serde(skip)]
    pub in_default: bool,
}

/// A value within bounds; the lower bound for NaN. Two instructions.
#[inline(always)]
pub(super) fn clip(value: Real, low: Real, high: Real) -> Real {
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}

/// Component of a vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    X,
    Y,
}

impl Axis {
    /// This component of a vector, and the other one.
    #[inline(always)]
    pub(super) fn own_and_other<T>(self, [x, y]: [T; 2]) -> (T, T) {
        match self {
            Self::X => (x, y),
            Self::Y => (y, x),
        }
    }
}
