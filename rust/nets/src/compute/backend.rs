//! The operations that layers are made of, and the inputs of networks. A network is defined once over them; a backend computes them in
//! its own way.
//!
//! Two backends: [`crate::compute::cpu::Cpu`], on the kernels of this crate, and that of `ccdiff-models` on libtorch, with gradients.

use crate::compute::numbers::{Array, Batch};
use crate::config::ModelConfig;
use crate::sampling::plan_space::PlanSpace;
use std::fmt::Debug;
use std::ops::Range;

/// Keys and values.
pub type KeyValue<B> = (<B as Backend>::Tensor, <B as Backend>::Tensor);

/// What computes a network: the layers, operations and inputs that it is defined over. Tensors are [rows, tokens, width] unless a shape
/// is given.
pub trait Backend: Debug + Sized {
    /// Numbers.
    type Tensor: Debug;
    /// A linear layer.
    type Linear: Debug;
    /// A linear layer over a token joined with an edge, split at the joint.
    type Joint: Debug;
    /// A layer norm.
    type Norm: Debug;
    /// The rows in the slots of each row, and which of their tokens may be seen.
    type Slots: Debug;
    /// Attention weights between rows.
    type Attention: Debug;
    /// Where the numbers of a layer come from.
    type Path<'a>;
    /// Inputs of all rows.
    type Batch<'a>;
    /// A convolution over the tokens of a row.
    type Filter: Debug;
    /// A group norm.
    type Groups: Debug;

    /// The place of a part within a place.
    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a>;

