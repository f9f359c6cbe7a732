//! The frame of the observing agent, and the clipping of numbers to their bounds.

use crate::geom::{Pose2, Real};

/// Turns pairs of vectors into the frame of a pose, four numbers at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) x: Real,
    pub(super) y: Real,
    cos: Real,
    sin: [Real; 4],
}

impl Frame {
    pub(super) fn new(pose: &Pose2) -> Self {
        Self {
            x: pose.position.x,
            y: pose.position.y,
            cos: pose.cos,
            sin: [pose.sin, -pose.sin, pose.sin, -pose.sin],
        }
    }

    /// Two vectors (x₀, y₀, x₁, y₁) in this frame, each number times its factor and clipped to [−1, 1].
    #[inline(always)]
    pub(super) fn turn(&self, [x0, y0, x1, y1]: [Real; 4], factor: [Real; 4]) -> [Real; 4] {
        let (v, w) = ([x0, y0, x1, y1], [y0, x0, y1, x1]);
        std::array::from_fn(|i| clip((v[i] * self.cos + w[i] * self.sin[i]) * factor[i], -1.0, 1.0))
    }
}

/// A value within bounds; the lower bound for NaN. Two instructions.
#[inline(always)]
pub(super) fn clip(value: Real, low: Real, high: Real) -> Real {
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}
