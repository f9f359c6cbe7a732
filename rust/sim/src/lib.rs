//! Pure simulation of driving scenes: no files, no clock, no torch, no Python.

pub mod causal;
pub mod dynamics;
pub mod error;
pub mod events;
pub mod geom;
pub mod metrics;
pub mod observe;
pub mod policy;
pub mod scene;
pub mod state;
mod wide;
pub mod world;

pub use error::{Result, SimError};
