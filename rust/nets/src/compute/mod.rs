//! What networks are computed with: operations, the processor's own, layers over them, weights.

pub mod backend;
pub mod cpu;
pub mod layers;
pub mod numbers;
pub mod weights;
