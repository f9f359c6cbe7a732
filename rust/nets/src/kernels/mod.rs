//! The arithmetic of layers. A number is one chain of sums over its inputs in their order, never fused with products, so it has
//! the same bits whatever the batch, the threads and the instructions are.

mod attention;
mod product;
mod rows;
mod shape;
mod simd;
mod tile;
mod within;

pub use attention::{Mix, Seen, mix};
pub use product::{Packed, linear};
pub use rows::{add_cycle, gate, norm};
pub(crate) use rows::{add_norm, groups_mish, most};
pub use shape::PANEL;
pub use within::Within;
