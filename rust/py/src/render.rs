//! Bindings of `ccdiff_render`: images from arrays.

use crate::enter::flags;
use ccdiff_bridge::Handed;
use ccdiff_bridge::errors::py::{ConfigError, SceneError, ShapeError};
use ccdiff_render::{
    AgentBox, Camera, DrawStyle, Drawing, Line, MapLayers, RenderError, Rgb, Theme, look, palette, render,
    render_svg,
};
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::scene::{AgentKind, Light, Map};
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyString;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The Python exception for a renderer's error.
fn from_render(error: RenderError) -> PyErr {
    let message = error.to_string();
    match error {
        RenderError::Map { .. } => SceneError::new_err(message),
        RenderError::Value { .. } => ConfigError::new_err(message),
    }
}

/// How many maps stay prepared.
const MAPS_KEPT: usize = 8;

/// Prepared layers of the maps drawn last, the newest at the end. `Weak` keeps a map's address from being taken
/// by another one while it is listed, without keeping the map.
static PREPARED: Mutex<Vec<(Weak<Map>, Arc<MapLayers>)>> = Mutex::new(Vec::new());

/// The layers of a map, prepared at the first call.
fn layers_of(map: &Arc<Map>) -> PyResult<Arc<MapLayers>> {
    let lock = || PREPARED.lock().unwrap_or_else(PoisonError::into_inner);
    let known = lock().iter().find(|(key, _)| std::ptr::eq(key.as_ptr(), Arc::as_ptr(map))).cloned();
    if let Some((_, layers)) = known {
        return Ok(layers);
    }
    let layers = Arc::new(MapLayers::new(map).map_err(from_render)?);
    let mut list = lock();
    list.retain(|(key, _)| key.strong_count() > 0);
    if list.len() >= MAPS_KEPT {
        list.remove(0);
    }
    list.push((Arc::downgrade(map), layers.clone()));
    Ok(layers)
}

/// Width and height as the camera counts them.
fn pixels((width, height): (i64, i64)) -> PyResult<(u32, u32)> {
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(w), Ok(h)) => Ok((w, h)),
        _ => {
            Err(ConfigError::new_err(format!("image size is {width} x {height} pixels, expected 1 or more")))
        }
    }
}

/// The theme of a name.
fn theme_of(name: &str) -> PyResult<Theme> {
    Theme::ALL.into_iter().find(|t| t.name() == name).ok_or_else(|| {
        ConfigError::new_err(format!(
            "theme is {name:?}, expected one of {}",
            Theme::ALL.map(Theme::name).join(", ")
        ))
    })
}

type Points<'py> = PyReadonlyArray2<'py, f32>;

/// Rows of an array [N, 2].
fn points(what: &str, array: &Points<'_>) -> PyResult<Vec<Point2>> {
    if array.shape()[1] != 2 {
        return Err(ShapeError::new_err(format!("{what} has shape {:?}, expected [N, 2]", array.shape())));
    }
    Ok(array.as_array().rows().into_iter().map(|row| Point2::new(row[0], row[1])).collect())
}

fn driver(number: u8) -> PyResult<DrawStyle> {
    let last = DrawStyle::ALL.len() - 1;
    DrawStyle::from_number(number)
        .ok_or_else(|| ConfigError::new_err(format!("driver is {number}, expected 0 to {last}")))
}

/// Agents from arrays of one length A.
fn boxes(
    position_m: &Points<'_>,
    heading_rad: &PyReadonlyArray1<'_, f32>,
    size_m: &Points<'_>,
    kind: &PyReadonlyArray1<'_, u8>,
    driver_of: &PyReadonlyArray1<'_, u8>,
    collided: &PyReadonlyArray1<'_, bool>,
    parked: &PyReadonlyArray1<'_, bool>,
    arrived: &PyReadonlyArray1<'_, bool>,
) -> PyResult<Vec<AgentBox>> {
    let (positions, sizes) = (points("position_m", position_m)?, points("size_m", size_m)?);
    let num_agents = positions.len();
    for (what, len) in [
        ("heading_rad", heading_rad.len()),
        ("size_m", sizes.len()),
        ("kind", kind.len()),
        ("driver", driver_of.len()),
        ("collided", collided.len()),
        ("parked", parked.len()),
        ("arrived", arrived.len()),
    ] {
        if len != num_agents {
            let message = format!("{what} has {len} entries, expected {num_agents}, one per position");
            return Err(ShapeError::new_err(message));
        }
    }
    let (heading_rad, kind) = (heading_rad.as_array(), kind.as_array());
    let driver_of = driver_of.as_array();
    let (collided, parked, arrived) = (flags(collided)?, flags(parked)?, flags(arrived)?);
    (0..num_agents)
        .map(|a| {
            let shape = AgentKind::ALL.get(usize::from(kind[a])).copied();
            Ok(AgentBox {
                pose: Pose2::new(positions[a].x, positions[a].y, heading_rad[a]),
                length_m: sizes[a].x,
                width_m: sizes[a].y,
                kind: shape.ok_or_else(|| {
                    ConfigError::new_err(format!("kind of agent {a} is {}, expected 0 to 4", kind[a]))
                })?,
                driver: driver(driver_of[a])?,
                collided: collided[a],
                parked: parked[a],
                arrived: arrived[a],
            })
        })
        .collect()
}

