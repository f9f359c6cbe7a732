//! Evaluation metrics: pure functions of recorded rollouts.
//!
//! [`Trajectories`] is a view of the states of one recorded scene, agents by steps. From it come collisions, leaving the
//! road, displacement from the log, comfort histograms and surrogate safety measures. Per-step facts are those of
//! [`crate::events`], so a number computed after the fact is the one that the running world saw. Sums over time and
//! scenes are f64. Definitions, with what differs from the paper, are in docs/evaluation.md.

mod collision;
mod comfort;
mod displacement;
mod motion;
mod off_road;
mod safety;

pub use collision::{CollisionReport, CollisionVariant, PairContact};
pub use comfort::{ComfortAxes, ComfortHistograms, HISTOGRAM_BINS};
pub use displacement::{Displacement, displacement};
pub use motion::Trajectories;
pub use off_road::{OffRoadReport, off_road_report};
pub use safety::{min_ttc_s, over_speed};
