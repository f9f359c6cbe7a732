//! The map round a scene, in the scene frame.

use super::Light;
use crate::geom::{Point2, Polygon, Real};
use serde::{Deserialize, Serialize};

/// Nothing of a scene lies farther from its origin along an axis, metres.
pub(crate) const FARTHEST_M: Real = 1e6;

/// Heights at one place that are farther apart than this are levels, metres: less than any road leaves free for another one
/// below it, more than slopes and rough measurements make of one road.
pub const LEVEL_M: Real = 2.5;
/// Nothing lies higher above sea level or deeper below, metres.
pub const HIGHEST_M: Real = 9e3;

/// What a lane is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LaneKind {
    /// A marked lane.
    #[default]
    Lane,
    /// A path through an intersection, from one lane to another.
    Connector,
}

/// One lane or lane connector.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Lane {
    /// Token of the data set.
    pub id: String,
    /// Lane or connector.
    pub kind: LaneKind,
    /// Centre line in driving direction, at least two points, about one metre apart.
    pub centreline: Vec<Point2>,
    /// Surface; empty exterior where the data has none.
    pub polygon: Polygon,
    /// Indices (into [`Map::lanes`]) of the lanes that follow. Lanes outside the crop are left out.
    pub successors: Vec<u32>,
    /// Indices of the lanes that lead here.
    pub predecessors: Vec<u32>,
    /// Posted limit in metres per second, where the data has one (nuScenes has none).
    pub speed_limit_mps: Option<Real>,
    /// Elevation of each point of the centre line, metres; empty where nothing says how high it lies.
    pub elevation_m: Vec<Real>,
}

/// Least and greatest elevation of each part of a layer, metres; empty where these are not known, and then the parts belong
/// to all levels. Lanes have elevations of their own.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Elevations {
    /// Of the drivable area: the elevations of agents on it.
    pub drivable_area: Vec<[Real; 2]>,
    /// Of the lines between directions of traffic.
    pub road_dividers: Vec<[Real; 2]>,
    /// Of the lines between lanes.
    pub lane_dividers: Vec<[Real; 2]>,
    /// Of the pedestrian crossings.
    pub ped_crossings: Vec<[Real; 2]>,
    /// Of the walkways.
    pub walkways: Vec<[Real; 2]>,
    /// Of the stop lines.
    pub stop_lines: Vec<[Real; 2]>,
    /// Of the car parks.
    pub carpark_areas: Vec<[Real; 2]>,
}

