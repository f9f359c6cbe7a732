//! The networks, one file or folder each, what there is to know of them, and the model that plans with one.

pub mod bits;
pub mod ccdiff;
pub mod cpu_planner;
pub mod ctg;
pub mod denoising;
pub mod kind;
pub mod kinds;
pub mod latents;
pub mod logged;
pub mod planner;
pub mod simnet;
pub mod tokens;
pub mod trajectory_model;
pub mod trunk;

use kind::NetworkKind;

/// All of them; a new one is its file, `pub mod`, and a line here.
pub const NETWORKS: &[NetworkKind] = &[
    ccdiff::CCDIFF,
    simnet::SIMNET,
    latents::TRAFFICSIM,
    latents::STRIVE,
    bits::BITS,
    ctg::CTG,
    ccdiff::CTGPP,
    tokens::TOKENS,
];
