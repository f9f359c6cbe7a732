//! Vectors of each instruction set, the matrix product on them, and the dispatch: every line of `unsafe` of this crate.
//!
//! A product is never fused with its addition, so all levels, and processors of other families, compute the same bits.

#![allow(unsafe_code, reason = "intrinsics; the one public function checks every bound before it")]

use super::shape::{PANEL, Product};
use std::cell::Cell;
use std::sync::OnceLock;

/// Which instructions are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
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
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "other processors have one")]
        let mut levels = vec![Self::Base];
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            if has!("avx2") {
                levels.push(Self::Avx2);
            }
            if has!("avx2") && has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq") {
                levels.push(Self::Avx512);
            }
        }
        levels
    }
}

/// Work that is compiled once per level.
pub(super) trait Work {
    type Out;

    /// Must be `#[inline(always)]`, and so must be what it calls.
    fn run(self) -> Self::Out;
}

/// Runs work compiled for a level. The level must be one that this processor has.
pub(super) fn at_level<W: Work>(level: Checked, work: W) -> W::Out {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2<W: Work>(work: W) -> W::Out {
            work.run()
        }
        #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq")]
        fn avx512<W: Work>(work: W) -> W::Out {
            work.run()
        }
        match level.0 {
            Level::Base => work.run(),
            // SAFETY: a `Checked` level is one that the processor was asked for
            Level::Avx2 => unsafe { avx2(work) },
            // SAFETY: as above
            Level::Avx512 => unsafe { avx512(work) },
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = level;
        work.run()
    }
}

/// A level that this processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Checked(Level);

impl Checked {
    /// A level, or the widest below it that the processor has.
    pub fn at_most(level: Level) -> Self {
        let levels = Level::available();
        Self(if levels.contains(&level) { level } else { levels[levels.len() - 1] })
    }

    /// The one that this thread computes with: the widest, unless [`with_level`] says otherwise.
    pub fn now() -> Self {
        static WIDEST: OnceLock<Checked> = OnceLock::new();
        HELD.get()
            .unwrap_or_else(|| *WIDEST.get_or_init(|| Self(Level::available().pop().unwrap_or(Level::Base))))
    }
}

thread_local! {
    static HELD: Cell<Option<Checked>> = const { Cell::new(None) };
}

/// Computes with the instructions of a level at most, on this thread: the bits are those of all others.
pub fn with_level<T>(level: Level, work: impl FnOnce() -> T) -> T {
    let before = HELD.replace(Some(Checked::at_most(level)));
    let made = work();
    HELD.set(before);
    made
}

