//! What a load did: what was kept, what was left out and why.

use ccdiff_sim::scene::{Map, Scene};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Tracks left out of one scene for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dropped {
    /// Why, in words.
    pub reason: String,
    /// Category of the data set.
    pub category: String,
    /// Number of tracks.
    pub tracks: usize,
    /// Number of annotations in them.
    pub annotations: usize,
}

/// How the area where vehicles may drive was had.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Road {
    /// The map has none: nothing is ever off the road.
    #[default]
    None,
    /// The data set has it.
    Given,
    /// Made from the edges of the road, and from lanes where there are no edges.
    Edges,
    /// Made from lanes and their widths.
    Lanes,
}

/// What became of one scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SceneReport {
    /// Name of the scene.
    pub name: String,
    /// Key frames of the data set.
    pub key_frames: usize,
    /// Tracks kept per category, the ego included.
    pub tracks: BTreeMap<String, usize>,
    /// Annotations in the tracks kept, the ego's poses not counted.
    pub annotations: usize,
    /// Tracks left out.
    pub dropped: Vec<Dropped>,
    /// Gaps inside tracks, of up to two seconds, that were filled by interpolation.
    pub filled_gaps: usize,
    /// Key frames in those gaps; steps where the data set has no key frames.
    pub filled_key_frames: usize,
    /// Longer gaps: the agent is away meanwhile.
    pub absences: usize,
    /// Sensor channel whose key frames carry the ego poses; `None` where the scene has no ego.
    pub ego_channel: Option<String>,
    /// How the area where vehicles may drive was had.
    pub road: Road,
    /// Elements per map layer after cropping.
    pub map_layers: BTreeMap<String, usize>,
    /// Anything else worth knowing.
    pub notes: Vec<String>,
}

impl SceneReport {
    /// Counts the elements of each layer of a map.
    pub(crate) fn count_layers(&mut self, map: &Map) {
        let counts = [
            ("drivable_area", map.drivable_area.len()),
            ("lanes", map.lanes.len()),
            ("road_dividers", map.road_dividers.len()),
            ("lane_dividers", map.lane_dividers.len()),
            ("ped_crossings", map.ped_crossings.len()),
            ("walkways", map.walkways.len()),
            ("stop_lines", map.stop_lines.len()),
            ("carpark_areas", map.carpark_areas.len()),
        ];
        self.map_layers = counts.map(|(name, count)| (name.to_owned(), count)).into();
    }

    /// Mends a scene and says what was done.
    pub(crate) fn mend(&mut self, mut scene: Scene) -> Scene {
        let mended = scene.mend();
        self.filled_gaps += mended.filled_gaps;
        self.filled_key_frames += mended.filled_steps;
        self.absences += mended.absences;
        self.notes.extend(mended.notes);
        scene
    }

    /// Adds one dropped track.
    pub(crate) fn drop_track(&mut self, reason: &str, category: &str, annotations: usize) {
        let same = |d: &&mut Dropped| d.reason == reason && d.category == category;
        if let Some(entry) = self.dropped.iter_mut().find(same) {
            entry.tracks += 1;
            entry.annotations += annotations;
        } else {
            let (reason, category) = (reason.to_owned(), category.to_owned());
            self.dropped.push(Dropped { reason, category, tracks: 1, annotations });
        }
    }
}

/// What the map file of one location holds. Only files that were read in this load are listed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MapReport {
    /// Location.
    pub location: String,
    /// Elements that could not be used, and why.
    pub notes: Vec<String>,
}

/// What the cache did.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CacheReport {
    /// Folder; `None` where the cache is off.
    pub directory: Option<String>,
    /// Scenes taken from the cache.
    pub hits: usize,
    /// Scenes built from the tables.
    pub built: usize,
    /// Damaged files that were built again, and folders that could not be written.
    pub notes: Vec<String>,
}

/// Everything a load has to say.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LoadReport {
    /// Root of the data set.
    pub dataroot: String,
    /// Version, the name of the folder with the tables.
    pub version: String,
    /// One entry per scene, in the order of the scenes.
    pub scenes: Vec<SceneReport>,
    /// Scenes that were asked for and are not in the data set.
    pub missing: Vec<String>,
    /// Scenes in the data set that have no agent to show and were left out.
    pub empty: Vec<String>,
    /// Locations without a map file; their scenes have an empty map.
    pub missing_maps: Vec<String>,
    /// Map files read.
    pub maps: Vec<MapReport>,
    /// What the cache did.
    pub cache: CacheReport,
    /// How long it took, seconds.
    pub seconds: f64,
}
