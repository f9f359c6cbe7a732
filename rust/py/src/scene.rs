//! `Scene`, and the functions that load scenes.

use crate::enter::{Text, array, doubles, flags};
use crate::scene_map;
use ccdiff_bridge::errors::{from_sim, py};
use ccdiff_nuscenes::{
    BuildOptions, LoadOptions, Loaded, NuscenesError, Selection, decode_scene, encode_scene, load, scene_hash,
};
use ccdiff_sim::geom::{Point2, Vector2};
use ccdiff_sim::options;
use ccdiff_sim::scene::{Agent, AgentKind, Scene, Tracks};
use ccdiff_sim::stage::{PreparedScene, hitches};
use ccdiff_sim::world::{VehicleRanking, ranked_vehicles};
use ndarray::{Ix2, Ix3};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyCapsule, PyDict};
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

/// The Python exception for a loader error.
fn from_nuscenes(error: NuscenesError) -> PyErr {
    let message = error.to_string();
    match error {
        NuscenesError::Scene(error) => from_sim(error),
        NuscenesError::Missing { .. } => py::DatasetNotFoundError::new_err(message),
        NuscenesError::Option { .. } => py::ConfigError::new_err(message),
        NuscenesError::Unknown(_) => py::UnknownNameError::new_err(message),
        NuscenesError::Io { .. }
        | NuscenesError::Json { .. }
        | NuscenesError::Data { .. }
        | NuscenesError::Bytes(_) => py::DatasetError::new_err(message),
    }
}

/// A scene: logged tracks of all agents on a map. Immutable.
#[pyclass(frozen, name = "Scene", module = "ccdiff_env._native")]
pub(crate) struct PyScene {
    /// Shared with the worlds that run it.
    pub(crate) scene: Arc<Scene>,
    hash: OnceLock<String>,
    prepared: OnceLock<Arc<PreparedScene>>,
}

impl PyScene {
    /// What is derived from the scene, made at the first call.
    pub(crate) fn prepared(&self) -> Arc<PreparedScene> {
        Arc::clone(self.prepared.get_or_init(|| Arc::new(PreparedScene::new(Arc::clone(&self.scene), None))))
    }
}

impl From<Arc<Scene>> for PyScene {
    fn from(scene: Arc<Scene>) -> Self {
        Self { scene, hash: OnceLock::new(), prepared: OnceLock::new() }
    }
}

/// The kind of a name.
fn kind(name: &str) -> PyResult<AgentKind> {
    AgentKind::ALL.into_iter().find(|k| k.name() == name).ok_or_else(|| {
        let known = AgentKind::ALL.map(AgentKind::name).join(", ");
        py::UnknownNameError::new_err(format!("unknown agent type {name:?}, expected one of {known}"))
    })
}

/// Places farther from the origin than this get a nearer one, metres: single precision has 0.5 mm there.
const FAR_M: f64 = 5000.0;

/// Positions in single precision that are rounded more coarsely than this, metres, are refused.
const ROUNDING_M: f32 = 0.1;

/// The whole metres to a frame in which the first valid place is near, in f64 [A, T, 2]; zero where it is.
fn shift_of(position: &ndarray::Array3<f64>, valid: &[bool]) -> [f64; 2] {
    let first = position.rows().into_iter().zip(valid).find_map(|(p, ok)| ok.then(|| [p[0], p[1]]));
    let first = first.filter(|p| p.iter().all(|x| x.is_finite()) && p.iter().any(|x| x.abs() > FAR_M));
    first.map_or([0.0; 2], |p| p.map(f64::round))
}

fn expect_shape(what: &str, got: &[usize], expected: &[usize]) -> PyResult<()> {
    if got == expected {
        return Ok(());
    }
    Err(py::ShapeError::new_err(format!("{what} has shape {got:?}, expected {expected:?}")))
}

