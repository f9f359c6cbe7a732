//! Map layers between Rust and Python: one shape of dictionary both ways.

use crate::enter::{Text, array, doubles, fields, part};
use ccdiff_bridge::errors::py;
use ccdiff_sim::geom::{Point2, Polygon};
use ccdiff_sim::scene::{
    Elevations, Lane, LaneKind, Light, LightState, Map, PartElevations, RoadParts, cut_by_level,
    level_bounds, link_lanes, range_of, road_area, road_areas,
};
use ndarray::{Ix1, Ix2};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

/// The origin of a frame that stays.
pub(crate) const HERE: [f64; 2] = [0.0; 2];

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
    if !lane.elevation_m.is_empty() {
        dict.set_item("elevation_m", PyArray1::from_slice(py, &lane.elevation_m))?;
    }
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
    if !map.lights.is_empty() {
        let lights = map.lights.iter().map(|light| {
            let dict = PyDict::new(py);
            dict.set_item("lane", light.lane)?;
            dict.set_item("stop_line", points(py, &light.stop_line)?)?;
            let states = light.states.iter().map(|state| *state as u8).collect();
            dict.set_item("states", PyArray1::from_vec(py, states))?;
            Ok(dict)
        });
        dict.set_item("lights", lights.collect::<PyResult<Vec<_>>>()?)?;
    }
    let heights = PyDict::new(py);
    for (name, ranges) in map.elevation_m.layers().into_iter().filter(|(_, ranges)| !ranges.is_empty()) {
        let array = PyArray1::from_slice(py, ranges.as_flattened()).reshape([ranges.len(), 2])?;
        heights.set_item(name, array)?;
    }
    if !heights.is_empty() {
        dict.set_item("elevation_m", heights)?;
    }
    Ok(dict)
}

/// An array of heights, one a point.
fn read_heights(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<f32>> {
    let heights = array::<f32, Ix1>(value, &format!("elevation_m of {what}"), "float32 array of shape [P]")?;
    Ok(heights.as_array().to_vec())
}

/// Least and greatest heights of the parts of layers, by their names.
fn read_elevations(value: &Bound<'_, PyAny>) -> PyResult<Elevations> {
    let mut elevations = Elevations::default();
    let known = elevations.layers().map(|(name, _)| name);
    let given = fields(value, "elevation_m", &known)?;
    for (name, ranges) in elevations.layers_mut() {
        if let Some(value) = given.get_item(name)? {
            *ranges = read_points(&value, &format!("elevation_m of {name:?}"), HERE)?
                .iter()
                .map(|p| if p.x > p.y { [p.y, p.x] } else { [p.x, p.y] })
                .collect();
        }
    }
    Ok(elevations)
}

/// Points of single or double precision, relative to an origin.
fn read_points(value: &Bound<'_, PyAny>, what: &str, origin: [f64; 2]) -> PyResult<Vec<Point2>> {
    let (array, _) = doubles::<Ix2>(value, what, "[P, 2]")?;
    if array.shape()[1] != 2 {
        let message = format!("{what} has shape {:?}, expected [P, 2]", array.shape());
        return Err(py::ShapeError::new_err(message));
    }
    let near = |p: ndarray::ArrayView1<'_, f64>| [0, 1].map(|i| (p[i] - origin[i]) as f32).into();
    Ok(array.rows().into_iter().map(near).collect())
}

fn item<'py>(dict: &Bound<'py, PyDict>, key: &str, what: &str) -> PyResult<Bound<'py, PyAny>> {
    dict.get_item(key)?.ok_or_else(|| py::DatasetError::new_err(format!("{what}: no entry {key:?}")))
}

fn read_polygon(value: &Bound<'_, PyAny>, what: &str, origin: [f64; 2]) -> PyResult<Polygon> {
    let dict = fields(value, what, &["exterior", "holes"])?;
    let holes = dict.get_item("holes")?.map(|list| {
        let what = format!("holes of {what}");
        read_list(&list, &what, |hole| read_points(hole, &what, origin))
    });
    let exterior = read_points(&item(&dict, "exterior", what)?, &format!("exterior of {what}"), origin)?;
    Ok(Polygon { exterior, holes: holes.transpose()?.unwrap_or_default() })
}

