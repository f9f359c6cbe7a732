//! Plans of a network that denoises, on any backend.

use crate::compute::backend::Backend;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::networks::planner::{Asked, Denoises};
use crate::sampling::sampler::{self, Draws, Predict};
use crate::sampling::schedule::Schedule;

/// What was drawn.
#[derive(Debug)]
pub struct Denoised<C, A> {
    /// Clean normalised knots [N · R, knots, 2], sample by sample.
    pub knots: Vec<f32>,
    /// Weights of the last pass with the graph, of each sample, of a network that has them.
    pub attention: Vec<A>,
    /// What does not depend on the noisy plan.
    pub context: C,
}

/// A network on a batch that it has encoded.
struct Encoded<'a, B: Backend, N: Denoises<B>> {
    network: &'a N,
    with_graph: N::Context,
    alone: Option<N::Context>,
    speed: B::Tensor,
    rows: usize,
    attention: Vec<B::Attention>,
}

impl<B: Backend, N: Denoises<B>> Predict for Encoded<'_, B, N> {
    fn predict(&mut self, noisy: &[f32], step: usize, alone: bool) -> Vec<f32> {
        let context = self.alone.as_ref().filter(|_| alone).unwrap_or(&self.with_graph);
        if !alone {
            self.attention.clear();
        }
        let knots = self.network.config().num_knots();
        let mut clean = Vec::with_capacity(noisy.len());
        for sample in noisy.chunks_exact((self.rows * knots * 2).max(1)) {
            let noisy = B::placed(&self.speed, sample.to_vec(), knots, 2);
            let steps = B::at_step(&self.speed, self.rows, step);
            let (plans, attention) = self.network.predict(context, &noisy, &steps);
            clean.extend(B::numbers(&plans));
            if !alone {
                self.attention.extend(attention);
            }
        }
        clean
    }
}

/// Draws plans of a batch; `alone` is the same with G = identity, for a guidance weight above 1. `guide` moves the plans on the way.
///
/// # Errors
/// As [`sampler::sample`].
pub fn denoised<B: Backend, N: Denoises<B>>(
    network: &N,
    schedule: &Schedule,
    batch: &B::Batch<'_>,
    alone: Option<&B::Batch<'_>>,
    asked: &Asked<'_>,
    guide: Option<&mut Guidance<'_>>,
) -> Result<Denoised<N::Context, B::Attention>> {
    let Asked { rows, seeds, options } = *asked;
    let mut encoded = Encoded::<B, N> {
        network,
        with_graph: network.encode(batch),
        alone: alone.map(|batch| network.encode(batch)),
        speed: B::speed(batch),
        rows: rows.count(),
        attention: Vec::new(),
    };
    let num_knots = network.config().num_knots();
    let knots = sampler::sample(&Draws { schedule, rows, seeds, options, num_knots }, &mut encoded, guide)?;
    Ok(Denoised { knots, attention: encoded.attention, context: encoded.with_graph })
}