/// An image [H, W, 3], or the text of an SVG, of agents and lines given as arrays; see `ccdiff_env.envs.image`.
#[pyfunction]
#[pyo3(signature = (position_m, heading_rad, size_m, kind, driver, collided, parked, arrived, *, scene, step_idx, size, span_m, centre_m, up_rad,
    route_m, trails=Vec::new(), samples=Vec::new(), plans=Vec::new(), collisions_m, names, caption, scale_bar,
    legend, theme, svg=false))]
pub(crate) fn render_arrays<'py>(
    py: Python<'py>,
    position_m: Points<'py>,
    heading_rad: PyReadonlyArray1<'py, f32>,
    size_m: Points<'py>,
    kind: PyReadonlyArray1<'py, u8>,
    driver: PyReadonlyArray1<'py, u8>,
    collided: PyReadonlyArray1<'py, bool>,
    parked: PyReadonlyArray1<'py, bool>,
    arrived: PyReadonlyArray1<'py, bool>,
    scene: Option<Handed>,
    step_idx: usize,
    size: (i64, i64),
    span_m: f32,
    centre_m: (f32, f32),
    up_rad: f32,
    route_m: Points<'py>,
    trails: Vec<(Points<'py>, u8)>,
    samples: Vec<(Points<'py>, u8)>,
    plans: Vec<(Points<'py>, u8)>,
    collisions_m: Points<'py>,
    names: Vec<String>,
    caption: &str,
    scale_bar: bool,
    legend: Vec<((u8, u8, u8), String)>,
    theme: &str,
    svg: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let boxes = boxes(&position_m, &heading_rad, &size_m, &kind, &driver, &collided, &parked, &arrived)?;
    let owned = |what, list: Vec<(Points<'py>, u8)>| -> PyResult<Vec<(Vec<Point2>, DrawStyle)>> {
        list.iter().map(|(p, d)| Ok((points(what, p)?, self::driver(*d)?))).collect()
    };
    let (trails, samples, plans) =
        (owned("trail", trails)?, owned("sample", samples)?, owned("plan", plans)?);
    let legend: Vec<(Rgb, String)> =
        legend.into_iter().map(|((r, g, b), title)| (Rgb(r, g, b), title)).collect();
    let theme = theme_of(theme)?;
    let (route, collisions) = (points("route_m", &route_m)?, points("collisions_m", &collisions_m)?);
    let (width, height) = pixels(size)?;
    let centre = Point2::new(centre_m.0, centre_m.1);
    let camera = Camera::over(centre, span_m, width, height).heading_up(up_rad);
    let layers = scene.as_ref().map(|s| layers_of(&s.0.map)).transpose()?;
    let shown = |light: &Light| (light.stop_line, light.state(step_idx));
    let lights: Vec<_> = scene.iter().flat_map(|s| &s.0.map.lights).map(shown).collect();
    let image = py.detach(|| {
        let (trails, samples, plans) = (lines(&trails), lines(&samples), lines(&plans));
        let drawing = Drawing {
            map: layers.as_deref(),
            lights: &lights,
            route: &route,
            trails: &trails,
            samples: &samples,
            plans: &plans,
            boxes: &boxes,
            names: &names,
            collisions: &collisions,
            caption,
            scale_bar,
            legend: &legend,
            theme,
        };
        if svg { render_svg(&drawing, &camera).map(Err) } else { render(&drawing, &camera).map(Ok) }
    });
    match image.map_err(from_render)? {
        Ok(rgb) => Ok(PyArray1::from_vec(py, rgb).reshape([height as usize, width as usize, 3])?.into_any()),
        Err(text) => Ok(PyString::new(py, &text).into_any()),
    }
}

fn lines(list: &[(Vec<Point2>, DrawStyle)]) -> Vec<Line<'_>> {
    list.iter().map(|(points, driver)| Line { points, driver: *driver }).collect()
}

/// Times, lengths and strengths that images and the replay page share, by name.
#[pyfunction]
pub(crate) fn render_look() -> Vec<(&'static str, f32)> {
    look::LOOK.to_vec()
}

/// Name and colour (red, green, blue).
type LegendRow = (&'static str, (u8, u8, u8));

/// Names and colours (red, green, blue) of everything in an image, drivers first.
#[pyfunction]
pub(crate) fn render_legend(theme: &str) -> PyResult<Vec<LegendRow>> {
    Ok(palette::legend(theme_of(theme)?).into_iter().map(|(name, c)| (name, (c.0, c.1, c.2))).collect())
}
