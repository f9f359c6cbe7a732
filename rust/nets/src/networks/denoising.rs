//! A network that denoises, as one that plans, on any backend.

use crate::compute::backend::Backend;
use crate::compute::numbers::Array;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guide;
use crate::networks::planner::{Denoises, Proposed, Proposes};
use crate::sampling::sampler::{Asked, sample};
use crate::sampling::schedule::Schedule;

/// A network with its schedule.
#[derive(Debug)]
pub struct Denoising<N> {
    /// From noisy plans to clean ones.
    pub network: N,
    /// The noise that it was taught to take away.
    pub schedule: Schedule,
}

impl<B: Backend, N: Denoises<B>> Proposes<B> for Denoising<N> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        Self { network: N::new(p, config), schedule: Schedule::cosine(config.diffusion_steps) }
    }

    fn config(&self) -> &ModelConfig {
        self.network.config()
    }

    /// The attention is that of the last pass with the graph.
    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        let (network, config) = (&self.network, self.network.config());
        let (num_knots, rows) = (config.num_knots(), asked.rows.count());
        let with_graph = network.encode(batch);
        let alone = (asked.options.guidance_weight > 1.0).then(|| network.encode(&B::alone(batch)));
        let mut attention = Vec::new();
        let predict = |noisy: &[f32], step: usize, is_alone: bool| {
            let context = alone.as_ref().filter(|_| is_alone).unwrap_or(&with_graph);
            if !is_alone {
                attention.clear();
            }
            let mut clean = Vec::with_capacity(noisy.len());
            for sample in noisy.chunks_exact((rows * num_knots * 2).max(1)) {
                let noisy = B::placed(batch, Array::new(num_knots, 2, sample.to_vec()));
                let (plans, weights) = network.predict(context, &noisy, &[step]);
                clean.extend(B::numbers(&plans));
                if !is_alone {
                    attention.extend(weights);
                }
            }
            clean
        };
        let knots = sample(&self.schedule, num_knots, asked, predict, guide);
        let history = config.history_token_steps().len();
        let of_plans = asked.attention.zip(N::slots(&with_graph));
        let mean = of_plans
            .map(|(executed, slots)| B::mean_attention(&attention, slots, history..history + executed));
        Ok((knots, mean))
    }
}
