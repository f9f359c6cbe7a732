//! Loops over many numbers, compiled twice: for every processor, and for those with 256-bit vectors (AVX2).
//!
//! Which of the two runs is found out while the program runs. The bits are the same: both do the same IEEE 754
//! operations in the same order, because Rust neither fuses nor reorders floating-point operations.

use std::sync::atomic::{AtomicBool, Ordering};

static BASE_ALONE: AtomicBool = AtomicBool::new(false);

/// Holds all later work of the process to the instructions that every processor has, so that a test can compare the bits.
pub fn hold_to_base() {
    BASE_ALONE.store(true, Ordering::Relaxed);
}

/// Whether [`hold_to_base`] was called.
#[inline]
pub fn is_held_to_base() -> bool {
    BASE_ALONE.load(Ordering::Relaxed)
}

/// A number where all bits of a mask are set, another one where none is; faster than `if` in loops over arrays.
#[inline(always)]
pub(crate) fn pick(mask: u32, chosen: f32, other: f32) -> f32 {
    f32::from_bits(chosen.to_bits() & mask | other.to_bits() & !mask)
}

/// Defines functions that exist twice, see the module. Their bodies, and what they call, must be `#[inline(always)]`
/// loops over slices.
///
/// Where the compiler does not find the vectors by itself, `fn name(…) with f[bound] = portable, avx2 { … }` gives the
/// body a function `f` of two arguments that is one of the two named, the second with
/// `#[target_feature(enable = "avx2")]`. `fn name<N, M>(…)` has constants `N: usize` and `M: usize`.
macro_rules! simd_dispatch {
    ($($(#[$doc:meta])* $vis:vis fn $name:ident $(<$($n:ident),+>)? ($($arg:ident: $ty:ty),* $(,)?)
        $(with $f:ident [$($bound:tt)+] = $portable:path, $avx2:path)? $body:block)+) => {$(
        $(#[$doc])*
        $vis fn $name$(<$(const $n: usize),+>)?($($arg: $ty),*) {
            #[inline(always)]
            fn each$(<$(const $n: usize),+>)?($($arg: $ty,)* $($f: impl $($bound)+)?) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2$(<$(const $n: usize),+>)?($($arg: $ty),*) {
                    each$(::<$($n),+>)?($($arg,)* $(|a, b| $avx2(a, b))?);
                }
                if std::arch::is_x86_feature_detected!("avx2") && !crate::is_held_to_base() {
                    #[allow(unsafe_code, reason = "the compiler cannot know what the processor was just asked")]
                    // SAFETY: the processor has AVX2
                    return unsafe { avx2$(::<$($n),+>)?($($arg),*) };
                }
            }
            each$(::<$($n),+>)?($($arg,)* $(|a, b| $portable(a, b))?);
        }
    )+};
}

pub(crate) use simd_dispatch;
