//! The ground of a scene: its road, its lanes and its lines, as a whole and level by level.

use crate::geom::{Bitmap, Boundary, Point2, Real, Region};
use crate::observe::{BevConfig, MapSegments};
use crate::scene::{LaneIndex, Map, Scene, range_of};
use std::sync::OnceLock;

/// Ground is made for elevations this far apart, metres.
const SLOT_M: Real = 0.5;

/// What a map says of places, ready to be asked.
#[derive(Debug)]
pub struct Ground {
    /// Where vehicles may drive: the drivable area, else the lanes' polygons; `None` where the map has neither, and
    /// then nothing is ever off the road.
    pub road: Option<Region>,
    /// Nearest-lane index; `None` without lanes.
    pub lanes: Option<LaneIndex>,
    /// Map segments for observations.
    pub segments: MapSegments,
    /// What does not move in bird's-eye rasters; `None` without rasters.
    pub(crate) raster: Option<Bitmap>,
    /// Elevation of its level; `None` for the whole map.
    elevation_m: Option<Real>,
    /// The road's edge, made when a distance to it is first asked for.
    edge: OnceLock<Boundary>,
}

impl Ground {
    /// The ground of the whole map, or of the level of an elevation.
    fn new(map: &Map, elevation_m: Option<Real>, bev: Option<&BevConfig>) -> Self {
        let part = elevation_m.map(|z| map.on_level(z));
        let shown = part.as_ref().unwrap_or(map);
        let road = Region::new(shown.road());
        Self {
            lanes: LaneIndex::on_level(map, elevation_m),
            segments: MapSegments::on_level(map, shown, elevation_m, road.as_ref()),
            raster: bev.map(|bev| bev.ground(shown, elevation_m)),
            elevation_m,
            road,
            edge: OnceLock::new(),
        }
    }

    /// Distance of a place to the edge of the road, metres, negative off the road; `None` where there is no road.
    pub(crate) fn road_distance_m(&self, map: &Map, point: Point2) -> Option<Real> {
        let road = self.road.as_ref()?;
        let edge = self.edge.get_or_init(|| {
            let part = self.elevation_m.map(|z| map.on_level(z));
            Boundary::new(&part.as_ref().unwrap_or(map).road(), road)
        });
        let distance_m = edge.distance_m(point);
        Some(if road.contains(point) { distance_m } else { -distance_m })
    }
}

/// The ground of a scene, and that of each of its levels, made when first asked for.
#[derive(Debug)]
pub(crate) struct Grounds {
    pub(crate) whole: Ground,
    /// Elevation of the first level's ground, metres.
    low_m: Real,
    levels: Vec<OnceLock<Box<Ground>>>,
    bev: Option<BevConfig>,
}

impl Grounds {
    pub(crate) fn new(scene: &Scene, bev: Option<&BevConfig>) -> Self {
        let map = &scene.map;
        let of_map = map.lanes.iter().any(|lane| !lane.elevation_m.is_empty())
            || map.elevation_m.layers().iter().any(|(_, ranges)| !ranges.is_empty());
        let heights = scene.tracks.elevation_m.iter().zip(&scene.tracks.valid);
        let heights = heights.filter(|(_, valid)| **valid).map(|(z, _)| *z);
        let heights = heights.chain(map.lanes.iter().flat_map(|lane| &lane.elevation_m).copied());
        let [low_m, high_m] = range_of(heights);
        let count = if of_map && scene.has_levels() { ((high_m - low_m) / SLOT_M) as usize + 1 } else { 0 };
        Self {
            whole: Ground::new(map, None, bev),
            low_m,
            levels: (0..count).map(|_| OnceLock::new()).collect(),
            bev: bev.copied(),
        }
    }

    /// The ground of an elevation's level; the whole one without an elevation, and where the map tells none.
    #[inline]
    pub(crate) fn at(&self, map: &Map, elevation_m: Option<Real>) -> &Ground {
        match elevation_m {
            Some(z) if !self.levels.is_empty() => self.of_level(map, z),
            _ => &self.whole,
        }
    }

    fn of_level(&self, map: &Map, elevation_m: Real) -> &Ground {
        let slot = (((elevation_m - self.low_m) / SLOT_M).max(0.0) as usize).min(self.levels.len() - 1);
        let middle_m = self.low_m + (slot as Real + 0.5) * SLOT_M;
        self.levels[slot].get_or_init(|| Box::new(Ground::new(map, Some(middle_m), self.bev.as_ref())))
    }
}