/// A vector of `LANES` numbers.
trait Vector: Copy {
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

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Vector;
    use std::arch::x86_64::*;

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

/// Four numbers in plain Rust, which compilers turn into NEON or simd128.
#[derive(Clone, Copy)]
#[cfg_attr(target_arch = "x86_64", allow(dead_code, reason = "of other processors, and of tests"))]
struct Plain([f32; 4]);

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

/// Computes a product at a level.
///
/// # Panics
/// Where a row of either side or a column of weights lies outside of its slice: a mistake of this crate.
pub(super) fn multiply(
    level: Checked,
    p: &Product,
    rows: &[f32],
    columns: &[f32],
    bias: Option<&[f32]>,
    out: &mut [f32],
) {
    if p.rows == 0 || p.panels == 0 {
        return;
    }
    assert!(p.fits(rows.len(), columns.len(), bias.map(<[f32]>::len), out.len()), "a product out of bounds");
    let (a, b, c) = (rows.as_ptr(), columns.as_ptr(), out.as_mut_ptr());
    let bias = bias.map_or(std::ptr::null(), <[f32]>::as_ptr);
    // SAFETY of all: `fits` has compared the farthest number of each side with its length, and the level was asked for
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{__m128, __m256, __m512};
        #[target_feature(enable = "avx2")]
        unsafe fn avx2(p: &Product, a: *const f32, b: *const f32, bias: *const f32, c: *mut f32) {
            unsafe { product::<__m256, 6>(p, a, b, bias, c) }
        }
        #[target_feature(enable = "avx512f,avx512vl,avx512bw,avx512dq")]
        unsafe fn avx512(p: &Product, a: *const f32, b: *const f32, bias: *const f32, c: *mut f32) {
            unsafe { product::<__m512, 12>(p, a, b, bias, c) }
        }
        match level.0 {
            Level::Base => unsafe { product::<__m128, 6>(p, a, b, bias, c) },
            Level::Avx2 => unsafe { avx2(p, a, b, bias, c) },
            Level::Avx512 => unsafe { avx512(p, a, b, bias, c) },
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = level;
        unsafe { product::<Plain, 4>(p, a, b, bias, c) }
    }
}

/// The columns of a product, two vectors at a time.
///
/// # Safety
/// The processor has the instructions of `V`; the product fits its slices.
#[inline(always)]
unsafe fn product<V: Vector, const ROWS: usize>(
    p: &Product,
    a: *const f32,
    b: *const f32,
    bias: *const f32,
    c: *mut f32,
) {
    let columns = p.panels * PANEL;
    let mut column = 0;
    // SAFETY: columns stay below their number, which is a multiple of every width
    unsafe {
        while column + 2 * V::LANES <= columns {
            all_rows::<V, ROWS, 2>(p, column, a, b, bias, c);
            column += 2 * V::LANES;
        }
        while column < columns {
            all_rows::<V, ROWS, 1>(p, column, a, b, bias, c);
            column += V::LANES;
        }
    }
}

/// `WIDE` vectors of columns of all rows.
///
/// # Safety
/// As [`product`].
#[inline(always)]
unsafe fn all_rows<V: Vector, const ROWS: usize, const WIDE: usize>(
    p: &Product,
    column: usize,
    a: *const f32,
    b: *const f32,
    bias: *const f32,
    c: *mut f32,
) {
    let mut row = 0;
    // SAFETY: rows stay below their number
    unsafe {
        while row + ROWS <= p.rows {
            tile::<V, ROWS, WIDE>(p, row, column, a, b, bias, c);
            row += ROWS;
        }
        while row + 4 <= p.rows {
            tile::<V, 4, WIDE>(p, row, column, a, b, bias, c);
            row += 4;
        }
        while row + 2 <= p.rows {
            tile::<V, 2, WIDE>(p, row, column, a, b, bias, c);
            row += 2;
        }
        if row < p.rows {
            tile::<V, 1, WIDE>(p, row, column, a, b, bias, c);
        }
    }
}

/// `ROWS` rows by `WIDE` vectors: every number is one chain of sums over its inputs, in their order.
///
/// # Safety
/// As [`product`]; rows and columns of the tile are there.
#[inline(always)]
unsafe fn tile<V: Vector, const ROWS: usize, const WIDE: usize>(
    p: &Product,
    row: usize,
    column: usize,
    a: *const f32,
    b: *const f32,
    bias: *const f32,
    c: *mut f32,
) {
    // SAFETY: `Product::fits` holds for all places that are formed here
    unsafe {
        let mut from = [a; ROWS];
        let mut to = [c; ROWS];
        for i in 0..ROWS {
            from[i] = a.add(p.from.at(row + i));
            to[i] = c.add(p.to.at(row + i) + column);
        }
        let mut first = [b; WIDE];
        let mut sums = [[V::splat(0.0); WIDE]; ROWS];
        for j in 0..WIDE {
            let at = column + j * V::LANES;
            first[j] = b.add(at / PANEL * p.panel_step + at % PANEL);
            if !bias.is_null() {
                let start = V::load(bias.add(at));
                for i in 0..ROWS {
                    sums[i][j] = start;
                }
            }
        }
        let mut step = 0;
        for run in 0..p.runs {
            let mut at = run * p.run_step;
            for _ in 0..p.length {
                let mut weights = [V::splat(0.0); WIDE];
                for j in 0..WIDE {
                    weights[j] = V::load(first[j].add(step));
                }
                for i in 0..ROWS {
                    let x = V::splat(*from[i].add(at));
                    for j in 0..WIDE {
                        sums[i][j] = sums[i][j].plus_product(x, weights[j]);
                    }
                }
                step += p.weight_step;
                at += p.input_step;
            }
        }
        for i in 0..ROWS {
            for j in 0..WIDE {
                let sum = if p.relu { sums[i][j].or_zero() } else { sums[i][j] };
                sum.store(to[i].add(j * V::LANES));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_vectors_compute_what_those_of_the_processor_do() {
        let (p, a, b) = super::super::shape::tests::example(7, 33, 5);
        let (mut plain, mut own) = (vec![0.0; 7 * 80], vec![0.0; 7 * 80]);
        let bias: Vec<f32> = (0..80).map(|i| i as f32 * 0.1 - 3.0).collect();
        multiply(Checked::at_most(Level::Base), &p, &a, &b, Some(&bias), &mut own);
        assert!(p.fits(a.len(), b.len(), Some(80), plain.len()));
        // SAFETY: it fits
        unsafe { product::<Plain, 4>(&p, a.as_ptr(), b.as_ptr(), bias.as_ptr(), plain.as_mut_ptr()) };
        assert_eq!(plain, own);
    }
}