#[pymethods]
impl PyScene {
    /// Builds a scene from arrays in the scene frame, far ones in one that is near; `mend` as the loaders mend theirs.
    ///
    /// Of A agents (ids, types `vehicle`, `pedestrian`, `cyclist`, `motorcycle` or `static`, the ego first) over T
    /// steps: `sizes` [A, 3] length, width, height in metres, the others as `tracks()` and `map_layers()` return them.
    #[staticmethod]
    #[pyo3(signature = (name, *, agent_ids, agent_types, sizes, position, heading, velocity, valid, dt=0.1,
        agent_categories=None, token=Text::default(), location=Text::default(), source=Text::default(),
        origin=(0.0, 0.0), map_layers=None, elevation_m=None, mend=true),
        text_signature = "(name, *, agent_ids, agent_types, sizes, position, heading, velocity, valid, dt=0.1, \
            agent_categories=None, token=\"\", location=\"\", source=\"\", origin=(0.0, 0.0), map_layers=None, \
            elevation_m=None, mend=True)")]
    fn from_arrays(
        py: Python<'_>,
        name: Text,
        agent_ids: Vec<Text>,
        agent_types: Vec<Text>,
        sizes: &Bound<'_, PyAny>,
        position: &Bound<'_, PyAny>,
        heading: &Bound<'_, PyAny>,
        velocity: &Bound<'_, PyAny>,
        valid: &Bound<'_, PyAny>,
        dt: f32,
        agent_categories: Option<Vec<Text>>,
        token: Text,
        location: Text,
        source: Text,
        origin: (f64, f64),
        map_layers: Option<&Bound<'_, PyAny>>,
        elevation_m: Option<&Bound<'_, PyAny>>,
        mend: bool,
    ) -> PyResult<Self> {
        let sizes = array::<f32, Ix2>(sizes, "sizes", "float32 array of shape [A, 3]")?;
        let heading = array::<f32, Ix2>(heading, "heading", "float32 array of shape [A, T]")?;
        let velocity = array::<f32, Ix3>(velocity, "velocity", "float32 array of shape [A, T, 2]")?;
        let valid = array::<bool, Ix2>(valid, "valid", "bool array of shape [A, T]")?;
        let elevation_m = elevation_m
            .map(|z| array::<f32, Ix2>(z, "elevation_m", "float32 array of shape [A, T]"))
            .transpose()?;
        let (num_agents, num_steps) = (valid.shape()[0], valid.shape()[1]);
        let texts = |list: Vec<Text>| list.into_iter().map(|text| text.0).collect::<Vec<_>>();
        let (agent_ids, agent_types) = (texts(agent_ids), texts(agent_types));
        let categories = agent_categories.map_or_else(|| agent_types.clone(), texts);
        for (what, list) in
            [("agent_ids", &agent_ids), ("agent_types", &agent_types), ("agent_categories", &categories)]
        {
            expect_shape(what, &[list.len()], &[num_agents])?;
        }
        expect_shape("sizes", sizes.shape(), &[num_agents, 3])?;
        let (position, is_single) = doubles::<Ix3>(position, "position", "[A, T, 2]")?;
        expect_shape("position", position.shape(), &[num_agents, num_steps, 2])?;
        expect_shape("heading", heading.shape(), &[num_agents, num_steps])?;
        expect_shape("velocity", velocity.shape(), &[num_agents, num_steps, 2])?;
        if let Some(elevation_m) = &elevation_m {
            expect_shape("elevation_m", elevation_m.shape(), &[num_agents, num_steps])?;
        }
        let sizes = sizes.as_array();
        let mut agents = Vec::with_capacity(num_agents);
        for (i, ((id, kind_name), category)) in
            agent_ids.into_iter().zip(&agent_types).zip(categories).enumerate()
        {
            let [length_m, width_m, height_m] = [sizes[[i, 0]], sizes[[i, 1]], sizes[[i, 2]]];
            agents.push(Agent { id, kind: kind(kind_name)?, category, length_m, width_m, height_m });
        }
        // entries that are not valid are zero, whatever the caller left there
        let shown = flags(&valid)?;
        let masked = |array: ndarray::ArrayView2<'_, f32>| -> Vec<f32> {
            array.iter().zip(&shown).map(|(v, ok)| if *ok { *v } else { 0.0 }).collect()
        };
        let axis =
            |array: &PyReadonlyArray3<'_, f32>, i| masked(array.as_array().index_axis(ndarray::Axis(2), i));
        let shift = shift_of(&position, &shown);
        if is_single && shift != [0.0; 2] {
            let far_m = shift.map(f64::abs).into_iter().fold(0.0, f64::max) as f32;
            let rounding_m = far_m.next_up() - far_m;
            let text = format!(
                "scene {:?}: positions near ({}, {}) in single precision are rounded to {rounding_m} m; give float64",
                name.0, shift[0], shift[1]
            );
            if rounding_m > ROUNDING_M || rounding_m.is_nan() {
                return Err(py::SceneError::new_err(text));
            }
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(text).unwrap_or_default(), 1)?;
        }
        let near = |(p, ok): (ndarray::ArrayView1<'_, f64>, &bool)| {
            if *ok { [0, 1].map(|i| (p[i] - shift[i]) as f32).into() } else { Point2::origin() }
        };
        let tracks = Tracks {
            position: position.rows().into_iter().zip(&shown).map(near).collect(),
            heading_rad: masked(heading.as_array()),
            velocity: axis(&velocity, 0)
                .into_iter()
                .zip(axis(&velocity, 1))
                .map(|(x, y)| Vector2::new(x, y))
                .collect(),
            elevation_m: elevation_m.map(|array| masked(array.as_array())).unwrap_or_default(),
            valid: shown.clone(),
        };
        let map =
            map_layers.map(|layers| scene_map::from_dict(layers, shift)).transpose()?.unwrap_or_default();
        let scene = Scene {
            name: name.0,
            token: token.0,
            location: location.0,
            source: source.0,
            origin: [origin.0 + shift[0], origin.1 + shift[1]],
            dt_s: dt,
            num_steps,
            agents,
            tracks,
            map: Arc::new(map),
        };
        let mut scene = scene.validated().map_err(from_sim)?;
        if mend {
            for note in scene.mend().notes {
                let text = CString::new(format!("scene {:?}: {note}", scene.name)).unwrap_or_default();
                PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
            }
        }
        Ok(Arc::new(scene).into())
    }

    /// The scene with its log mended, as other loaders do it; gaps filled, absences, and notes.
    fn _mended(&self) -> (Self, [usize; 2], Vec<String>) {
        let mut scene = Scene::clone(&self.scene);
        let mended = scene.mend();
        (Arc::new(scene).into(), [mended.filled_gaps, mended.absences], mended.notes)
    }

    /// The scene that `to_bytes` wrote.
    #[staticmethod]
    fn from_bytes(data: &[u8]) -> PyResult<Self> {
        Ok(Arc::new(decode_scene(data).map_err(from_nuscenes)?).into())
    }

    /// The scene as an argument of the module of networks.
    fn _handed<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyCapsule>> {
        ccdiff_bridge::scene_capsule(py, Arc::clone(&self.scene))
    }

    /// The whole scene as bytes; equal scenes give equal bytes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &encode_scene(&self.scene).map_err(from_nuscenes)?))
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let class = py.get_type::<Self>();
        Ok((class.getattr("from_bytes")?, (self.to_bytes(py)?,)))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.scene.name
    }

    #[getter]
    fn token(&self) -> &str {
        &self.scene.token
    }

    #[getter]
    fn location(&self) -> &str {
        &self.scene.location
    }

    #[getter]
    fn source(&self) -> &str {
        &self.scene.source
    }

    #[getter]
    fn origin(&self) -> (f64, f64) {
        (self.scene.origin[0], self.scene.origin[1])
    }

    #[getter]
    fn dt(&self) -> f64 {
        // the shortest decimal that rounds to the stored f32: 0.1, not 0.10000000149
        self.scene.dt_s.to_string().parse().unwrap_or_else(|_| f64::from(self.scene.dt_s))
    }

    #[getter]
    fn num_steps(&self) -> usize {
        self.scene.num_steps
    }

    #[getter]
    fn num_agents(&self) -> usize {
        self.scene.num_agents()
    }

    #[getter]
    fn agent_ids(&self) -> Vec<&str> {
        self.scene.agents.iter().map(|a| a.id.as_str()).collect()
    }

    #[getter]
    fn agent_types(&self) -> Vec<&'static str> {
        self.scene.agents.iter().map(|a| a.kind.name()).collect()
    }

    #[getter]
    fn agent_categories(&self) -> Vec<&str> {
        self.scene.agents.iter().map(|a| a.category.as_str()).collect()
    }

    #[getter]
    fn towed(&self) -> Vec<(usize, usize)> {
        hitches(&self.scene)
    }

    fn ranked_vehicles(&self, step: &Bound<'_, PyAny>, ranking: &str) -> PyResult<Vec<usize>> {
        let given = step.extract().ok().filter(|step| *step < self.scene.num_steps);
        let step: usize = given.ok_or_else(|| {
            let last = self.scene.num_steps - 1;
            py::ConfigError::new_err(format!("step = {step}, expected a whole number from 0 to {last}"))
        })?;
        let ranking: VehicleRanking =
            options::read("ranking", &serde_json::Value::from(ranking).to_string()).map_err(from_sim)?;
        Ok(ranked_vehicles(&self.scene, &hitches(&self.scene), step, ranking))
    }

    #[getter]
    fn has_road(&self) -> bool {
        self.scene.map.has_road()
    }

    #[getter]
    fn has_lanes(&self) -> bool {
        self.scene.map.has_lanes()
    }

    #[getter]
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let flat = self.scene.agents.iter().flat_map(|a| [a.length_m, a.width_m, a.height_m]).collect();
        PyArray1::from_vec(py, flat).reshape([self.scene.num_agents(), 3])
    }

    /// Content hash, 32 hexadecimal digits, the same on every machine.
    #[getter]
    fn hash(&self) -> PyResult<&str> {
        if let Some(hash) = self.hash.get() {
            return Ok(hash);
        }
        let hash = scene_hash(&self.scene).map_err(from_nuscenes)?;
        Ok(self.hash.get_or_init(|| hash))
    }

    /// Logged states as new arrays in the scene frame; rows that are not valid are zero.
    ///
    /// `position` [A, T, 2] m, `heading` [A, T] rad, `velocity` [A, T, 2] m/s in float32, `valid` [A, T] in bool; in
    /// scenes with levels `elevation_m` [A, T].
    fn tracks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let tracks = &self.scene.tracks;
        let shape = [self.scene.num_agents(), self.scene.num_steps];
        let pairs = [shape[0], shape[1], 2];
        let position = tracks.position.iter().flat_map(|p| [p.x, p.y]).collect();
        let velocity = tracks.velocity.iter().flat_map(|v| [v.x, v.y]).collect();
        let dict = PyDict::new(py);
        dict.set_item("position", PyArray1::from_vec(py, position).reshape(pairs)?)?;
        dict.set_item("heading", PyArray1::from_slice(py, &tracks.heading_rad).reshape(shape)?)?;
        dict.set_item("velocity", PyArray1::from_vec(py, velocity).reshape(pairs)?)?;
        dict.set_item("valid", PyArray1::from_slice(py, &tracks.valid).reshape(shape)?)?;
        if self.scene.has_levels() {
            dict.set_item("elevation_m", PyArray1::from_slice(py, &tracks.elevation_m).reshape(shape)?)?;
        }
        Ok(dict)
    }

    /// Map layers as new arrays in the scene frame: `ccdiff_env.scenes.scene_types.MapLayers` lists them.
    fn map_layers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        scene_map::to_dict(py, &self.scene.map)
    }

    /// The scene with another agent as its ego.
    fn with_ego(&self, agent_id: &str) -> PyResult<Self> {
        let found = self.scene.agent_index(agent_id).ok_or_else(|| {
            py::UnknownNameError::new_err(format!("{}: no agent {agent_id:?}", self.scene.name))
        })?;
        Ok(Arc::new(self.scene.with_ego(found)).into())
    }

    /// The scene with other traffic lights, as `map_layers()["lights"]` has them.
    fn with_lights(&self, lights: &Bound<'_, PyAny>) -> PyResult<Self> {
        let mut scene = Scene::clone(&self.scene);
        let map = Arc::make_mut(&mut scene.map);
        map.lights = scene_map::read_lights(lights, map, scene_map::HERE)?;
        Ok(Arc::new(scene.validated().map_err(from_sim)?).into())
    }

    /// The scene itself: it never changes.
    fn __copy__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    /// The scene itself: it never changes.
    fn __deepcopy__<'py>(slf: PyRef<'py, Self>, _memo: &Bound<'py, PyAny>) -> PyRef<'py, Self> {
        slf
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|o| {
            let other = &o.get().scene;
            Arc::ptr_eq(&self.scene, other) || self.scene == *other
        })
    }

    fn __hash__(&self) -> PyResult<u64> {
        // 16 of the 32 digits
        Ok(u64::from_str_radix(&self.hash()?[..16], 16).unwrap_or_default())
    }

    fn __repr__(&self) -> String {
        let s = &self.scene;
        let seconds = (s.num_steps - 1) as f32 * s.dt_s;
        format!("Scene({:?}, location={:?}, agents={}, {seconds:.1} s)", s.name, s.location, s.num_agents())
    }
}

