//! Bindings of `ccdiff_sim::metrics`.

use crate::enter::flags;
use ccdiff_bridge::errors::{from_sim, py::ShapeError, py::UnknownNameError};
use ccdiff_sim::SimError;
use ccdiff_sim::geom::{Point2, Polygon, Region};
use ccdiff_sim::metrics::{
    ComfortAxes, ComfortHistograms, HISTOGRAM_BINS, Trajectories, contacts, min_ttc_s, off_road_flags,
    over_speed,
};
use ccdiff_sim::scene::{Elevations, Map};
use ccdiff_sim::state::Footprint;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Roads are made for elevations this far apart, metres.
const SLOT_M: f32 = 0.5;

/// Adds the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<NativeMotion>()
}

type PyF32<'py> = PyReadonlyArray2<'py, f32>;
type Rings = (Vec<[f32; 2]>, Vec<Vec<[f32; 2]>>);

/// One recorded scene: checked copies of its arrays [A, T].
#[pyclass(frozen, module = "ccdiff_env._native", name = "Trajectories")]
pub(crate) struct NativeMotion {
    dt_s: f32,
    num_steps: usize,
    x_m: Vec<f32>,
    y_m: Vec<f32>,
    heading_rad: Vec<f32>,
    valid: Vec<bool>,
    footprints: Vec<Footprint>,
    elevation_m: Vec<f32>,
}

impl NativeMotion {
    fn view(&self) -> Result<Trajectories<'_>, SimError> {
        Trajectories::new(self.dt_s, &self.x_m, &self.y_m, &self.heading_rad, &self.valid, &self.footprints)?
            .with_elevations(&self.elevation_m)
    }
}

/// Contacts [N, 3] of step and agents, and the name of the first kind per agent.
type Contacts<'py> = (Bound<'py, PyArray2<u32>>, Vec<Option<&'static str>>);

/// Flags [A, T] of centre and box.
type OffRoadFlags<'py> = (Bound<'py, PyArray2<bool>>, Bound<'py, PyArray2<bool>>);

#[pymethods]
impl NativeMotion {
    #[new]
    #[pyo3(signature = (dt_s, x, y, heading, valid, size, elevation_m=None))]
    fn new(
        dt_s: f32,
        x: PyF32<'_>,
        y: PyF32<'_>,
        heading: PyF32<'_>,
        valid: PyReadonlyArray2<'_, bool>,
        size: PyF32<'_>,
        elevation_m: Option<PyF32<'_>>,
    ) -> PyResult<Self> {
        let footprints = match size.shape() {
            [_, 2] => size.as_slice()?.chunks_exact(2).map(|s| Footprint::new(s[0], s[1])).collect(),
            got => return Err(ShapeError::new_err(format!("size has shape {got:?}, expected [A, 2]"))),
        };
        let motion = Self {
            dt_s,
            num_steps: x.shape()[1],
            x_m: x.as_slice()?.to_vec(),
            y_m: y.as_slice()?.to_vec(),
            heading_rad: heading.as_slice()?.to_vec(),
            valid: flags(&valid)?,
            footprints,
            elevation_m: match &elevation_m {
                Some(array) => array.as_slice()?.to_vec(),
                None => Vec::new(),
            },
        };
        motion.view().map_err(from_sim)?;
        Ok(motion)
    }

    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Contacts<'py>> {
        let (rows, kinds) = py.detach(|| Ok(contacts(&self.view()?))).map_err(from_sim)?;
        let shape = [rows.len(), 3];
        let rows = PyArray1::from_vec(py, rows.into_iter().flatten().collect()).reshape(shape)?;
        Ok((rows, kinds.iter().map(|kind| kind.map(|k| k.name())).collect()))
    }

    fn off_road<'py>(
        &self,
        py: Python<'py>,
        drivable: Vec<Rings>,
        elevations: Vec<[f32; 2]>,
    ) -> PyResult<OffRoadFlags<'py>> {
        let points = |ring: Vec<[f32; 2]>| ring.into_iter().map(Point2::from).collect();
        let polygons: Vec<Polygon> = drivable
            .into_iter()
            .map(|(exterior, holes)| Polygon {
                exterior: points(exterior),
                holes: holes.into_iter().map(points).collect(),
            })
            .collect();
        let region = Region::new(&polygons)
            .ok_or_else(|| ShapeError::new_err("drivable has no polygon of three or more finite points"))?;
        let motion = self.view().map_err(from_sim)?;
        let known = elevations.len() == polygons.len() && !self.elevation_m.is_empty();
        let map = Map {
            drivable_area: polygons,
            elevation_m: Elevations { drivable_area: elevations, ..Elevations::default() },
            ..Map::default()
        };
        let slot = |z: f32| (z / SLOT_M).floor() as i64;
        let slots = self.elevation_m.iter().zip(&self.valid).filter(|(_, valid)| **valid && known);
        let slots: BTreeSet<i64> = slots.map(|(z, _)| slot(*z)).collect();
        let of_slot = |k: i64| Region::new(&map.on_level((k as f32 + 0.5) * SLOT_M).drivable_area);
        let levels: BTreeMap<i64, Option<Region>> = slots.into_iter().map(|k| (k, of_slot(k))).collect();
        let region_of = |elevation_m: Option<f32>| match elevation_m.filter(|_| known) {
            Some(z) => levels.get(&slot(z)).and_then(Option::as_ref),
            None => Some(&region),
        };
        let flags = off_road_flags(&motion, region_of);
        let shape = [self.footprints.len(), self.num_steps];
        let centroid = flags.iter().map(|f| f.centroid).collect();
        let corner = flags.iter().map(|f| f.corner).collect();
        Ok((PyArray1::from_vec(py, centroid).reshape(shape)?, PyArray1::from_vec(py, corner).reshape(shape)?))
    }

    /// Histograms [3, 20] of one scene.
    fn comfort<'py>(
        &self,
        py: Python<'py>,
        axes: &str,
        stride: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let axes = match axes {
            "body" => ComfortAxes::Body,
            "reference_impl" => ComfortAxes::ReferenceImpl,
            _ => {
                let text = format!("unknown comfort axes {axes:?}, expected \"body\" or \"reference_impl\"");
                return Err(UnknownNameError::new_err(text));
            }
        };
        let motion = self.view().map_err(from_sim)?;
        let found = ComfortHistograms::from_motion(&motion, axes, stride).map_err(from_sim)?;
        PyArray1::from_vec(py, found.rows.as_flattened().to_vec()).reshape([3, HISTOGRAM_BINS])
    }

    fn min_ttc(&self, py: Python<'_>) -> PyResult<Vec<f32>> {
        py.detach(|| Ok(min_ttc_s(&self.view()?))).map_err(from_sim)
    }

    fn over_speed(
        &self,
        limit_mps: f32,
        at_least_s: f32,
        counted: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<Vec<bool>> {
        Ok(over_speed(&self.view().map_err(from_sim)?, limit_mps, at_least_s, &flags(&counted)?))
    }
}
