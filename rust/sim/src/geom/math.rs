//! Scalar functions with the same bits everywhere (pure Rust `libm`), and angle arithmetic.

use super::Real;
use std::f32::consts::{PI, TAU};

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos(angle_rad: Real) -> (Real, Real) {
    libm::sincosf(angle_rad)
}

/// Angle of the vector (x, y), radians in (−π, π].
#[inline]
pub fn atan2(y: Real, x: Real) -> Real {
    libm::atan2f(y, x)
}

/// Tangent.
#[inline]
pub fn tan(angle_rad: Real) -> Real {
    libm::tanf(angle_rad)
}

/// Inverse tangent.
#[inline]
pub fn atan(x: Real) -> Real {
    libm::atanf(x)
}

/// Length of the vector (x, y). `sqrt` is correctly rounded by IEEE 754, so it is the hardware's.
#[inline]
pub fn hypot(x: Real, y: Real) -> Real {
    (x * x + y * y).sqrt()
}

/// e to the power x.
#[inline]
pub fn exp(x: Real) -> Real {
    libm::expf(x)
}

/// x to the power y.
#[inline]
pub fn pow(x: Real, y: Real) -> Real {
    libm::powf(x, y)
}

/// Whether a number of a world is finite, and so small that its square is, too.
#[inline]
pub(crate) fn is_sound(x: Real) -> bool {
    x.abs() <= 1e9
}

/// Wraps an angle to (−π, π].
#[inline]
pub fn wrap_angle(angle_rad: Real) -> Real {
    if angle_rad > -PI && angle_rad <= PI {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * (angle_rad / TAU).round();
    if wrapped <= -PI {
        wrapped + TAU
    } else if wrapped > PI {
        wrapped - TAU
    } else {
        wrapped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn wrapped_angles_lie_in_range_and_point_the_same_way(a in -1e4f32..1e4) {
            let w = wrap_angle(a);
            prop_assert!(w > -PI - 1e-6 && w <= PI + 1e-6);
            let (s0, c0) = (f64::from(a).sin(), f64::from(a).cos());
            let (s1, c1) = sin_cos(w);
            prop_assert!((s0 - f64::from(s1)).abs() < 2e-3 && (c0 - f64::from(c1)).abs() < 2e-3);
        }
    }
}
