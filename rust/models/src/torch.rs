//! The backend on libtorch: with gradients, on any device.

use crate::batch::Batch;
use crate::config::{HistoryTokens, ModelConfig};
use crate::slots::{Slots, mix, weights};
use ccdiff_nets::compute::backend::{Backend, KeyValue};
use ccdiff_nets::compute::cpu::Cpu;
use ccdiff_nets::compute::numbers::{self, Array};
use ccdiff_nets::networks::latents::{Decoder, Pulls};
use ccdiff_nets::networks::trunk::Encoded;
use ccdiff_nets::sampling::plan_space::PlanSpace;
use std::ops::Range;
use tch::{Device, Kind, Tensor, nn};

/// Layers on libtorch.
#[derive(Debug)]
pub struct Torch;

/// A linear layer over [token, edge] and the width of a token.
#[derive(Debug)]
pub struct Joint(pub(crate) nn::Linear, i64);

/// Tokens [R, T, d] by heads, [R, h, T, d/h].
fn split(x: &Tensor, heads: i64) -> Tensor {
    let size = x.size();
    x.view([size[0], size[1], heads, -1]).transpose(1, 2)
}

impl Backend for Torch {
    type Tensor = Tensor;
    type Linear = nn::Linear;
    type Joint = Joint;
    type Norm = nn::LayerNorm;
    type Slots = Slots;
    type Attention = Tensor;
    type Path<'a> = nn::Path<'a>;
    type Filter = nn::Conv1D;
    type Groups = nn::GroupNorm;
    type Batch<'a> = Batch;

