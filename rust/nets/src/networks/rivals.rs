//! The paper's rivals of CCDiff (rivals.md).

use crate::compute::cpu::Cpu;
use crate::networks::bits::{self, Bits};
use crate::networks::cpu_planner::on_cpu;
use crate::networks::ctg::{self, HalfUnet};
use crate::networks::denoising::Denoising;
use crate::networks::kind::NetworkKind;
use crate::networks::simnet::Simnet;

/// One plan per agent by regression.
pub const SIMNET: NetworkKind =
    NetworkKind { one_plan: true, ..NetworkKind::with_trunk("simnet", "SimNet", on_cpu::<Simnet<Cpu>>) };
/// Goals on a grid, a policy that drives to them, a choice among them.
pub const BITS: NetworkKind =
    NetworkKind { fits: bits::fits, ..NetworkKind::with_trunk("bits", "BITS", on_cpu::<Bits<Cpu>>) };
/// Diffusion of each agent's actions.
pub const CTG: NetworkKind = NetworkKind {
    denoises: true,
    fits: ctg::fits,
    ..NetworkKind::with_trunk("ctg", "CTG", on_cpu::<Denoising<HalfUnet<Cpu>>>)
};
