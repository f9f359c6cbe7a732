//! Planning networks without torch: what they see, what they are made of, how they plan.
//!
//! Units: metres, seconds, radians. Shapes: R rows (agents of all scenes), H history steps, T horizon steps, K neighbour slots.

pub mod backend;
pub mod bits;
pub mod ccdiff;
pub mod config;
pub mod ctg;
pub mod error;
pub mod features;
pub mod guidance;
pub mod kernels;
pub mod kind;
pub mod kinds;
pub mod latents;
pub mod layers;
pub mod logged;
pub mod noise;
pub mod own;
pub mod own_planner;
pub mod plan_space;
pub mod planner;
pub mod raster;
pub mod rivals;
pub mod sampler;
pub mod schedule;
pub mod segments;
pub mod simnet;
pub mod tokens;
pub mod traffic;
pub mod trajectory_model;
pub mod trunk;
pub mod unicycle;
pub mod weights;

pub use config::ModelConfig;
pub use error::{ModelError, Result};
pub use kind::NetworkKind;
