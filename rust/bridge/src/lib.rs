//! What the extension modules `_native` and `_models` share: exceptions, and values handed from one to the other.
//!
//! Each module has a copy of `ccdiff_sim` of its own. `_models` refuses to be imported unless both copies were compiled alike
//! ([`ccdiff_sim::build_mark`]): a scene or driver made by one is then a scene or driver to the other. No panic crosses
//! from one to the other, which would end the process: drivers are handed over [`contained`].

mod contained;
mod cost;
pub mod errors;
mod handed;
mod networks;

pub use contained::{contained, fault};
pub use cost::call_cost;
pub use handed::{BoxedDriver, Handed, check_build, driver_capsule, scene_capsule, take_driver};
pub use networks::{AskedDriver, PyTrajectoryModel, path_of};
