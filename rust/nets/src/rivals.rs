//! The paper's rivals of CCDiff (rivals.md): SimNet has kernels of this crate, the others need torch.

use crate::kind::NetworkKind;
use crate::own_planner::regressor;
use crate::traffic::driver;

/// One plan per agent by regression.
pub const SIMNET: NetworkKind = NetworkKind {
    one_plan: true,
    own: Some(regressor),
    ..NetworkKind::with_trunk(driver("simnet", "SimNet"))
};
/// Latents of all agents decoded jointly, after the paper.
pub const TRAFFICSIM: NetworkKind = NetworkKind::with_trunk(driver("trafficsim", "TrafficSim"));
/// Latents of each agent under a fixed prior, as ported by others.
pub const TRAFFICSIM_PORT: NetworkKind =
    NetworkKind::with_trunk(driver("trafficsim_port", "TrafficSim, as ported"));
/// Latents of each agent under a learned prior, optimised.
pub const STRIVE: NetworkKind = NetworkKind::with_trunk(driver("strive", "STRIVE"));
/// Goals on a grid, a policy that drives to them, a choice among them.
pub const BITS: NetworkKind = NetworkKind::with_trunk(driver("bits", "BITS"));
/// Diffusion of each agent's actions.
pub const CTG: NetworkKind = NetworkKind { denoises: true, ..NetworkKind::with_trunk(driver("ctg", "CTG")) };
