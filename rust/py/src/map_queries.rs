//! Bindings of what the maps of scenes say of places: arrays in, arrays out.

use crate::enter::enter;
use crate::scene::PyScene;
use ccdiff_bridge::errors::py::{ConfigError, SceneError, UnknownNameError};
use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::stage::PreparedScene;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use std::sync::Arc;

/// Nothing is farther from the origin of a scene along an axis, metres.
const FARTHEST_M: f32 = 1e6;

/// Places on the maps of scenes.
struct Places {
    scenes: Vec<Arc<PreparedScene>>,
    /// Scene of each place.
    world: Vec<usize>,
    poses: Vec<Pose2>,
    /// Elevation of each place, metres; empty where the level does not matter.
    elevation_m: Vec<f32>,
}

/// Scenes, the number of the scene of each place [M], positions [M, 2], headings [M] and elevations [M] or [0], whose shapes
/// the caller has checked.
type AskedPlaces<'py> = (
    Vec<PyRef<'py, PyScene>>,
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray2<'py, f32>,
    PyReadonlyArray1<'py, f32>,
    PyReadonlyArray1<'py, f32>,
);

impl Places {
    /// The poses [M], each in its scene.
    fn new(
        py: Python<'_>,
        (scenes, world, position, heading, elevation): &AskedPlaces<'_>,
    ) -> PyResult<Self> {
        let known = |w: &i64| usize::try_from(*w).ok().filter(|w| *w < scenes.len());
        let numbers = world.as_array().into_iter().map(|w| {
            let message = || format!("world {w}, expected 0 to {}", scenes.len().saturating_sub(1));
            known(w).ok_or_else(|| UnknownNameError::new_err(message()))
        });
        let (position, heading, elevation) = (position.as_array(), heading.as_array(), elevation.as_array());
        let poses = position.rows().into_iter().zip(heading).enumerate().map(|(i, (at, heading))| {
            let numbers = [at[0], at[1], *heading, elevation.get(i).copied().unwrap_or(0.0)];
            match numbers.iter().all(|v| v.abs() < FARTHEST_M) {
                true => Ok(Pose2::new(at[0], at[1], *heading)),
                false => Err(ConfigError::new_err(format!(
                    "place {i} is at {numbers:?} (x, y, heading, elevation), expected finite numbers below 1e6"
                ))),
            }
        });
        let (world, poses) = (numbers.collect::<PyResult<_>>()?, poses.collect::<PyResult<_>>()?);
        let scenes: Vec<&PyScene> = scenes.iter().map(|scene| &**scene).collect();
        let scenes = enter(py, || Ok(scenes.into_iter().map(PyScene::prepared).collect()))?;
        Ok(Self { scenes, world, poses, elevation_m: elevation.to_vec() })
    }

    fn each(&self) -> impl Iterator<Item = (&PreparedScene, &Pose2, Option<f32>)> {
        let at =
            |(i, w): (usize, &usize)| (&*self.scenes[*w], &self.poses[i], self.elevation_m.get(i).copied());
        self.world.iter().enumerate().map(at)
    }
}

/// Distances [M] to the edge of the road, negative off it.
#[pyfunction]
pub(crate) fn map_road_distance<'py>(
    py: Python<'py>,
    places: AskedPlaces<'py>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let places = Places::new(py, &places)?;
    let distances = enter(py, || {
        let of = |(scene, pose, z): (&PreparedScene, &Pose2, Option<f32>)| {
            let message = || {
                let name = &scene.scene.name;
                format!("scene {name:?}: no road: its map has neither a drivable area nor surfaces of lanes")
            };
            scene.road_distance_m(pose.position, z).ok_or_else(|| SceneError::new_err(message()))
        };
        places.each().map(of).collect::<PyResult<Vec<f32>>>()
    })?;
    Ok(PyArray1::from_vec(py, distances))
}

/// Ways [M, P, 2] and whether they go so far [M, P]; index of the lane (-1: none), offset from it, and the heading's
/// difference from it [M].
type Ways<'py> = (
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyArray2<bool>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<f32>>,
);

/// The ways along lanes ahead of poses, in their frames.
#[pyfunction]
pub(crate) fn map_lane_ahead<'py>(
    py: Python<'py>,
    places: AskedPlaces<'py>,
    num_points: usize,
    spacing_m: f32,
    reach_m: f32,
) -> PyResult<Ways<'py>> {
    let places = Places::new(py, &places)?;
    let (m, length_m) = (places.poses.len(), spacing_m * num_points as f32);
    let (mut points, mut valid) = (vec![0.0; m * num_points * 2], vec![false; m * num_points]);
    let (mut lane, mut lateral_m, mut heading_error_rad) = (vec![-1; m], vec![0.0; m], vec![0.0; m]);
    enter(py, || {
        for (row, (scene, pose, z)) in places.each().enumerate() {
            let Some(ahead) = scene.lane_ahead(pose, z, reach_m, length_m) else { continue };
            lane[row] = i64::from(ahead.lane.lane_idx);
            (lateral_m[row], heading_error_rad[row]) = (ahead.lane.lateral_m, ahead.lane.heading_error_rad());
            for (k, i) in (row * num_points..).zip(0..num_points) {
                if let Some(at) = ahead.at(i as f32 * spacing_m) {
                    let Point2 { coords: at } = pose.to_local(at);
                    points[2 * k..2 * k + 2].copy_from_slice(at.as_slice());
                    valid[k] = true;
                }
            }
        }
        Ok(())
    })?;
    Ok((
        PyArray1::from_vec(py, points).reshape([m, num_points, 2])?,
        PyArray1::from_vec(py, valid).reshape([m, num_points])?,
        PyArray1::from_vec(py, lane),
        PyArray1::from_vec(py, lateral_m),
        PyArray1::from_vec(py, heading_error_rad),
    ))
}
