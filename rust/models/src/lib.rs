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
mod lateral_perturbation;
mod layers;
mod longitudinal_perturbation;
mod losses;
pub mod plan_model;
pub mod plan_space;
pub mod sampler;
pub mod tokens;
pub mod torch;
pub mod torch_model;
pub mod train;
pub mod unicycle;

pub use ccdiff_nets::{
    config, error, features, guidance, noise, raster, schedule, segments, traffic, trajectory_model,
};

pub use config::ModelConfig;
pub use error::{ModelError, Result};

use torch_sys as _;

/// The device of a name.
///
/// # Errors
/// [`ModelError::Config`] for another name than `cpu` and `cuda`, or where there is no such device.
pub fn device_named(name: &str) -> Result<tch::Device> {
    let fail = |expected| Err(ModelError::Config { field: "device", got: format!("{name:?}"), expected });
    match name {
        "cpu" => Ok(tch::Device::Cpu),
        "cuda" => {
            let device = tch::Device::Cuda(0);
            // what torch says it has is not always what it can use
            let tried = tch::Tensor::f_zeros([1], (tch::Kind::Float, device));
            tried.map(|_| device).or_else(|_| fail("a device that torch can use"))
        }
        _ => fail("\"cpu\" or \"cuda\""),
    }
}
