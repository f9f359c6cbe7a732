//! Map layers between Rust and Python: one shape of dictionary both ways.

use crate::enter::Text;
use ccdiff_bridge::errors::py;
use ccdiff_sim::geom::{Point2, Polygon};
use ccdiff_sim::scene::{Lane, LaneKind, Map, RoadParts, link_lanes, road_area};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

type Points<'py> = Bound<'py, PyArray2<f32>>;

fn points<'py>(py: Python<'py>, points: &[Point2]) -> PyResult<Points<'py>> {
    let flat = points.iter().flat_map(|p| [p.x, p.y]).collect();
    PyArray1::from_vec(py, flat).reshape([points.len(), 2])
}

fn polygon<'py>(py: Python<'py>, polygon: &Polygon) -> PyResult<Bound<'py, PyDict>> {
    let holes = polygon.holes.iter().map(|h| points(py, h)).collect::<PyResult<Vec<_>>>()?;
    let dict = PyDict::new(py);
    dict.set_item("exterior", points(py, &polygon.exterior)?)?;
    dict.set_item("holes", holes)?;
    Ok(dict)
}

fn lane<'py>(py: Python<'py>, lane: &Lane) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("id", &lane.id)?;
    dict.set_item("kind", lane_kind_name(lane.kind))?;
    dict.set_item("centreline", points(py, &lane.centreline)?)?;
    dict.set_item("polygon", polygon(py, &lane.polygon)?)?;
    dict.set_item("successors", &lane.successors)?;
    dict.set_item("predecessors", &lane.predecessors)?;
    dict.set_item("speed_limit_mps", lane.speed_limit_mps)?;
    Ok(dict)
}

fn lane_kind_name(kind: LaneKind) -> &'static str {
    match kind {
        LaneKind::Lane => "lane",
        LaneKind::Connector => "connector",
    }
}

/// All layers as arrays.
pub(crate) fn to_dict<'py>(py: Python<'py>, map: &Map) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, layer) in [
        ("drivable_area", &map.drivable_area),
        ("ped_crossings", &map.ped_crossings),
        ("walkways", &map.walkways),
        ("stop_lines", &map.stop_lines),
        ("carpark_areas", &map.carpark_areas),
    ] {
        dict.set_item(name, layer.iter().map(|p| polygon(py, p)).collect::<PyResult<Vec<_>>>()?)?;
    }
    for (name, layer) in [("road_dividers", &map.road_dividers), ("lane_dividers", &map.lane_dividers)] {
        dict.set_item(name, layer.iter().map(|l| points(py, l)).collect::<PyResult<Vec<_>>>()?)?;
    }
    dict.set_item("lanes", map.lanes.iter().map(|l| lane(py, l)).collect::<PyResult<Vec<_>>>()?)?;
    Ok(dict)
}

fn read_points(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<Point2>> {
    let array: PyReadonlyArray2<'_, f32> = value
        .extract()
        .map_err(|_| py::ShapeError::new_err(format!("{what}: expected a float32 array of shape [P, 2]")))?;
    if array.shape()[1] != 2 {
        let message = format!("{what} has shape {:?}, expected [P, 2]", array.shape());
        return Err(py::ShapeError::new_err(message));
    }
    Ok(array.as_array().rows().into_iter().map(|row| Point2::new(row[0], row[1])).collect())
}

fn item<'py>(dict: &Bound<'py, PyDict>, key: &str, what: &str) -> PyResult<Bound<'py, PyAny>> {
    dict.get_item(key)?.ok_or_else(|| py::DatasetError::new_err(format!("{what}: no entry {key:?}")))
}

