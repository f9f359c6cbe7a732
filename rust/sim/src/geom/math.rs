//! Scalar functions with the same bits everywhere (pure Rust `libm`), and angle arithmetic.

use super::{Real, Vector2};
use std::f32::consts::{PI, TAU};

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos(angle_rad: Real) -> (Real, Real) {
    libm::sincosf(angle_rad)
}

/// A direction turned by an angle in radians; small angles by their series, to the last bits.
#[inline]
pub(crate) fn turned(direction: Vector2, angle_rad: Real) -> Vector2 {
    if is_small(angle_rad) {
        return turned_a_little(direction, angle_rad);
    }
    let (sin, cos) = sin_cos(angle_rad);
    Vector2::new(direction.x * cos - direction.y * sin, direction.y * cos + direction.x * sin)
}

/// Whether [`turned`] turns by the series.
#[inline(always)]
pub(crate) fn is_small(angle_rad: Real) -> bool {
    angle_rad * angle_rad < 0.01
}

/// As [`turned`], for angles that are small.
#[inline(always)]
pub(crate) fn turned_a_little(direction: Vector2, angle_rad: Real) -> Vector2 {
    let square = angle_rad * angle_rad;
    let sin = angle_rad * (1.0 - square / 6.0 * (1.0 - square / 20.0));
    let cos = 1.0 - 0.5 * square * (1.0 - square / 12.0);
    Vector2::new(direction.x * cos - direction.y * sin, direction.y * cos + direction.x * sin)
}

/// As `clamp`, without its assertion, which keeps loops from becoming vectors.
#[inline(always)]
pub(crate) fn within(x: Real, low: Real, high: Real) -> Real {
    let x = if x < low { low } else { x };
    if x > high { high } else { x }
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

        #[test]
        fn turned_directions_are_those_of_the_sum_of_the_angles(a in -3f32..3.0, by in -0.3f32..0.3) {
            let (sin, cos) = sin_cos(a);
            let found = turned(Vector2::new(cos, sin), by);
            let (s0, c0) = (f64::from(a) + f64::from(by)).sin_cos();
            prop_assert!((s0 - f64::from(found.y)).abs() < 2e-7 && (c0 - f64::from(found.x)).abs() < 2e-7);
        }
    }
}
