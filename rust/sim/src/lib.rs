//! Pure simulation of driving scenes: no files, no clock, no torch, no Python.

pub mod causal;
pub mod drivers;
pub mod dynamics;
pub mod error;
pub mod events;
pub mod geom;
pub mod metrics;
mod named;
pub mod observe;
pub mod options;
mod pdm;
pub mod planner;
pub mod scene;
mod simd_dispatch;
pub mod stage;
pub mod state;
pub mod world;

pub use error::{Result, SimError, check_length};
pub use simd_dispatch::{hold_to_base, is_held_to_base};

use std::hash::{Hash, Hasher};

/// A number that is the same in two libraries only where this crate was compiled alike for both: from the same source and
/// dependencies, by the same compiler, in the same profile. They may then hand values of this crate to each other.
pub fn build_mark() -> u64 {
    let mut state = std::hash::DefaultHasher::new();
    // the number of a type is made from compiler, version, features, profile and dependencies
    std::any::TypeId::of::<world::VecWorld>().hash(&mut state);
    env!("CCDIFF_SIM_SOURCE").hash(&mut state);
    state.finish()
}
