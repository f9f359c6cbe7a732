//! Planning networks without torch: what they see, what they are made of, how they plan.
//!
//! Rooms, each of which uses those after it: traffic, networks, compute, sampling, guidance, inputs, kernels, config, error.
//!
//! Units: metres, seconds, radians. Shapes: R rows (agents of all scenes), H history steps, T horizon steps, K neighbour slots.

pub mod compute;
pub mod config;
pub mod error;
pub mod guidance;
pub mod inputs;
pub mod kernels;
pub mod networks;
pub mod sampling;
pub mod traffic;

pub use config::ModelConfig;
pub use error::{ModelError, Result};
pub use networks::kind::NetworkKind;
