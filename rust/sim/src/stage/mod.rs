//! What worlds of a scene stand on: the scene made ready, its routes and log, and what agents did last.

mod centre_line;
mod history;
mod log;
mod prepared;
mod route;

pub use centre_line::{CentreLine, Place};
pub use history::{History, PastState};
pub use prepared::{PreparedScene, Stage};
pub use route::Route;
