//! Vectors of each instruction set and the dispatch. `unsafe` is here and in [`super::tile`] alone.
//!
//! No product is fused with its addition, so all levels, and processors of other families, compute the same bits.

#![allow(unsafe_code, reason = "intrinsics")]

use std::sync::OnceLock;

/// Which instructions are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Level {
    /// Those that every processor of the family has.
    Base,
    /// 256-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 512-bit vectors.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// All that this processor has, the widest last.
    pub(super) fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "other processors have one")]
        let mut levels = vec![Self::Base];
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let narrow = has!("avx2");
            if narrow {
                levels.push(Self::Avx2);
            }
            if narrow && has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq") {
                levels.push(Self::Avx512);
            }
        }
        levels
    }
}

/// Work that is compiled once per level.
pub(super) trait Work {
    /// With vectors of the level, and so many rows in a tile of products. Must be `#[inline(always)]`, and so must be what it
    /// calls; [`at_level`] alone calls it.
    fn run<V: Vector, const ROWS: usize>(self);
}

/// Runs work compiled for the widest level that the processor has, or for the base if the process is held to it.
pub(super) fn at_level<W: Work>(work: W) {
    static WIDEST: OnceLock<Level> = OnceLock::new();
    let widest = || *WIDEST.get_or_init(|| Level::available().pop().unwrap_or(Level::Base));
    at(if ccdiff_sim::is_held_to_base() { Level::Base } else { widest() }, work);
}

/// Runs work compiled for a level that the processor has.
pub(super) fn at<W: Work>(level: Level, work: W) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{__m128, __m256, __m512};
        #[target_feature(enable = "avx2")]
        fn avx2<W: Work>(work: W) {
            work.run::<__m256, 6>();
        }
        #[target_feature(enable = "avx2,avx512f,avx512vl,avx512bw,avx512dq")]
        fn avx512<W: Work>(work: W) {
            work.run::<__m512, 12>();
        }
        match level {
            Level::Base => work.run::<__m128, 6>(),
            // SAFETY: the level is one that the processor was asked for
            Level::Avx2 => unsafe { avx2(work) },
            // SAFETY: as above
            Level::Avx512 => unsafe { avx512(work) },
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let Level::Base = level;
        work.run::<Four, 4>();
    }
}

/// A vector of `LANES` numbers.
pub(super) trait Vector: Copy {
    const LANES: usize;

    /// # Safety
    /// The processor has the instructions, and `LANES` numbers may be read.
    unsafe fn load(from: *const f32) -> Self;

    /// # Safety
    /// The processor has the instructions, and `LANES` numbers may be written.
    unsafe fn store(self, to: *mut f32);

    /// # Safety
    /// The processor has the instructions.
    unsafe fn splat(x: f32) -> Self;

    /// self + a · b, rounded twice.
    ///
    /// # Safety
    /// The processor has the instructions.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;

    /// The greater of each number and zero.
    ///
    /// # Safety
    /// The processor has the instructions.
    unsafe fn or_zero(self) -> Self;
}

/// A vector of these intrinsics.
#[cfg_attr(
    not(any(
        target_arch = "x86_64",
        target_arch = "aarch64",
        all(target_arch = "wasm32", target_feature = "simd128")
    )),
    allow(unused_macros, reason = "of processors that have intrinsics")
)]
macro_rules! vector {
    ($name:ident, $lanes:literal, $load:ident, $store:ident, $splat:ident, $add:ident, $mul:ident, $max:ident, $zero:ident) => {
        // SAFETY of all: the caller's promises are those of the intrinsics
        impl Vector for $name {
            const LANES: usize = $lanes;

            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                unsafe { $load(from) }
            }

            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                unsafe { $store(to, self) }
            }

            #[inline(always)]
            unsafe fn splat(x: f32) -> Self {
                unsafe { $splat(x) }
            }

            #[inline(always)]
            unsafe fn plus_product(self, a: Self, b: Self) -> Self {
                unsafe { $add(self, $mul(a, b)) }
            }

            #[inline(always)]
            unsafe fn or_zero(self) -> Self {
                unsafe { $max(self, $zero()) }
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Vector;
    use std::arch::x86_64::*;

    vector!(
        __m128,
        4,
        _mm_loadu_ps,
        _mm_storeu_ps,
        _mm_set1_ps,
        _mm_add_ps,
        _mm_mul_ps,
        _mm_max_ps,
        _mm_setzero_ps
    );
    vector!(
        __m256,
        8,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_set1_ps,
        _mm256_add_ps,
        _mm256_mul_ps,
        _mm256_max_ps,
        _mm256_setzero_ps
    );
    vector!(
        __m512,
        16,
        _mm512_loadu_ps,
        _mm512_storeu_ps,
        _mm512_set1_ps,
        _mm512_add_ps,
        _mm512_mul_ps,
        _mm512_max_ps,
        _mm512_setzero_ps
    );
}

/// NEON: the bits of SSE2.
#[cfg(target_arch = "aarch64")]
mod neon {
    use super::Vector;
    use std::arch::aarch64::*;

    #[inline(always)]
    unsafe fn zero() -> float32x4_t {
        unsafe { vdupq_n_f32(0.0) }
    }

    vector!(float32x4_t, 4, vld1q_f32, vst1q_f32, vdupq_n_f32, vaddq_f32, vmulq_f32, vmaxnmq_f32, zero);
}

/// simd128: the bits of SSE2.
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm {
    use super::Vector;
    use std::arch::wasm32::*;

    #[inline(always)]
    unsafe fn load(from: *const f32) -> v128 {
        // SAFETY: the caller lets four numbers be read
        unsafe { v128_load(from.cast()) }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, x: v128) {
        // SAFETY: as above, for writing
        unsafe { v128_store(to.cast(), x) }
    }

    #[inline(always)]
    fn zero() -> v128 {
        f32x4_splat(0.0)
    }

    #[inline(always)]
    fn greater(a: v128, b: v128) -> v128 {
        f32x4_pmax(b, a)
    }

    vector!(v128, 4, load, store, f32x4_splat, f32x4_add, f32x4_mul, greater, zero);
}

/// The vector of processors of other families.
#[cfg(target_arch = "aarch64")]
type Four = std::arch::aarch64::float32x4_t;
/// The vector of processors of other families.
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
type Four = std::arch::wasm32::v128;
/// The vector of processors of other families.
#[cfg(not(any(
    target_arch = "x86_64",
    target_arch = "aarch64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
type Four = Plain;

/// Four numbers in plain Rust, of which compilers make scalar sums at best.
#[derive(Clone, Copy)]
#[cfg_attr(
    any(target_arch = "x86_64", target_arch = "aarch64", target_arch = "wasm32"),
    allow(dead_code, reason = "of other processors, and of tests")
)]
pub(super) struct Plain([f32; 4]);

impl Vector for Plain {
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller lets four numbers be read; the read needs no alignment
        Self(unsafe { from.cast::<[f32; 4]>().read_unaligned() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as above, for writing
        unsafe { to.cast::<[f32; 4]>().write_unaligned(self.0) }
    }

    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Self([x; 4])
    }

    #[inline(always)]
    unsafe fn plus_product(self, a: Self, b: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + a.0[i] * b.0[i]))
    }

    #[inline(always)]
    unsafe fn or_zero(self) -> Self {
        Self(self.0.map(|x| if x > 0.0 { x } else { 0.0 }))
    }
}
