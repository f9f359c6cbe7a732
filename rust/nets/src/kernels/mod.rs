//! The arithmetic of layers. A number is one chain of sums over its inputs in their order, never fused with products, so it has
//! the same bits whatever the batch, the threads and the instructions are.

mod attention;
mod groups;
mod product;
mod rows;
mod shape;
mod simd;
mod tile;

pub(crate) use attention::{Seen, mix};
pub(crate) use groups::groups_mish;
pub use product::Packed;
pub(crate) use product::{Strided, convolve, filter, linear, matmul};
pub(crate) use rows::{
    add, add_cycle, add_norm, gate, most, norm, pixels, pixels_under, softmax_columns, transpose,
};
pub(crate) use shape::PANEL;
pub use simd::{Checked, Level, with_level};