fn read_polygon(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Polygon> {
    let dict = value.cast::<PyDict>()?;
    let mut holes = Vec::new();
    if let Some(list) = dict.get_item("holes")? {
        for hole in list.try_iter()? {
            holes.push(read_points(&hole?, what)?);
        }
    }
    Ok(Polygon { exterior: read_points(&item(dict, "exterior", what)?, what)?, holes })
}

fn read_lane(value: &Bound<'_, PyAny>) -> PyResult<Lane> {
    let dict = value.cast::<PyDict>()?;
    let Text(id) = item(dict, "id", "lane")?.extract()?;
    let what = format!("lane {id:?}");
    let Text(kind_name) = item(dict, "kind", &what)?.extract()?;
    let kind = [LaneKind::Lane, LaneKind::Connector].into_iter().find(|k| lane_kind_name(*k) == kind_name);
    let kind = kind.ok_or_else(|| {
        let message = format!("{what}: kind is {kind_name:?}, expected \"lane\" or \"connector\"");
        py::DatasetError::new_err(message)
    })?;
    let optional = |key| dict.get_item(key).map(|v| v.filter(|v| !v.is_none()));
    Ok(Lane {
        kind,
        centreline: read_points(&item(dict, "centreline", &what)?, &what)?,
        polygon: optional("polygon")?.map(|p| read_polygon(&p, &what)).transpose()?.unwrap_or_default(),
        successors: optional("successors")?.map(|s| s.extract()).transpose()?.unwrap_or_default(),
        predecessors: optional("predecessors")?.map(|s| s.extract()).transpose()?.unwrap_or_default(),
        speed_limit_mps: optional("speed_limit_mps")?.map(|s| s.extract()).transpose()?,
        id,
    })
}

/// The map of a dictionary as [`to_dict`] gives it; layers that are left out are empty, unknown ones refused.
pub(crate) fn from_dict(layers: &Bound<'_, PyDict>) -> PyResult<Map> {
    let mut map = Map::default();
    for (name, value) in layers {
        let Text(name) = name.extract()?;
        let polygons = match name.as_str() {
            "drivable_area" => &mut map.drivable_area,
            "ped_crossings" => &mut map.ped_crossings,
            "walkways" => &mut map.walkways,
            "stop_lines" => &mut map.stop_lines,
            "carpark_areas" => &mut map.carpark_areas,
            "road_dividers" | "lane_dividers" => {
                let lines = read_list(&value, |line| read_points(line, &name))?;
                match name.as_str() {
                    "road_dividers" => map.road_dividers = lines,
                    _ => map.lane_dividers = lines,
                }
                continue;
            }
            "lanes" => {
                map.lanes = read_list(&value, read_lane)?;
                continue;
            }
            _ => return Err(py::UnknownNameError::new_err(format!("unknown map layer {name:?}"))),
        };
        *polygons = read_list(&value, |p| read_polygon(p, &name))?;
    }
    Ok(map)
}

/// Fills in what a map lacks: links between lanes that have none, and the area where vehicles may drive, from `edges` with
/// the road on their left and from lanes and `surfaces`. `seeds` [N, 2] are places where vehicles were.
///
/// Returns the layers and how the area was had: "given", "edges", "lanes" or "none".
#[pyfunction]
#[pyo3(signature = (layers, *, edges, surfaces, seeds))]
pub(crate) fn complete_map<'py>(
    py: Python<'py>,
    layers: &Bound<'py, PyDict>,
    edges: &Bound<'py, PyList>,
    surfaces: &Bound<'py, PyList>,
    seeds: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyDict>, &'static str)> {
    let mut map = from_dict(layers)?;
    let edges = read_list(edges, |line| read_points(line, "edges"))?;
    let surfaces = read_list(surfaces, |p| read_polygon(p, "surfaces"))?;
    let seeds = read_points(seeds, "seeds")?;
    let road = py.detach(|| {
        link_lanes(&mut map.lanes);
        if !map.drivable_area.is_empty() {
            return "given";
        }
        let parts = RoadParts { edges: &edges, lanes: &map.lanes, surfaces: &surfaces, seeds: &seeds };
        map.drivable_area = road_area(parts);
        match (map.drivable_area.is_empty(), edges.is_empty()) {
            (true, _) => "none",
            (false, true) => "lanes",
            (false, false) => "edges",
        }
    });
    Ok((to_dict(py, &map)?, road))
}

fn read_list<T>(
    value: &Bound<'_, PyAny>,
    read: impl Fn(&Bound<'_, PyAny>) -> PyResult<T>,
) -> PyResult<Vec<T>> {
    value.cast::<PyList>()?.iter().map(|item| read(&item)).collect()
}
