//! Sampling plans of networks on torch: their tensors as the numbers that [`ccdiff_nets::sampling::sampler`] works on.

pub use ccdiff_nets::sampling::sampler::{Rows, SampleOptions};

use crate::batch::Batch;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::schedule::Schedule;
use crate::tape::Tape;
use crate::torch::{Torch, to_vec};
use ccdiff_nets::networks::ccdiff::{Context, Network};
use ccdiff_nets::networks::ctg::{Condition, HalfUnet};
use ccdiff_nets::networks::planner::Denoises;
use ccdiff_nets::sampling::sampler::{self, Draws, Predict};
use std::fmt::Debug;
use tch::{Device, Kind, Tensor};

/// A network from noisy plans to clean ones, of which samples are drawn at once.
pub trait Denoiser: Denoises<Torch> + Send {
    /// The same network on the tape.
    type Taped: Denoises<Tape>;

    /// The same context for N samples: rows are repeated sample by sample, [N · R].
    fn repeated(context: &Self::Context, samples: i64) -> Self::Context;
}

/// What a sampling run gives.
#[derive(Debug)]
pub struct Samples {
    /// Clean normalised knots [N · R, knots, 2], sample by sample.
    pub knots: Tensor,
    /// Attention of the last denoising step's conditional pass in the first edge-aware layer, mean of heads,
    /// [N · R, K, tokens]; `None` for a network without it.
    pub attention: Option<Tensor>,
}

/// A network on a batch that it has encoded.
struct Encoded<'a, D: Denoiser> {
    network: &'a D,
    with_graph: D::Context,
    alone: Option<D::Context>,
    size: [i64; 3],
    device: Device,
    attention: Option<Tensor>,
}

impl<D: Denoiser> Predict for Encoded<'_, D> {
    fn predict(&mut self, noisy: &[f32], step: usize, alone: bool) -> Vec<f32> {
        let noisy = Tensor::from_slice(noisy).view(self.size).to_device(self.device);
        let steps = Tensor::full([self.size[0]], step as i64, (Kind::Int64, self.device));
        match self.alone.as_ref().filter(|_| alone) {
            Some(context) => to_vec(&self.network.predict(context, &noisy, &steps).0),
            None => {
                let (clean, attention) = self.network.predict(&self.with_graph, &noisy, &steps);
                self.attention = attention.map(|a| a.mean_dim([3i64].as_slice(), false, Kind::Float));
                to_vec(&clean)
            }
        }
    }
}

/// Draws normalised knots. `seeds` holds one seed per scene of the batch; `guide` moves the plans on the way.
///
/// # Errors
/// As [`sampler::sample`].
pub fn sample<D: Denoiser>(
    network: &D,
    schedule: &Schedule,
    batch: &Batch,
    seeds: &[u64],
    options: SampleOptions,
    guide: Option<&mut Guidance<'_>>,
) -> Result<Samples> {
    let options = options.validated()?;
    let (n, config) = (options.num_samples as i64, network.space().config());
    let encode = |b: &Batch| {
        let context = network.encode(b);
        if n == 1 { context } else { D::repeated(&context, n) }
    };
    let device = batch.speed_mps.device();
    let mut encoded = Encoded {
        network,
        with_graph: encode(batch),
        alone: (options.guidance_weight > 1.0).then(|| encode(&batch.with_identity_graph())),
        size: [n * batch.num_rows(), config.num_knots() as i64, 2],
        device,
        attention: None,
    };
    let num_knots = config.num_knots();
    let draws = Draws { schedule, rows: batch.rows(), seeds, options, num_knots };
    let knots = sampler::sample(&draws, &mut encoded, guide)?;
    let knots = Tensor::from_slice(&knots).view(encoded.size).to_device(device);
    Ok(Samples { knots, attention: encoded.attention })
}

fn repeated(t: &Tensor, samples: i64) -> Tensor {
    let mut times = vec![1; t.dim()];
    times[0] = samples;
    t.repeat(times)
}

impl Denoiser for HalfUnet<Torch> {
    type Taped = HalfUnet<Tape>;

    fn repeated(context: &Condition<Torch>, samples: i64) -> Condition<Torch> {
        let repeat = |t| repeated(t, samples);
        Condition { token: repeat(&context.token), speed: repeat(&context.speed) }
    }
}

impl Denoiser for Network<Torch> {
    type Taped = Network<Tape>;

    fn repeated(context: &Context<Torch>, samples: i64) -> Context<Torch> {
        let repeat = |t: &Tensor| repeated(t, samples);
        Context {
            history: repeat(&context.history),
            edges: repeat(&context.edges),
            slots: context.slots.repeated(samples),
            map: context.map.iter().map(|m| m.as_ref().map(|(k, v)| (repeat(k), repeat(v)))).collect(),
            mask: context.mask.as_ref().map(repeat),
            speed: repeat(&context.speed),
        }
    }
}
