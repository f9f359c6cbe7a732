//! Bindings of `ccdiff_sim::metrics`.

use crate::enter::flags;
use ccdiff_bridge::errors::{from_sim, py::ShapeError, py::UnknownNameError};
use ccdiff_sim::geom::{Point2, Polygon};
use ccdiff_sim::metrics::{ComfortAxes, HISTOGRAM_BINS, Trajectories};
use ccdiff_sim::scene::{Elevations, Map};
use ccdiff_sim::state::Footprint;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

type PyF32<'py> = PyReadonlyArray2<'py, f32>;
type Rings = (Vec<[f32; 2]>, Vec<Vec<[f32; 2]>>);

/// One recorded scene.
#[pyclass(frozen, module = "ccdiff_env._native", name = "Trajectories")]
pub(crate) struct NativeMotion {
    /// Agents A and steps T.
    shape: [usize; 2],
    motion: Trajectories,
}

/// Contacts [N, 3] of step and agents, and the name of the first kind per agent.
type Contacts<'py> = (Bound<'py, PyArray2<u32>>, Bound<'py, PyArray2<f32>>, Vec<Option<&'static str>>);

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
        let columns = [x.as_slice()?, y.as_slice()?, heading.as_slice()?];
        let elevation_m = elevation_m.as_ref().map_or(Ok(&[][..]), |a| a.as_slice())?;
        let motion = Trajectories::new(dt_s, columns, elevation_m, &flags(&valid)?, footprints);
        Ok(Self { shape: [x.shape()[0], x.shape()[1]], motion: motion.map_err(from_sim)? })
    }

    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Contacts<'py>> {
        let (rows, kinds) = py.detach(|| self.motion.contacts());
        let (rows, approach_mps): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
        let (shape, both) = ([rows.len(), 3], [rows.len(), 2]);
        let rows = PyArray1::from_vec(py, rows.into_iter().flatten().collect()).reshape(shape)?;
        let approach_mps = PyArray1::from_vec(py, approach_mps.into_iter().flatten().collect());
        let kinds = kinds.iter().map(|kind| kind.map(|k| k.name())).collect();
        Ok((rows, approach_mps.reshape(both)?, kinds))
    }

    fn off_road<'py>(
        &self,
        py: Python<'py>,
        drivable: Vec<Rings>,
        elevations: Vec<[f32; 2]>,
    ) -> PyResult<OffRoadFlags<'py>> {
        let points = |ring: Vec<[f32; 2]>| ring.into_iter().map(Point2::from).collect();
        let polygon = |(exterior, holes): Rings| Polygon {
            exterior: points(exterior),
            holes: holes.into_iter().map(points).collect(),
        };
        let map = Map {
            drivable_area: drivable.into_iter().map(polygon).collect(),
            elevation_m: Elevations { drivable_area: elevations, ..Elevations::default() },
            ..Map::default()
        };
        let flags = py
            .detach(|| self.motion.off_road(&map))
            .ok_or_else(|| ShapeError::new_err("drivable has no polygon of three or more finite points"))?;
        let centroid = flags.iter().map(|f| f.centroid).collect();
        let corner = flags.iter().map(|f| f.corner).collect();
        let array = |flags: Vec<bool>| PyArray1::from_vec(py, flags).reshape(self.shape);
        Ok((array(centroid)?, array(corner)?))
    }

    /// Histograms [3, 20] of one scene.
    fn comfort<'py>(
        &self,
        py: Python<'py>,
        axes: &str,
        end_bins: bool,
        stride: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let axes = ComfortAxes::ALL.into_iter().find(|known| known.name() == axes).ok_or_else(|| {
            let text = format!("unknown comfort axes {axes:?}, expected \"body\" or \"reference_impl\"");
            UnknownNameError::new_err(text)
        })?;
        let rows = self.motion.comfort(axes, end_bins, stride).map_err(from_sim)?;
        PyArray1::from_vec(py, rows.as_flattened().to_vec()).reshape([3, HISTOGRAM_BINS])
    }

    /// Accelerations, harsh ones, and harsh jerks of every agent, [A, 3].
    fn harsh_motion<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let counts = py.detach(|| self.motion.harsh_motion());
        PyArray1::from_vec(py, counts.as_flattened().to_vec()).reshape([counts.len(), 3])
    }

    fn min_ttc(&self, py: Python<'_>) -> Vec<f32> {
        py.detach(|| self.motion.min_ttc_s())
    }

    fn over_speed(&self, limit_mps: f32, at_least_s: f32) -> Vec<bool> {
        self.motion.over_speed(limit_mps, at_least_s)
    }
}
