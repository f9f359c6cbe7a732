//! The CCDiff network: causal scene encoder and decoder that predicts the clean actions (reference.md#network).
//!
//! ```text
//! histories, noisy plan ─► tokens ─► round 0: [map] temporal, edge-aware social (masked by G)
//!                                    round 1: [map] temporal, plain social (masked by G) ─► clean action knots
//! ```
//! [`Network::encode`] computes what does not depend on the noisy plan once; [`Network::denoise`] runs per step.

mod network;

pub use network::{Context, Network};
