//! Networks on libtorch: the one crate that links it. What needs no tensor stands in `ccdiff-nets`.
//!
//! ```text
//! scene::Scene / world states ─► features::Window ─► features::build (rayon) ─► batch::Batch ─► PlanModel
//!                                                    dataset, train ◄── losses       │ (CCDiff, baselines)
//!                                                    sampler, torch_model ◄──────────┘ clean action knots
//! ```
//! Units: metres, seconds, radians. Shapes: R rows (agents of all scenes), H history steps, T horizon steps, K neighbour
//! slots. Tensor code runs inside [`grad::guarded`], so libtorch's exceptions come back as [`ModelError`].

pub mod baselines;
pub mod batch;
pub mod checkpoint;
mod collision;
pub mod dataset;
pub mod diffusion;
pub mod grad;
pub mod kinds;
mod losses;
mod perturbation;
pub mod plan_model;
pub mod plan_space;
mod slots;
pub mod tokens;
pub mod torch;
pub mod torch_model;
pub mod train;
pub mod unicycle;

pub use ccdiff_nets::inputs::{features, segments};
pub use ccdiff_nets::networks::trajectory_model;
pub use ccdiff_nets::sampling::{noise, sampler, schedule};
pub use ccdiff_nets::{config, error, guidance, traffic};

pub use config::ModelConfig;
pub use error::{ModelError, Result};

use torch_sys as _;

/// The device of a name: `cpu`, `cuda`, which is the first card, or `cuda:N`.
///
/// # Errors
/// [`ModelError::Config`] for another name, and with torch's reason where there is no such device.
pub fn device_named(name: &str) -> Result<tch::Device> {
    let fail = |got, expected| Err(ModelError::Config { field: "device", got, expected });
    let device = match name.strip_prefix("cuda") {
        None if name == "cpu" => return Ok(tch::Device::Cpu),
        Some("") => Some(0),
        Some(place) => place.strip_prefix(':').and_then(|number| number.parse::<u8>().ok()),
        None => None,
    };
    let Some(device) = device.map(|number| tch::Device::Cuda(number.into())) else {
        return fail(format!("{name:?}"), "\"cpu\", \"cuda\" or \"cuda:N\"");
    };
    // what torch says it has is not always what it can use
    match tch::Tensor::f_zeros([1], (tch::Kind::Float, device)) {
        Ok(_) => Ok(device),
        Err(error) => {
            let reason = error.to_string();
            let reason = reason.lines().next().unwrap_or_default().trim();
            fail(format!("{name:?} (torch: {reason})"), "a device that torch can use")
        }
    }
}
