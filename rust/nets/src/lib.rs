//! Planning networks without torch: what they see, what they are made of, how they plan.
//!
//! Units: metres, seconds, radians. Shapes: R rows (agents of all scenes), H history steps, T horizon steps, K neighbour slots.

pub mod config;
pub mod error;
pub mod features;
pub mod guidance;
pub mod noise;
pub mod raster;
pub mod schedule;
pub mod segments;
pub mod unicycle;

pub use config::{ModelConfig, ModelKind};
pub use error::{ModelError, Result};