    fn sub<'a>(p: &Self::Path<'a>, name: &str) -> Self::Path<'a> {
        p / name
    }

    fn linear(p: &nn::Path<'_>, inputs: i64, outputs: i64) -> nn::Linear {
        nn::linear(p, inputs, outputs, Default::default())
    }

    fn zero_linear(p: &nn::Path<'_>, inputs: i64, outputs: i64) -> nn::Linear {
        let zero = nn::Init::Const(0.0);
        nn::linear(p, inputs, outputs, nn::LinearConfig { ws_init: zero, bs_init: Some(zero), bias: true })
    }

    fn joint(p: &nn::Path<'_>, token: i64, edge: i64, outputs: i64) -> Joint {
        Joint(Self::linear(p, token + edge, outputs), token)
    }

    fn norm(p: &nn::Path<'_>, width: i64) -> nn::LayerNorm {
        nn::layer_norm(p, vec![width], Default::default())
    }

    fn table(p: &nn::Path<'_>, numbers: &[f32], width: i64) -> Tensor {
        Tensor::from_slice(numbers).view([1, -1, width]).to_device(p.device())
    }

    fn numbers(x: &Tensor) -> Vec<f32> {
        to_vec(x)
    }

    fn layer(layer: &nn::Linear, x: &Tensor, relu: bool) -> Tensor {
        let y = x.apply(layer);
        if relu { y.relu() } else { y }
    }

    fn apply_joint(Joint(layer, width): &Joint, tokens: &Tensor, edges: &Tensor) -> KeyValue<Self> {
        let edge_width = layer.ws.size()[1] - width;
        let of_token = tokens.linear(&layer.ws.narrow(1, 0, *width), layer.bs.as_ref());
        let of_edge = edges.linear(&layer.ws.narrow(1, *width, edge_width), None::<&Tensor>);
        (of_token, of_edge)
    }

    fn normed(norm: &nn::LayerNorm, x: &Tensor, relu: bool) -> Tensor {
        let y = x.apply(norm);
        if relu { y.relu() } else { y }
    }

    fn sum_normed(norm: &nn::LayerNorm, x: &Tensor, y: Tensor) -> Tensor {
        (x + y).apply(norm)
    }

    fn sum(x: Tensor, y: &Tensor) -> Tensor {
        x + y
    }

    fn cut(x: &Tensor, width: i64) -> Tensor {
        x.reshape([x.size()[0], -1, width])
    }

    fn columns(x: &Tensor, from: i64, count: i64) -> Tensor {
        x.narrow(-1, from, count)
    }

    fn beside(x: &Tensor, y: &Tensor) -> Tensor {
        Tensor::cat(&[x, y], -1)
    }

    fn scaled(x: &Tensor, factor: &Tensor) -> Tensor {
        x * factor
    }

    fn greatest(x: &Tensor) -> Tensor {
        x.amax([1i64].as_slice(), true)
    }

    fn rows_of(table: &Tensor, steps: &[usize]) -> Tensor {
        let steps: Vec<i64> = steps.iter().map(|step| *step as i64).collect();
        table.index_select(1, &Tensor::from_slice(&steps).to_device(table.device())).transpose(0, 1)
    }

    fn mish(x: &Tensor) -> Tensor {
        x.mish()
    }

    fn attend(q: &Tensor, (k, v): (&Tensor, &Tensor), heads: i64, slots: Option<&Slots>) -> Tensor {
        let [q, k, v] = [q, k, v].map(|x| split(x, heads));
        let mask = slots.and_then(|slots| slots.tokens.as_ref());
        let y = Tensor::scaled_dot_product_attention(&q, &k, &v, mask, 0.0, false, None, false);
        y.transpose(1, 2).flatten(2, 3)
    }

    fn attend_across(
        q: &Tensor,
        (k, v): &KeyValue<Self>,
        edges: Option<&KeyValue<Self>>,
        slots: &Slots,
        heads: i64,
    ) -> (Tensor, Tensor) {
        let (k, v) = (slots.gather(k), slots.gather(v));
        let (k, v, seen) = match edges {
            Some((k_edge, v_edge)) => (k + k_edge, v + v_edge, &slots.others_or_self),
            None => (k, v, &slots.with_self),
        };
        let attention = weights(q, &k, seen, heads);
        (mix(&attention, &v), attention)
    }

    fn gated(a: &Tensor, g: &Tensor, h: &Tensor, own: Tensor) -> Tensor {
        let gate = (g + h).sigmoid();
        a + gate * (own - a)
    }

    fn plan(space: &PlanSpace, noisy: &Tensor, speed: &Tensor) -> Tensor {
        let knots = Array::new(noisy.size()[1] as usize, 2, to_vec(noisy));
        tensor(Cpu::plan(space, &knots, &Array::new(1, 1, to_vec(speed))), noisy.device())
    }

    fn stream(history: &Tensor, plan: Tensor, carried: bool, steps: Tensor) -> Tensor {
        let plan = if carried { plan + history } else { plan };
        Tensor::cat(&[history, &plan], 1) + steps
    }

    fn last(x: &Tensor, count: i64) -> Tensor {
        x.narrow(-2, x.size()[x.dim() - 2] - count, count)
    }

    fn mean_attention(samples: &[Tensor], _: &Slots, tokens: Range<usize>) -> Vec<f32> {
        // samples, rows, slots, tokens, heads
        let plan = Tensor::stack(samples, 0).narrow(3, tokens.start as i64, tokens.len() as i64);
        to_vec(&plan.mean_dim([0i64, 3, 4].as_slice(), false, Kind::Float))
    }

    fn plain(batch: &Batch) -> numbers::Batch<'_> {
        batch.numbers()
    }

    fn alone<'a>(batch: &Self::Batch<'a>) -> Self::Batch<'a> {
        batch.clone().with_graph_dropped(|_| true)
    }

    fn placed(batch: &Batch, x: Array) -> Tensor {
        tensor(x, batch.device)
    }

    fn edges(batch: &Batch, config: &ModelConfig, moved: bool) -> (Tensor, Slots) {
        let (edges, slots) = Slots::at_tokens(&batch.neighbourhood(), config, moved);
        if config.history == HistoryTokens::Summary {
            return (edges, slots);
        }
        let past = tensor(batch.numbers().history(config), batch.device).select(2, 7).gt(0.5);
        let future = past.narrow(1, config.history_steps as i64 - 1, 1);
        let future = future.expand([-1, config.num_knots() as i64], false);
        let tokens = Tensor::cat(&[past, future], 1).unsqueeze(1).unsqueeze(1);
        (edges, Slots { tokens: Some(tokens), ..slots })
    }

    fn filter(p: &nn::Path<'_>, inputs: i64, outputs: i64, kernel: i64, stride: i64) -> nn::Conv1D {
        let config = nn::ConvConfig { stride, padding: kernel / 2, ..Default::default() };
        nn::conv1d(p, inputs, outputs, kernel, config)
    }

    fn groups(p: &nn::Path<'_>, groups: i64, width: i64) -> nn::GroupNorm {
        nn::group_norm(p, groups, width, Default::default())
    }

    fn filtered(filter: &nn::Conv1D, x: &Tensor) -> Tensor {
        x.transpose(1, 2).apply(filter).transpose(1, 2)
    }

    fn groups_mish(norm: &nn::GroupNorm, x: Tensor) -> Tensor {
        x.transpose(1, 2).apply(norm).mish().transpose(1, 2)
    }
}

impl Pulls for Torch {
    type Back = ();

    fn turned(_: &Decoder<Torch>) {}

    fn pulled(
        decoder: &Decoder<Torch>,
        _: &(),
        seen: &Encoded<Torch>,
        z: &Tensor,
        of_knots: &[f32],
    ) -> Vec<f32> {
        tch::with_grad(|| {
            let leaf = z.detach().copy().set_requires_grad(true);
            let knots = decoder.forward(seen, &leaf);
            let fixed = Tensor::from_slice(of_knots).view_as(&knots).to_device(z.device());
            (knots * fixed).sum(Kind::Float).backward();
            to_vec(&leaf.grad())
        })
    }
}

pub(crate) fn tensor(x: Array, device: Device) -> Tensor {
    Tensor::from_slice(&x.numbers).view([-1, x.tokens as i64, x.width as i64]).to_device(device)
}

/// The numbers of a tensor.
pub(crate) fn to_vec(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.to_device(Device::Cpu).contiguous();
    let count = flat.numel();
    let mut values = vec![0f32; count];
    flat.view([-1]).copy_data(&mut values, count);
    values
}
