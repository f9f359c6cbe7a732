//! Tenth powers of many numbers at once, with the bits of `libm`'s: IDM's free acceleration takes one per proposal and step.
//!
//! The steps are those of FreeBSD's `e_powf.c`, without its special cases: Copyright (C) 1993 by Sun Microsystems, Inc.
//! Permission to use, copy, modify, and distribute this software is freely granted, provided that this notice is preserved.

use crate::geom::Real;
use crate::simd_dispatch::simd_dispatch;

/// Numbers that are raised together.
pub(super) const LANES: usize = 16;
/// Below the first IDM accelerates freely, and above the second it slows down as hard as it does, to the last bit.
const RANGE: [Real; 2] = [0.17, 1.12];

simd_dispatch! {
    /// Raises numbers to the tenth power, clamped to [`RANGE`] first.
    pub(super) fn tenth_powers(numbers: &mut [Real; LANES]) {
        for number in numbers {
            *number = tenth_power(*number);
        }
    }
}

/// The number without its last bits.
#[inline(always)]
fn head(x: Real, mask: u32) -> Real {
    Real::from_bits(x.to_bits() & mask)
}

#[inline(always)]
fn tenth_power(number: Real) -> Real {
    let number = if number > RANGE[0] { number } else { RANGE[0] };
    let number = if number < RANGE[1] { number } else { RANGE[1] };
    // number = 2^exponent x, and x is near 1 or 1.5
    let bits = number.to_bits() as i32;
    let fraction = bits & 0x007f_ffff;
    let (is_low, is_high) = (fraction <= 0x001c_c471, fraction >= 0x005d_b3d7);
    let is_middle = !is_low & !is_high;
    let carry = i32::from(is_high);
    let exponent = ((bits >> 23) - 0x7f + carry) as Real;
    let x_bits = ((fraction | 0x3f80_0000) - (carry << 23)) as u32;
    let x = Real::from_bits(x_bits);
    let (near, near_bit) = if is_middle { (1.5, 1 << 21) } else { (1.0, 0) };
    let (log_high, log_low) = if is_middle { (5.849_609_4e-1, 1.563_220_8e-6) } else { (0.0, 0.0) };
    // its logarithm to base 2, in two parts, from s = (x - near) / (x + near)
    let (u, v) = (x - near, 1.0 / (x + near));
    let s = u * v;
    let s_high = head(s, 0xffff_f000);
    let t_high = Real::from_bits((((x_bits >> 1) & 0xffff_f000) | 0x2000_0000) + 0x0040_0000 + near_bit);
    let t_low = x - (t_high - near);
    let s_low = v * ((u - s_high * t_high) - s_high * t_low);
    let s2 = s * s;
    let r = s2
        * s2
        * (0.6
            + s2 * (0.428_571_43
                + s2 * (0.333_333_34 + s2 * (0.272_728_12 + s2 * (0.230_660_75 + s2 * 0.206_975_02)))));
    let r = r + s_low * (s_high + s);
    let s2 = s_high * s_high;
    let t_high = head(3.0 + s2 + r, 0xffff_f000);
    let t_low = r - ((t_high - 3.0) - s2);
    let (u, v) = (s_high * t_high, s_low * t_high + t_low * s);
    let p_high = head(u + v, 0xffff_f000);
    let p_low = v - (p_high - u);
    let z_high = 9.619_140_6e-1 * p_high;
    let z_low = -1.173_685_74e-4 * p_high + p_low * 9.617_967e-1 + log_low;
    let high = head(((z_high + z_low) + log_high) + exponent, 0xffff_f000);
    let low = z_low - (((high - exponent) - log_high) - z_high);
    // ten times that, as a whole number and a rest
    let (p_low, p_high) = (10.0 * low, 10.0 * high);
    let bits = (p_low + p_high).to_bits() as i32;
    let size = bits & 0x7fff_ffff;
    let is_large = size > 0x3f00_0000;
    let shift = ((size >> 23) - 0x7e).max(0);
    let rounded = bits + (0x0080_0000 >> shift);
    let shift = (((rounded & 0x7fff_ffff) >> 23) - 0x7f).max(0);
    let whole = Real::from_bits(rounded as u32 & !(0x007f_ffff >> shift));
    let count = ((rounded & 0x007f_ffff) | 0x0080_0000) >> (23 - shift);
    let count = if bits < 0 { -count } else { count };
    let (whole, count) = if is_large { (whole, count) } else { (0.0, 0) };
    let p_high = p_high - whole;
    // two to the power of the rest
    let t = head(p_low + p_high, 0xffff_8000);
    let u = t * 6.931_457_5e-1;
    let v = (p_low - (t - p_high)) * 6.931_472e-1 + t * 1.428_606_5e-6;
    let z = u + v;
    let w = v - (z - u);
    let t = z * z;
    let even = 1.666_666_7e-1
        + t * (-2.777_777_8e-3 + t * (6.613_756e-5 + t * (-1.653_390_2e-6 + t * 4.138_137e-8)));
    let even = z - t * even;
    let r = (z * even) / (even - 2.0) - (w + z * w);
    Real::from_bits(((1.0 - (r - z)).to_bits() as i32 + (count << 23)) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::math;

    #[test]
    fn powers_have_the_bits_of_libm() {
        let all: Vec<Real> =
            (RANGE[0].to_bits()..=RANGE[1].to_bits()).step_by(37).map(Real::from_bits).collect();
        for some in all.as_chunks::<LANES>().0 {
            let mut found = *some;
            tenth_powers(&mut found);
            assert_eq!(found.map(Real::to_bits), some.map(|x| math::pow(x, 10.0).to_bits()), "{some:?}");
        }
        let mut ends = [0.0, 0.1, 1.3, 40.0].repeat(4).try_into().unwrap();
        tenth_powers(&mut ends);
        assert_eq!(ends[..4], [RANGE[0], RANGE[0], RANGE[1], RANGE[1]].map(|x| math::pow(x, 10.0)));
    }
}