    /// A linear layer.
    fn linear(p: &Self::Path<'_>, inputs: i64, outputs: i64) -> Self::Linear;

    /// A linear layer whose first weights are zero, where it is to be trained.
    fn zero_linear(p: &Self::Path<'_>, inputs: i64, outputs: i64) -> Self::Linear {
        Self::linear(p, inputs, outputs)
    }

    /// A linear layer over [token, edge].
    fn joint(p: &Self::Path<'_>, token: i64, edge: i64, outputs: i64) -> Self::Joint;

    /// A layer norm.
    fn norm(p: &Self::Path<'_>, width: i64) -> Self::Norm;

    /// A table that is not learned, [1, rows, width].
    fn table(p: &Self::Path<'_>, numbers: &[f32], width: i64) -> Self::Tensor;

    /// The numbers of a tensor, row by row.
    fn numbers(x: &Self::Tensor) -> Vec<f32>;

    /// A linear layer on tokens, then ReLU if asked for.
    fn layer(layer: &Self::Linear, x: &Self::Tensor, relu: bool) -> Self::Tensor;

    /// A linear layer on tokens.
    fn apply(layer: &Self::Linear, x: &Self::Tensor) -> Self::Tensor {
        Self::layer(layer, x, false)
    }

    /// A linear layer on tokens, then ReLU.
    fn apply_relu(layer: &Self::Linear, x: &Self::Tensor) -> Self::Tensor {
        Self::layer(layer, x, true)
    }

    /// The part of a joint layer that tokens have, and the one that edges have.
    fn apply_joint(layer: &Self::Joint, tokens: &Self::Tensor, edges: &Self::Tensor) -> KeyValue<Self>;

    /// A layer norm, then ReLU if asked for.
    fn normed(norm: &Self::Norm, x: &Self::Tensor, relu: bool) -> Self::Tensor;

    /// A layer norm of x + y.
    fn sum_normed(norm: &Self::Norm, x: &Self::Tensor, y: Self::Tensor) -> Self::Tensor;

    /// x + y; rows, or the tokens of a row, may share one of y.
    fn sum(x: Self::Tensor, y: &Self::Tensor) -> Self::Tensor;

    /// The numbers of each row in tokens of another width.
    fn cut(x: &Self::Tensor, width: i64) -> Self::Tensor;

    /// Some of the numbers of each token.
    fn columns(x: &Self::Tensor, from: i64, count: i64) -> Self::Tensor;

    /// The numbers of each token of x, then those of y.
    fn beside(x: &Self::Tensor, y: &Self::Tensor) -> Self::Tensor;

    /// Each row times its factor [R, 1, 1].
    fn scaled(x: &Self::Tensor, factor: &Self::Tensor) -> Self::Tensor;

    /// The greatest numbers among all tokens of a row, [R, 1, width].
    fn greatest(x: &Self::Tensor) -> Self::Tensor;

    /// The rows of a table [1, steps, width] that the steps of the rows name, [R, 1, width]; without gradients all have one, and it
    /// is given once.
    fn rows_of(table: &Self::Tensor, steps: &[usize]) -> Self::Tensor;

    /// x · tanh(ln(1 + exp x)).
    fn mish(x: &Self::Tensor) -> Self::Tensor;

    /// Softmax attention of queries over keys and values of the same row, with slots over those tokens that may be seen.
    fn attend(
        q: &Self::Tensor,
        kv: (&Self::Tensor, &Self::Tensor),
        heads: i64,
        slots: Option<&Self::Slots>,
    ) -> Self::Tensor;

    /// Attention of every token over the same token of the rows in its slots: with edges, which add to keys and values, of the
    /// others, or of itself where there are none; without edges of itself and the others.
    fn attend_across(
        q: &Self::Tensor,
        kv: &KeyValue<Self>,
        edges: Option<&KeyValue<Self>>,
        slots: &Self::Slots,
        heads: i64,
    ) -> (Self::Tensor, Self::Attention);

    /// a + sigmoid(g + h) · (own - a).
    fn gated(a: &Self::Tensor, g: &Self::Tensor, h: &Self::Tensor, own: Self::Tensor) -> Self::Tensor;

    /// Standardised states of noisy knots [R, knots, 2], which depend on no weight, from speeds [R], those of a knot in one token.
    fn plan(space: &PlanSpace, noisy: &Self::Tensor, speed: &Self::Tensor) -> Self::Tensor;

    /// Tokens of the history, then those of the plan, each plus its row of the embedded steps. With `carried`, the history's token is
    /// added to those of the plan.
    fn stream(history: &Self::Tensor, plan: Self::Tensor, carried: bool, steps: Self::Tensor)
    -> Self::Tensor;

    /// The last tokens of every row.
    fn last(x: &Self::Tensor, count: i64) -> Self::Tensor;

    /// Attention [R, K] between rows, mean over samples, heads and these tokens; backends for training have none.
    fn mean_attention(_: &[Self::Attention], _: &Self::Slots, _: Range<usize>) -> Vec<f32> {
        Vec::new()
    }

    /// The same in plain numbers.
    fn plain<'a>(batch: &'a Self::Batch<'_>) -> Batch<'a>;

    /// The same rows, each of which sees itself alone.
    fn alone<'a>(batch: &Self::Batch<'a>) -> Self::Batch<'a>;

    /// Numbers where those of a batch are.
    fn placed(batch: &Self::Batch<'_>, x: Array) -> Self::Tensor;

    /// Edges of the slots, normalised, [.., 8], at every token or, if they are not moved on, now alone; and the slots.
    fn edges(batch: &Self::Batch<'_>, config: &ModelConfig, moved: bool) -> (Self::Tensor, Self::Slots);

    /// A convolution of so many tokens, an odd number, every `stride` of them.
    fn filter(p: &Self::Path<'_>, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> Self::Filter;

    /// A group norm over the tokens of a row.
    fn groups(p: &Self::Path<'_>, groups: i64, width: i64) -> Self::Groups;

    /// A convolution, with zeros beyond both ends.
    fn filtered(filter: &Self::Filter, x: &Self::Tensor) -> Self::Tensor;

    /// A group norm, then Mish.
    fn groups_mish(norm: &Self::Groups, x: Self::Tensor) -> Self::Tensor;
}
