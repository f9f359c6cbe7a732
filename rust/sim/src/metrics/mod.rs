//! Evaluation metrics of recorded rollouts, as far as they take geometry.
//!
//! [`Trajectories`] holds the states of one recorded scene. From them come contacts, leaving the road, comfort histograms
//! and surrogate safety measures. Per-step facts are those of [`crate::events`], so a number computed after the fact is the
//! one that the running world saw. Rates and scores are made of it in Python. Definitions, with what differs from the
//! paper, are in docs/evaluation.md.

mod comfort;
mod trajectories;

pub use comfort::{ComfortAxes, HISTOGRAM_BINS};
pub use trajectories::Trajectories;
