//! The product of rows and packed weights, in tiles that stay in registers.
//!
//! Plans never fuse a product with its addition, so all levels, and processors of other families, compute the same bits.

#![allow(unsafe_code, reason = "pointers into a product, whose bounds `multiply` has checked")]

use super::shape::{PANEL, Product};
use super::simd::{Vector, Work, at_level};

/// Computes a product.
///
/// # Panics
/// Where a row of either side or a column of weights lies outside of its slice: a mistake of this crate.
pub(super) fn multiply(p: &Product, rows: &[f32], columns: &[f32], bias: Option<&[f32]>, out: &mut [f32]) {
    if p.rows == 0 || p.panels == 0 {
        return;
    }
    let fits = p.fits(rows.len(), columns.len(), bias.map(<[f32]>::len), out.len());
    assert!(fits, "a product out of bounds");
    let sides = Sides {
        a: rows.as_ptr(),
        b: columns.as_ptr(),
        bias: bias.map_or(std::ptr::null(), <[f32]>::as_ptr),
        c: out.as_mut_ptr(),
    };
    at_level(Multiply(p, sides));
}

/// A product that fits its slices.
struct Multiply<'a>(&'a Product, Sides);

impl Work for Multiply<'_> {
    #[inline(always)]
    fn run<V: Vector, const ROWS: usize>(self) {
        // SAFETY: `fits` has compared the farthest number of each side with its length, and the processor has the level
        unsafe { product::<V, ROWS>(self.0, self.1) }
    }
}

/// Where the sides of a product lie: rows, weights, bias (null without), results.
#[derive(Clone, Copy)]
struct Sides {
    a: *const f32,
    b: *const f32,
    bias: *const f32,
    c: *mut f32,
}

/// The columns of a product, two vectors at a time.
///
/// # Safety
/// The processor has the instructions of `V`; the product fits its slices.
#[inline(always)]
unsafe fn product<V: Vector, const ROWS: usize>(p: &Product, s: Sides) {
    let columns = p.panels * PANEL;
    let mut column = 0;
    // SAFETY: columns stay below their number, which is a multiple of every width
    unsafe {
        while column + 2 * V::LANES <= columns {
            all_rows::<V, ROWS, 2>(p, column, s);
            column += 2 * V::LANES;
        }
        while column < columns {
            all_rows::<V, ROWS, 1>(p, column, s);
            column += V::LANES;
        }
    }
}

/// `WIDE` vectors of columns of all rows.
///
/// # Safety
/// As [`product`].
#[inline(always)]
unsafe fn all_rows<V: Vector, const ROWS: usize, const WIDE: usize>(p: &Product, column: usize, s: Sides) {
    let mut row = 0;
    // SAFETY: rows stay below their number
    unsafe {
        while row + ROWS <= p.rows {
            tile::<V, ROWS, WIDE>(p, row, column, s);
            row += ROWS;
        }
        while row + 4 <= p.rows {
            tile::<V, 4, WIDE>(p, row, column, s);
            row += 4;
        }
        while row + 2 <= p.rows {
            tile::<V, 2, WIDE>(p, row, column, s);
            row += 2;
        }
        if row < p.rows {
            tile::<V, 1, WIDE>(p, row, column, s);
        }
    }
}

/// `ROWS` rows by `WIDE` vectors of columns. Every number is one chain of sums over its inputs, in their order.
///
/// # Safety
/// As [`product`]; rows and columns of the tile are there.
#[inline(always)]
unsafe fn tile<V: Vector, const ROWS: usize, const WIDE: usize>(
    p: &Product,
    row: usize,
    column: usize,
    s: Sides,
) {
    // SAFETY: `Product::fits` holds for all places that are formed here
    unsafe {
        let (mut from, mut weights) = ([s.a; ROWS], [s.b; WIDE]);
        let mut sums = [[V::splat(0.0); WIDE]; ROWS];
        for i in 0..ROWS {
            from[i] = s.a.add((row + i) * p.from);
        }
        for j in 0..WIDE {
            let at = column + j * V::LANES;
            weights[j] = s.b.add(at / PANEL * p.panel_step + at % PANEL);
            if !s.bias.is_null() {
                let start = V::load(s.bias.add(at));
                for i in 0..ROWS {
                    sums[i][j] = start;
                }
            }
        }
        for input in 0..p.length {
            let mut by = [V::splat(0.0); WIDE];
            for j in 0..WIDE {
                by[j] = V::load(weights[j].add(input * p.weight_step));
            }
            for i in 0..ROWS {
                let x = V::splat(*from[i].add(input * p.input_step));
                for j in 0..WIDE {
                    sums[i][j] = sums[i][j].plus_product(x, by[j]);
                }
            }
        }
        for i in 0..ROWS {
            let to = s.c.add((row + i) * p.to + column);
            for j in 0..WIDE {
                let sum = if p.relu { sums[i][j].or_zero() } else { sums[i][j] };
                sum.store(to.add(j * V::LANES));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Level, Plain, at};
    use super::*;

    #[test]
    fn every_level_computes_what_plain_vectors_do() {
        let (p, a, b) = super::super::shape::tests::example(7, 33, 5);
        let bias: Vec<f32> = (0..80).map(|i| i as f32 * 0.1 - 3.0).collect();
        let mut plain = vec![0.0; 7 * 80];
        assert!(p.fits(a.len(), b.len(), Some(80), plain.len()));
        let sides = Sides { a: a.as_ptr(), b: b.as_ptr(), bias: bias.as_ptr(), c: plain.as_mut_ptr() };
        // SAFETY: it fits
        unsafe { product::<Plain, 4>(&p, sides) };
        for level in Level::available() {
            let mut own = vec![0.0; 7 * 80];
            at(level, Multiply(&p, Sides { c: own.as_mut_ptr(), ..sides }));
            assert_eq!(plain, own, "{level:?}");
        }
    }
}
