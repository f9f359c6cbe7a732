//! States and facts of a running world as arrays.

use ccdiff_sim::events::Contact;
use ccdiff_sim::geom::Point2;
use ccdiff_sim::world::WorldStatus;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Route [P, 2] and goal [2], `None` for an empty slot.
pub(crate) type Route<'py> = Option<(Bound<'py, PyArray2<f32>>, (f32, f32))>;
/// (agent, partner, side of the agent that is hit, closing speed m/s, at fault).
pub(crate) type ContactRow = (u32, u32, &'static str, f32, bool);

/// Present states; entries of agents that are not active are zero.
pub(crate) fn states<'py>(py: Python<'py>, status: &WorldStatus<'_>) -> PyResult<Bound<'py, PyDict>> {
    let s = status.states;
    let shown = |values: &[f32]| -> Vec<f32> {
        values.iter().zip(&s.active).map(|(v, active)| if *active { *v } else { 0.0 }).collect()
    };
    let pairs = |x: &[f32], y: &[f32]| {
        let flat = shown(x).into_iter().zip(shown(y)).flat_map(|(x, y)| [x, y]).collect();
        PyArray1::from_vec(py, flat).reshape([s.len(), 2])
    };
    let dict = PyDict::new(py);
    dict.set_item("position", pairs(&s.x, &s.y)?)?;
    dict.set_item("heading", PyArray1::from_vec(py, shown(&s.heading_rad)))?;
    dict.set_item("velocity", pairs(&s.velocity_x_mps, &s.velocity_y_mps)?)?;
    dict.set_item("speed", PyArray1::from_vec(py, shown(&s.speed_mps)))?;
    dict.set_item("acceleration", PyArray1::from_vec(py, shown(&s.acceleration_mps2)))?;
    dict.set_item("yaw_rate", PyArray1::from_vec(py, shown(&s.yaw_rate_radps)))?;
    dict.set_item("active", PyArray1::from_slice(py, &s.active))?;
    if !s.heights.is_empty() {
        let elevation_m: Vec<f32> = s.heights.iter().map(|height| height.elevation_m).collect();
        dict.set_item("elevation_m", PyArray1::from_vec(py, shown(&elevation_m)))?;
    }
    Ok(dict)
}

/// A route as arrays.
pub(crate) fn route(py: Python<'_>, route: Option<(Vec<Point2>, Point2)>) -> PyResult<Route<'_>> {
    let Some((points, goal)) = route else { return Ok(None) };
    let flat = points.iter().flat_map(|p| [p.x, p.y]).collect();
    Ok(Some((PyArray1::from_vec(py, flat).reshape([points.len(), 2])?, (goal.x, goal.y))))
}

/// Contacts, each pair from both sides.
pub(crate) fn contacts(pairs: &[(Contact, Contact)]) -> Vec<ContactRow> {
    let row = |agent: u32, c: &Contact| (agent, c.partner, c.kind.name(), c.closing_speed_mps, c.at_fault);
    pairs.iter().flat_map(|(of_i, of_j)| [row(of_j.partner, of_i), row(of_i.partner, of_j)]).collect()
}