/// A choice by its name.
fn named<T: serde::de::DeserializeOwned>(field: &str, name: &str, expected: &str) -> PyResult<T> {
    let message = |_| py::ConfigError::new_err(format!("{field} is {name:?}, expected {expected}"));
    serde_json::from_value(name.into()).map_err(message)
}

/// Loads nuScenes scenes; returns them with the report as JSON.
#[pyfunction]
#[pyo3(signature = (dataroot, version, *, names, exactly, dt, timing, interpolation, ego_reference, kinds, map_margin,
    cache_directory))]
pub(crate) fn load_nuscenes(
    py: Python<'_>,
    dataroot: PathBuf,
    version: &str,
    names: Option<Vec<String>>,
    exactly: bool,
    dt: f64,
    timing: &str,
    interpolation: &str,
    ego_reference: &str,
    kinds: Option<Vec<String>>,
    map_margin: f64,
    cache_directory: Option<PathBuf>,
) -> PyResult<(Vec<PyScene>, String)> {
    let kinds = kinds.map(|names| names.iter().map(|n| kind(n)).collect::<PyResult<Vec<_>>>()).transpose()?;
    let selection = match names {
        None => Selection::All,
        Some(names) if exactly => Selection::Exactly(names),
        Some(names) => Selection::AnyOf(names),
    };
    let build = BuildOptions {
        dt_s: dt,
        timing: named("timing", timing, "\"recorded\" or \"nominal\"")?,
        interpolation: named("interpolation", interpolation, "\"smooth\" or \"linear\"")?,
        ego_reference: named("ego_reference", ego_reference, "\"rear_axle\" or \"centre\"")?,
        kinds,
        map_margin_m: map_margin,
    };
    let options = LoadOptions { selection, build, cache_directory };
    with_report(py.detach(|| load(&dataroot, version, &options)))
}

/// Loads Waymo scenes from GPUDrive's JSON, one from each file; returns them with the report as JSON.
#[pyfunction]
#[pyo3(signature = (paths, *, cache_directory))]
pub(crate) fn load_gpudrive(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    cache_directory: Option<PathBuf>,
) -> PyResult<(Vec<PyScene>, String)> {
    with_report(py.detach(|| ccdiff_nuscenes::load_gpudrive(&paths, cache_directory.as_deref())))
}

fn with_report(loaded: ccdiff_nuscenes::Result<Loaded>) -> PyResult<(Vec<PyScene>, String)> {
    let loaded = loaded.map_err(from_nuscenes)?;
    let report =
        serde_json::to_string(&loaded.report).map_err(|e| py::DatasetError::new_err(e.to_string()))?;
    Ok((loaded.scenes.into_iter().map(PyScene::from).collect(), report))
}