/// What the dictionary of a lane can have.
const LANE_FIELDS: [&str; 8] =
    ["id", "kind", "centreline", "polygon", "successors", "predecessors", "speed_limit_mps", "elevation_m"];

fn read_lane(value: &Bound<'_, PyAny>, origin: [f64; 2]) -> PyResult<Lane> {
    let dict = fields(value, "lane", &LANE_FIELDS)?;
    let Text(id) = part(&item(&dict, "id", "lane")?, "id of a lane", "a text")?;
    let what = format!("lane {id:?}");
    let of = |key: &str| format!("{key} of {what}");
    let Text(kind_name) = part(&item(&dict, "kind", &what)?, &of("kind"), "a text")?;
    let kind = [LaneKind::Lane, LaneKind::Connector].into_iter().find(|k| lane_kind_name(*k) == kind_name);
    let kind = kind.ok_or_else(|| {
        let message = format!("{what}: kind is {kind_name:?}, expected \"lane\" or \"connector\"");
        py::DatasetError::new_err(message)
    })?;
    let optional = |key| dict.get_item(key).map(|v| v.filter(|v| !v.is_none()));
    let linked = |key| -> PyResult<Vec<u32>> {
        let lanes = optional(key)?.map(|lanes| part(&lanes, &of(key), "a list of indices of lanes"));
        Ok(lanes.transpose()?.unwrap_or_default())
    };
    Ok(Lane {
        kind,
        centreline: read_points(&item(&dict, "centreline", &what)?, &of("centreline"), origin)?,
        polygon: optional("polygon")?
            .map(|p| read_polygon(&p, &of("polygon"), origin))
            .transpose()?
            .unwrap_or_default(),
        successors: linked("successors")?,
        predecessors: linked("predecessors")?,
        speed_limit_mps: optional("speed_limit_mps")?
            .map(|limit| part(&limit, &of("speed_limit_mps"), "a number or None"))
            .transpose()?,
        elevation_m: optional("elevation_m")?
            .map(|z| read_heights(&z, &what))
            .transpose()?
            .unwrap_or_default(),
        id,
    })
}

/// The map of a dictionary as [`to_dict`] gives it, relative to an origin; layers that are left out are empty, unknown ones
/// refused.
pub(crate) fn from_dict(layers: &Bound<'_, PyAny>, origin: [f64; 2]) -> PyResult<Map> {
    let mut map = Map::default();
    let others = ["lanes", "lights", "elevation_m"];
    let known = map.elevation_m.layers().map(|(name, _)| name);
    let layers = fields(layers, "map_layers", &[&known[..], &others].concat())?;
    for (name, polygons) in [
        ("drivable_area", &mut map.drivable_area),
        ("ped_crossings", &mut map.ped_crossings),
        ("walkways", &mut map.walkways),
        ("stop_lines", &mut map.stop_lines),
        ("carpark_areas", &mut map.carpark_areas),
    ] {
        if let Some(value) = layers.get_item(name)? {
            *polygons = read_list(&value, name, |p| read_polygon(p, name, origin))?;
        }
    }
    for (name, lines) in
        [("road_dividers", &mut map.road_dividers), ("lane_dividers", &mut map.lane_dividers)]
    {
        if let Some(value) = layers.get_item(name)? {
            *lines = read_list(&value, name, |line| read_points(line, name, origin))?;
        }
    }
    if let Some(value) = layers.get_item("elevation_m")? {
        map.elevation_m = read_elevations(&value)?;
    }
    if let Some(value) = layers.get_item("lanes")? {
        map.lanes = read_list(&value, "lanes", |lane| read_lane(lane, origin))?;
    }
    if let Some(lights) = layers.get_item("lights")? {
        map.lights = read_lights(&lights, &map, origin)?;
    }
    Ok(map)
}

/// The lights of a map's lanes.
pub(crate) fn read_lights(lights: &Bound<'_, PyAny>, map: &Map, origin: [f64; 2]) -> PyResult<Vec<Light>> {
    read_list(lights, "lights", |light| read_light(light, map, origin))
}

