//! CCDiff and CTG++: scene diffusion over the decision causal graph, or over a graph of distances.

mod network;

pub use network::{Context, Network};

use crate::compute::cpu::Cpu;
use crate::networks::cpu_planner::on_cpu;
use crate::networks::denoising::Denoising;
use crate::networks::kind::NetworkKind;

/// Scene diffusion over the decision causal graph.
pub const CCDIFF: NetworkKind = NetworkKind {
    weights: &["fast", "one_step", "routes", "routes_one_step"],
    denoises: true,
    attends: true,
    causal: true,
    routes: true,
    sizes: |preset| preset,
    ..NetworkKind::of("ccdiff", "CCDiff", on_cpu::<Denoising<Network<Cpu>>>)
};

/// Scene diffusion over a graph of distances.
pub const CTGPP: NetworkKind = NetworkKind {
    denoises: true,
    attends: true,
    ..NetworkKind::of("ctgpp", "CTG++", on_cpu::<Denoising<Network<Cpu>>>)
};
