//! nuScenes on disk to [`ccdiff_sim::scene::Scene`]s in memory.
//!
//! What flows in: the official tables and the map expansion (v1.3), or any data set written in that schema. What flows
//! out: scenes in their own frames and a report of what was kept and what was not. Quirks of the data set (tokens,
//! quaternions, 2 Hz key frames, node lists) stop here.
//!
//! - `stream`: a table as a stream of records, parsed in parallel
//! - `token`: tokens, and what is looked up by them
//! - `tables`: rows, and their join to the logged facts of each scene
//! - `resample`: key frames to steps, `spline`: smooth curves through them
//! - `arcline`, `map_file`, `crop`: centre lines, the map of a location, the part of it round a scene
//! - `build`: one scene
//! - `file`: regular files of a bounded size
//! - `category`: categories as kinds of agents
//! - `cache`: built scenes on disk
//! - `load`: all of it
//! - `gpudrive`: Waymo scenes in GPUDrive's JSON

mod arcline;
mod build;
mod cache;
mod category;
mod codec;
mod crop;
mod error;
mod file;
mod gpudrive;
mod load;
mod map_file;
mod options;
mod report;
mod resample;
mod spline;
mod stream;
mod tables;
mod token;

pub use category::kind_of_category;
pub use codec::{decode_scene, encode_scene, scene_hash};
pub use error::{NuscenesError, Result};
pub use gpudrive::load_gpudrive;
pub use load::{Loaded, load};
pub use options::{
    BuildOptions, EGO_AXLE_TO_CENTRE_M, EgoReference, Interpolation, KEY_FRAME_INTERVAL_S, KeyFrameTiming,
    LoadOptions, Selection,
};
pub use report::{CacheReport, Dropped, LoadReport, MapReport, Road, SceneReport};
