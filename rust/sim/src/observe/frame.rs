//! The frame of the observing agent, and the clipping of numbers to their bounds.

use crate::geom::{Pose2, Real};

/// Eight numbers of a row.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(32))]
pub(super) struct Eight(pub(super) [Real; 8]);

/// Eight numbers of a row before they are turned: x, y, cosine and sine in the scene frame, then four numbers that are
/// the same in every frame. Unscaled.
pub(super) type Unturned = Eight;

/// The frame of an observing agent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) x: Real,
    pub(super) y: Real,
    cos: Real,
    sin: Real,
}

/// A frame written out for eight lanes; cosines and sines times the factors of the columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes {
    origin: [Real; 8],
    cos: [Real; 8],
    sin: [Real; 8],
}

impl Frame {
    pub(super) fn new(pose: &Pose2) -> Self {
        Self { x: pose.position.x, y: pose.position.y, cos: pose.cos, sin: pose.sin }
    }

    /// Two vectors (x₀, y₀, x₁, y₁) in this frame, each number times its factor and clipped to [−1, 1].
    #[inline(always)]
    pub(super) fn turn(&self, [x0, y0, x1, y1]: [Real; 4], factor: [Real; 4]) -> [Real; 4] {
        let (v, w) = ([x0, y0, x1, y1], [y0, x0, y1, x1]);
        let sin = [self.sin, -self.sin, self.sin, -self.sin];
        // in the order of [`Lanes::turn`], for the same bits
        std::array::from_fn(|i| clip(v[i] * (self.cos * factor[i]) + w[i] * (sin[i] * factor[i]), -1.0, 1.0))
    }

    pub(super) fn lanes(&self, factor: [Real; 8]) -> Lanes {
        let (c, s) = (self.cos, self.sin);
        let cos = [c, c, c, c, 1.0, 1.0, 1.0, 1.0];
        let sin = [s, -s, s, -s, 0.0, 0.0, 0.0, 0.0];
        Lanes {
            origin: [self.x, self.y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            cos: std::array::from_fn(|i| cos[i] * factor[i]),
            sin: std::array::from_fn(|i| sin[i] * factor[i]),
        }
    }
}

impl Lanes {
    /// A row in the frame, scaled and clipped, and the numbers of another one where this one's are +0.
    #[inline(always)]
    pub(super) fn turn(&self, (row, added): (&Unturned, &Eight)) -> [Real; 8] {
        let v: [Real; 8] = std::array::from_fn(|i| row.0[i] - self.origin[i]);
        let w = [v[1], v[0], v[3], v[2], v[5], v[4], v[7], v[6]];
        let sum = |i: usize| v[i] * self.cos[i] + w[i] * self.sin[i];
        let joined = |i: usize| clip(sum(i), -1.0, 1.0).to_bits() | added.0[i].to_bits();
        std::array::from_fn(|i| Real::from_bits(joined(i)))
    }

    /// [`Self::turn`] in one vector.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    #[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
    pub(super) fn turn_avx2(&self, (row, added): (&Unturned, &Eight)) -> [Real; 8] {
        use std::arch::x86_64::*;
        // SAFETY: eight floats each
        let [row, added, origin, cos, sin]: [__m256; 5] =
            unsafe { std::mem::transmute([row.0, added.0, self.origin, self.cos, self.sin]) };
        let v = _mm256_sub_ps(row, origin);
        let w = _mm256_permute_ps::<0b10_11_00_01>(v);
        let sum = _mm256_add_ps(_mm256_mul_ps(v, cos), _mm256_mul_ps(w, sin));
        let clipped = _mm256_min_ps(_mm256_max_ps(sum, _mm256_set1_ps(-1.0)), _mm256_set1_ps(1.0));
        // SAFETY: as above
        unsafe { std::mem::transmute(_mm256_or_ps(clipped, added)) }
    }
}

/// A value within bounds; the lower bound for NaN. Two instructions.
#[inline(always)]
pub(super) fn clip(value: Real, low: Real, high: Real) -> Real {
    let value = if value > low { value } else { low };
    if value < high { value } else { high }
}

/// Writes rows of `W` numbers, made from items one after the other. What is left of the padding of a row lies under the
/// next one, which is written later; the last row is written exactly.
///
/// Four rows at a time, for which there is one check whether they fit: `FOUR` is their room, padding included.
#[inline(always)]
pub(super) fn put_rows<T: Copy, const W: usize, const PADDED: usize, const FOUR: usize>(
    mut out: &mut [Real],
    items: &[T],
    row: impl Fn(T) -> [Real; PADDED],
) {
    const { assert!(W <= PADDED && FOUR == 3 * W + PADDED) };
    let mut rest = items;
    while let (Some((four, after)), Some(to)) = (rest.split_first_chunk::<4>(), out.first_chunk_mut::<FOUR>())
    {
        for (i, item) in four.iter().enumerate() {
            if let Some(to) = to[i * W..].first_chunk_mut::<PADDED>() {
                *to = row(*item);
            }
        }
        rest = after;
        out = &mut out[4 * W..];
    }
    for item in rest {
        if let Some(to) = out.first_chunk_mut::<PADDED>() {
            *to = row(*item);
            out = &mut out[W..];
        } else if let Some(to) = out.first_chunk_mut::<W>() {
            to.copy_from_slice(&row(*item)[..W]);
            out = &mut [];
        }
    }
}

#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        #[allow(unsafe_code, reason = "the function is called where the processor has the instructions")]
        fn both_ways_to_turn_a_row_give_the_same_bits(
            row in prop::array::uniform8(-500f32..500.0), pose in prop::array::uniform3(-300f32..300.0),
            factor in prop::array::uniform8(0f32..1.0), added in prop::array::uniform8(0f32..1.0),
        ) {
            let lanes = Frame::new(&Pose2::new(pose[0], pose[1], pose[2])).lanes(factor);
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let wide = unsafe { lanes.turn_avx2((&Eight(row), &Eight(added))) };
                prop_assert_eq!(wide.map(Real::to_bits), lanes.turn((&Eight(row), &Eight(added))).map(Real::to_bits));
            }
        }
    }
}