/// A light; where it has no stop line, that lies where the lane begins.
fn read_light(value: &Bound<'_, PyAny>, map: &Map, origin: [f64; 2]) -> PyResult<Light> {
    let dict = fields(value, "light", &["lane", "stop_line", "states"])?;
    let fault = |message: String| py::DatasetError::new_err(format!("light: {message}"));
    let lane: u32 = part(&item(&dict, "lane", "light")?, "lane of a light", "the index of a lane")?;
    let Some(start) = map.lanes.get(lane as usize).and_then(|lane| lane.centreline.get(..2)) else {
        return Err(fault(format!("lane is {lane}, expected the index of a lane with a centre line")));
    };
    let codes = item(&dict, "states", "light")?;
    let codes = array::<u8, Ix1>(&codes, "states of a light", "uint8 array of shape [T]")?;
    let state = |code: &u8| LightState::ALL.get(usize::from(*code)).copied();
    let codes = codes.as_array();
    let states = codes.iter().map(|code| {
        state(code)
            .ok_or_else(|| fault(format!("a state is {code}, expected 0 to {}", LightState::ALL.len() - 1)))
    });
    let stop_line = match dict.get_item("stop_line")?.filter(|line| !line.is_none()) {
        Some(line) => match read_points(&line, "stop_line of a light", origin)?[..] {
            [at] => map.stop_line(lane as usize, at),
            [from, to] => [from, to],
            _ => {
                return Err(py::ShapeError::new_err("stop_line of a light: expected shape [2, 2] or [1, 2]"));
            }
        },
        None => map.stop_line(lane as usize, start[0]),
    };
    Ok(Light { lane, stop_line, states: states.collect::<PyResult<_>>()? })
}

/// Fills in what a map lacks: links between lanes that have none, and the area where vehicles may drive, from `edges` with
/// the road on their left and from lanes and `surfaces`. `seeds` [N, 2] are places where vehicles were.
///
/// Where `tracks`, places [N, 3] of all agents, or `heights` of the points of lanes, edges and the other layers show roads
/// that pass over each other, each level's road is made on its own; otherwise elevations are left out.
///
/// Returns the layers, how the area was had: "given", "edges", "lanes" or "none", and the elevations between levels.
#[pyfunction]
#[pyo3(signature = (layers, *, edges, surfaces, seeds, tracks=None, heights=None))]
pub(crate) fn complete_map<'py>(
    py: Python<'py>,
    layers: &Bound<'py, PyDict>,
    edges: &Bound<'py, PyList>,
    surfaces: &Bound<'py, PyList>,
    seeds: &Bound<'py, PyAny>,
    tracks: Option<PyReadonlyArray2<'py, f32>>,
    heights: Option<&Bound<'py, PyDict>>,
) -> PyResult<(Bound<'py, PyDict>, &'static str, Vec<f32>)> {
    let mut map = from_dict(layers, HERE)?;
    let edges = read_list(edges, "edges", |line| read_points(line, "edges", HERE))?;
    let surfaces = read_list(surfaces, "surfaces", |p| read_polygon(p, "surfaces", HERE))?;
    let seeds = read_points(seeds, "seeds", HERE)?;
    let rings = |polygons: &[Polygon]| polygons.iter().map(|p| p.exterior.len()).collect::<Vec<_>>();
    let points = |lines: &[Vec<Point2>]| lines.iter().map(Vec::len).collect::<Vec<_>>();
    let heights = heights.map(|heights| {
        let of = |name: &str, lengths: Vec<usize>| {
            let found = read_list(&item(heights, name, "heights")?, name, |z| read_heights(z, name))?;
            if found.iter().map(Vec::len).ne(lengths) {
                return Err(py::ShapeError::new_err(format!("heights of {name}: expected one a point")));
            }
            Ok(found)
        };
        Ok::<_, PyErr>(Heights {
            edges: of("edges", points(&edges))?,
            surfaces: of("surfaces", rings(&surfaces))?,
            seeds: of("seeds", vec![seeds.len()])?.concat(),
            dividers: [
                of("road_dividers", points(&map.road_dividers))?,
                of("lane_dividers", points(&map.lane_dividers))?,
            ],
            areas: [of("ped_crossings", rings(&map.ped_crossings))?, of("walkways", rings(&map.walkways))?],
        })
    });
    let heights = heights.transpose()?;
    let tracks: Vec<_> = match &tracks {
        Some(tracks) if tracks.shape()[1] != 3 => {
            let message = format!("tracks has shape {:?}, expected [N, 3]", tracks.shape());
            return Err(py::ShapeError::new_err(message));
        }
        Some(tracks) => {
            tracks.as_array().rows().into_iter().map(|row| (Point2::new(row[0], row[1]), row[2])).collect()
        }
        None => Vec::new(),
    };
    let (road, bounds) = py.detach(|| {
        link_lanes(&mut map.lanes);
        let lines = map.lanes.iter().map(|lane| (lane.centreline.as_slice(), lane.elevation_m.as_slice()));
        let of_edges = heights.iter().flat_map(|h| edges.iter().zip(&h.edges));
        let lines = lines.chain(of_edges.map(|(line, heights)| (line.as_slice(), heights.as_slice())));
        let bounds = level_bounds(lines, tracks.into_iter());
        let parts = RoadParts { edges: &edges, lanes: &map.lanes, surfaces: &surfaces, seeds: &seeds };
        let is_given = !map.drivable_area.is_empty();
        let area = match heights.as_ref().filter(|_| !bounds.is_empty()) {
            Some(heights) => heights.area(parts, &bounds),
            None => (if is_given { Vec::new() } else { road_area(parts) }, Vec::new()),
        };
        match heights.filter(|_| !bounds.is_empty()) {
            Some(heights) => heights.tell(&mut map, &bounds),
            None => map.lanes.iter_mut().for_each(|lane| lane.elevation_m.clear()),
        }
        if is_given {
            return ("given", bounds);
        }
        (map.drivable_area, map.elevation_m.drivable_area) = area;
        let road = match (map.drivable_area.is_empty(), edges.is_empty()) {
            (true, _) => "none",
            (false, true) => "lanes",
            (false, false) => "edges",
        };
        (road, bounds)
    });
    Ok((to_dict(py, &map)?, road, bounds))
}

