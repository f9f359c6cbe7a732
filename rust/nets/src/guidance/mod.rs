//! Guidance: moving finished plans, or plans while they are denoised, towards what a user wants of them (reference.md#guidance).
//!
//! ```text
//! GuidanceConfig, WorldGuidance ─► GuidanceContext ─► Guidance::adjust or adjust_finished ─► Guidance::report
//!                                             knots ─► Rollout ─► Objective::evaluate
//!                                             knots ◄─ vjp ◄─ StateGradient
//! ```
//! Plain numbers, no tensors: gradients of losses on states go through the unicycle analytically, for each sample of each world
//! in parallel. total = Σ_j w_j · mean over agents of loss_j is minimised; a mask per agent and one per knot multiply its
//! gradient, so what is not guided keeps its bits.
//!
//! Differs from the paper: key agents are given per plan, not re-ranked in every denoising step; each sample has its own
//! descent, so the number of samples does not change a plan. Through the network's attention, agents that are not guided may
//! answer to those that are, one denoising step later.

mod config;
mod context;
mod descent;
mod guide;
mod knots;
mod objective;
mod report;
mod rollout;

pub use config::{GuidanceConfig, LEAST_TARGET_MPS, TABLES, Target};
pub use context::{GuidanceContext, MOVING_MPS, WorldGuidance};
pub use guide::{Guidance, Guide};
pub use knots::KnotMap;
pub use objective::{
    AgentCollision, Approach, Called, Caller, Evaluation, MapCollision, Objective, OverSpeed, PythonCost,
    connect,
};
pub use report::{GradientStatistics, GuidanceReport, choose_samples};
pub use rollout::{Rollout, StateGradient};