impl Elevations {
    /// The layers by their names.
    pub fn layers(&self) -> [(&'static str, &Vec<[Real; 2]>); 7] {
        [
            ("drivable_area", &self.drivable_area),
            ("road_dividers", &self.road_dividers),
            ("lane_dividers", &self.lane_dividers),
            ("ped_crossings", &self.ped_crossings),
            ("walkways", &self.walkways),
            ("stop_lines", &self.stop_lines),
            ("carpark_areas", &self.carpark_areas),
        ]
    }

    /// The layers by their names, to be filled in.
    pub fn layers_mut(&mut self) -> [(&'static str, &mut Vec<[Real; 2]>); 7] {
        [
            ("drivable_area", &mut self.drivable_area),
            ("road_dividers", &mut self.road_dividers),
            ("lane_dividers", &mut self.lane_dividers),
            ("ped_crossings", &mut self.ped_crossings),
            ("walkways", &mut self.walkways),
            ("stop_lines", &mut self.stop_lines),
            ("carpark_areas", &mut self.carpark_areas),
        ]
    }
}

/// Layers of the map, cropped round the scene. Any layer can be empty: what needs lanes must say so or fall back.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Map {
    /// Where vehicles may drive. Polygons may overlap; a point is drivable if any of them holds it.
    pub drivable_area: Vec<Polygon>,
    /// Lanes and lane connectors.
    pub lanes: Vec<Lane>,
    /// Lines between directions of traffic.
    pub road_dividers: Vec<Vec<Point2>>,
    /// Lines between lanes of one direction.
    pub lane_dividers: Vec<Vec<Point2>>,
    /// Pedestrian crossings.
    pub ped_crossings: Vec<Polygon>,
    /// Walkways.
    pub walkways: Vec<Polygon>,
    /// Stop lines (areas, as nuScenes draws them).
    pub stop_lines: Vec<Polygon>,
    /// Car parks.
    pub carpark_areas: Vec<Polygon>,
    /// How high the parts of these layers lie, but for lanes, which say so themselves.
    pub elevation_m: Elevations,
    /// Traffic lights. Bytes of a scene have them behind all else, and nothing where there are none.
    #[serde(skip)]
    pub lights: Vec<Light>,
}

impl Map {
    /// Name of the first layer that holds a point farther away than [`FARTHEST_M`] or not finite, a line of fewer
    /// than two points or a lane index out of range.
    pub fn first_fault(&self) -> Option<&'static str> {
        // without a branch: several points at once
        let near = |points: &[Point2]| {
            points.iter().fold(true, |ok, p| ok & (p.x.abs() <= FARTHEST_M) & (p.y.abs() <= FARTHEST_M))
        };
        let polygon = |p: &Polygon| near(&p.exterior) && p.holes.iter().all(|h| near(h));
        let line = |l: &Vec<Point2>| l.len() >= 2 && near(l);
        let linked = |ids: &[u32]| ids.iter().all(|i| (*i as usize) < self.lanes.len());
        let lane = |l: &Lane| {
            line(&l.centreline) && polygon(&l.polygon) && linked(&l.successors) && linked(&l.predecessors)
        };
        [
            ("drivable_area", self.drivable_area.iter().all(polygon)),
            ("lanes", self.lanes.iter().all(lane)),
            ("road_dividers", self.road_dividers.iter().all(line)),
            ("lane_dividers", self.lane_dividers.iter().all(line)),
            ("ped_crossings", self.ped_crossings.iter().all(polygon)),
            ("walkways", self.walkways.iter().all(polygon)),
            ("stop_lines", self.stop_lines.iter().all(polygon)),
            ("carpark_areas", self.carpark_areas.iter().all(polygon)),
            ("lights", self.lights.iter().all(|l| linked(&[l.lane]) && near(&l.stop_line))),
        ]
        .into_iter()
        .find_map(|(name, ok)| (!ok).then_some(name))
    }

    /// Length of all lines and rings, metres along x plus metres along y: what observations cut into segments.
    pub fn length_m(&self) -> f64 {
        let step = |a: &Point2, b: &Point2| f64::from((b.x - a.x).abs() + (b.y - a.y).abs());
        let along = |points: &[Point2]| -> f64 {
            let (from, to) = (&points[..points.len().saturating_sub(1)], points.get(1..).unwrap_or_default());
            let ((froms, from), (tos, to)) = (from.as_chunks::<4>(), to.as_chunks::<4>());
            // four sums at once
            let fours = froms.iter().zip(tos).fold([0.0; 4], |sums: [f64; 4], (a, b)| {
                std::array::from_fn(|k| sums[k] + step(&a[k], &b[k]))
            });
            fours.into_iter().chain(from.iter().zip(to).map(|(a, b)| step(a, b))).sum()
        };
        let polygons =
            [&self.drivable_area, &self.ped_crossings, &self.walkways, &self.stop_lines, &self.carpark_areas];
        let areas = polygons.into_iter().flatten().chain(self.lanes.iter().map(|l| &l.polygon));
        let rings = areas.flat_map(Polygon::rings);
        let lines = self.lanes.iter().map(|l| &l.centreline);
        let lines = lines.chain(&self.road_dividers).chain(&self.lane_dividers);
        rings.chain(lines.map(Vec::as_slice)).map(along).sum()
    }

    /// Where vehicles may drive: the drivable area, else the lanes' surfaces.
    pub(crate) fn road(&self) -> Vec<&Polygon> {
        match self.drivable_area.is_empty() {
            true => self.lanes.iter().map(|lane| &lane.polygon).collect(),
            false => self.drivable_area.iter().collect(),
        }
    }

    /// Whether the map has a drivable area.
    pub fn has_road(&self) -> bool {
        !self.drivable_area.is_empty()
    }

    /// Whether the map has lanes at all.
    pub fn has_lanes(&self) -> bool {
        !self.lanes.is_empty()
    }
}
