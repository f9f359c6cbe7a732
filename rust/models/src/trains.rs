//! What networks are trained on.

use crate::batch::Batch;
use ccdiff_nets::compute::backend::Inputs;
use tch::Tensor;

/// A backend that networks are trained on.
pub trait Trains: for<'a> Inputs<Batch<'a> = Batch> {
    /// Numbers as a tensor of torch's of a size, whose gradient goes back to them.
    fn leaf(x: &Self::Tensor, size: &[i64]) -> Tensor;
}
