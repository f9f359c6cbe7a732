//! The paper's rivals of CCDiff (rivals.md).

use crate::bits::{self, Bits};
use crate::ctg::{self, HalfUnet};
use crate::kind::NetworkKind;
use crate::own::Own;
use crate::own_planner::{denoising, proposing};
use crate::simnet::Simnet;
use crate::traffic::config::driver;

/// One plan per agent by regression.
pub const SIMNET: NetworkKind = NetworkKind {
    one_plan: true,
    ..NetworkKind::with_trunk(driver("simnet", "SimNet"), proposing::<Simnet<Own>>)
};
/// Goals on a grid, a policy that drives to them, a choice among them.
pub const BITS: NetworkKind = NetworkKind {
    fits: bits::fits,
    ..NetworkKind::with_trunk(driver("bits", "BITS"), proposing::<Bits<Own>>)
};
/// Diffusion of each agent's actions.
pub const CTG: NetworkKind = NetworkKind {
    denoises: true,
    fits: ctg::fits,
    ..NetworkKind::with_trunk(driver("ctg", "CTG"), denoising::<HalfUnet<Own>>)
};
