//! What a load did: what was kept, what was left out and why.
#![allow(missing_docs, reason = "fields are described in ccdiff_env/scenes/load_report.py")]

use ccdiff_sim::scene::Scene;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How the area where vehicles may drive was had.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Road {
    #[default]
    None,
    Given,
    Edges,
    Lanes,
}

/// What became of one scene.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SceneReport {
    pub name: String,
    pub key_frames: usize,
    pub tracks: BTreeMap<String, usize>,
    pub annotations: usize,
    pub dropped: BTreeMap<String, usize>,
    pub filled_gaps: usize,
    pub absences: usize,
    pub ego_channel: Option<String>,
    pub road: Road,
    pub notes: Vec<String>,
}

impl SceneReport {
    /// Mends a scene and says what was done.
    pub(crate) fn mend(&mut self, mut scene: Scene) -> Scene {
        let mended = scene.mend();
        self.filled_gaps += mended.filled_gaps;
        self.absences += mended.absences;
        self.notes.extend(mended.notes);
        scene
    }

    /// Counts a track that is left out.
    pub(crate) fn drop_track(&mut self, category: &str, reason: &str) {
        *self.dropped.entry(format!("{category}: {reason}")).or_default() += 1;
    }
}

/// What the cache did.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CacheReport {
    pub directory: Option<String>,
    pub hits: usize,
    pub built: usize,
    pub notes: Vec<String>,
}

/// Everything a load has to say.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct LoadReport {
    pub dataroot: String,
    pub version: String,
    pub scenes: Vec<SceneReport>,
    pub missing: Vec<String>,
    pub empty: Vec<String>,
    pub missing_maps: Vec<String>,
    pub map_notes: Vec<String>,
    pub cache: CacheReport,
    pub seconds: f64,
}
