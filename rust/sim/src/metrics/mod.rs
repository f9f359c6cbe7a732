//! Evaluation metrics of recorded rollouts, as far as they take geometry.
//!
//! [`Trajectories`] is a view of the states of one recorded scene, agents by steps. From it come contacts, leaving the
//! road, comfort histograms and surrogate safety measures. Per-step facts are those of [`crate::events`], so a number
//! computed after the fact is the one that the running world saw. Rates and scores are made of it in Python.
//! Definitions, with what differs from the paper, are in docs/evaluation.md.

mod collision;
mod comfort;
mod motion;
mod off_road;
mod safety;

pub use collision::contacts;
pub use comfort::{ComfortAxes, ComfortHistograms, HISTOGRAM_BINS};
pub use motion::Trajectories;
pub use off_road::off_road_flags;
pub use safety::{min_ttc_s, over_speed};