/// Heights of the points of what a map is made from, metres.
struct Heights {
    edges: Vec<Vec<f32>>,
    surfaces: Vec<Vec<f32>>,
    seeds: Vec<f32>,
    /// Of dividers of roads and of lanes.
    dividers: [Vec<Vec<f32>>; 2],
    /// Of crossings and of walkways.
    areas: [Vec<Vec<f32>>; 2],
}

impl Heights {
    fn area(&self, parts: RoadParts<'_>, bounds: &[f32]) -> (Vec<Polygon>, Vec<[f32; 2]>) {
        let surfaces: Vec<_> = self.surfaces.iter().map(range_of).collect();
        let heights = PartElevations { edges: &self.edges, surfaces: &surfaces, seeds: &self.seeds };
        road_areas(parts, heights, bounds)
    }

    /// Cuts lines where the level changes, and says how high the parts of layers lie.
    fn tell(&self, map: &mut Map, bounds: &[f32]) {
        let ranges = &mut map.elevation_m;
        let layers = [
            (&mut map.road_dividers, &mut ranges.road_dividers),
            (&mut map.lane_dividers, &mut ranges.lane_dividers),
        ];
        for ((lines, ranges), heights) in layers.into_iter().zip(&self.dividers) {
            let pieces = lines.iter().zip(heights).flat_map(|(line, z)| cut_by_level(line, z, bounds));
            (*lines, *ranges) = pieces.unzip();
        }
        let layers = [&mut ranges.ped_crossings, &mut ranges.walkways];
        for (ranges, heights) in layers.into_iter().zip(&self.areas) {
            *ranges = heights.iter().map(range_of).collect();
        }
    }
}

fn read_list<T>(
    value: &Bound<'_, PyAny>,
    what: &str,
    read: impl Fn(&Bound<'_, PyAny>) -> PyResult<T>,
) -> PyResult<Vec<T>> {
    part::<Vec<Bound<'_, PyAny>>>(value, what, "a list")?.iter().map(read).collect()
}
