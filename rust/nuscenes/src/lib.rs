//! nuScenes on disk to [`ccdiff_sim::scene::Scene`]s in memory.
//!
//! What flows in: the official tables and the map expansion (v1.3), or any data set written in that schema. What flows
//! out: scenes in their own frames and a report of what was kept and what was not. Quirks of the data set (tokens,
//! quaternions, 2 Hz key frames, node lists) stop here.
//!
//! `load` reads tables (`stream`, `token`, `tables`), makes steps of key frames (`resample`, `spline`) and maps (`arcline`,
//! `map_file`, `crop`) within bounds (`budget`), and keeps built scenes (`cache`). `gpudrive` reads Waymo scenes in GPUDrive's JSON.

mod arcline;
mod budget;
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
pub use report::{CacheReport, LoadReport, Road, SceneReport};
