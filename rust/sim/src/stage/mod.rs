//! A scene prepared for simulation: its ground, routes and log; and past states of agents.

mod centre_line;
mod ground;
mod history;
mod hitch;
mod log;
mod prepared;
mod route;

pub use centre_line::{CentreLine, Place};
pub use ground::Ground;
pub use history::{History, PastState};
pub use hitch::hitches;
pub(crate) use hitch::towed_pose;
pub use log::apart_in_log;
pub use prepared::{PreparedScene, Stage};
pub use route::Route;
