//! The boundary to libtorch: gradient mode set and put back, panics of tch turned into errors.
//!
//! Inside a [`guarded`] call the panicking methods of tch may be used freely: a libtorch exception unwinds to the
//! guard, which puts the gradient mode (one thread-local shared with Python's torch) back and returns
//! [`ModelError::Torch`]. Every public function of this crate that touches a tensor enters through it.

use crate::error::{ModelError, Result};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs tensor code with gradients on or off.
///
/// # Errors
/// What the closure returns, and [`ModelError::Torch`] where libtorch refuses an operation.
pub fn guarded<T>(gradients: bool, operation: &'static str, f: impl FnOnce() -> Result<T>) -> Result<T> {
    // the closure never unwinds through tch's mode switch, so the mode is always restored
    let caught = || catch_unwind(AssertUnwindSafe(f));
    let outcome = if gradients { tch::with_grad(caught) } else { tch::no_grad(caught) };
    outcome.unwrap_or_else(|payload| Err(ModelError::torch(operation, &message(payload.as_ref()))))
}

fn message(payload: &(dyn Any + Send)) -> String {
    payload
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| payload.downcast_ref::<&str>().map(ToString::to_string))
        .unwrap_or_else(|| "a panic without a message".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tch::{Kind, Tensor};

    #[test]
    fn a_bad_operation_becomes_an_error_and_leaves_the_gradient_mode_alone() {
        let x = Tensor::zeros([2, 3], (Kind::Float, tch::Device::Cpu)).set_requires_grad(true);
        let result = guarded(false, "test", || Ok(x.matmul(&x)));
        assert!(matches!(result, Err(ModelError::Torch { operation: "test", .. })));
        assert!((&x * 2.0).requires_grad());
    }
}
