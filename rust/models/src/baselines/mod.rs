//! The paper's rivals of CCDiff behind [`crate::plan_model::PlanModel`], one file each (rivals.md).
//!
//! All see the same inputs through one trunk and plan in the same action knots, so that they differ in what they are
//! about: how they draw plans and what guidance moves.

mod bits;
mod contact;
mod ctg;
mod cvae;
mod distributions;
mod latent;
mod simnet;

pub use bits::Bits;
pub use ctg::HalfUnet;
pub use cvae::Cvae;
pub use simnet::Simnet;

pub(crate) use bits::BITS;
pub(crate) use ctg::CTG;
pub(crate) use cvae::{STRIVE, TRAFFICSIM, TRAFFICSIM_PORT};
pub(crate) use simnet::SIMNET;

use crate::error::Result;
use crate::guidance::Guidance;
use crate::sampler::to_vec;
use tch::Tensor;

/// Finished plans [N · R, knots, 2] moved by guidance, all its steps at once.
fn moved(knots: &Tensor, guide: Option<&mut Guidance<'_>>) -> Result<Tensor> {
    let Some(guide) = guide.filter(|g| g.is_active()) else {
        return Ok(knots.shallow_clone());
    };
    let mut values = to_vec(knots);
    guide.adjust_finished(&mut values)?;
    Ok(Tensor::from_slice(&values).view_as(knots).to_device(knots.device()))
}
