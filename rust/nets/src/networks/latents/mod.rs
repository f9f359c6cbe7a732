//! TrafficSim and STRIVE: plans decoded from latents, a conditional variational autoencoder (rivals.md#trafficsim, rivals.md#strive).
//!
//! ```text
//! token c, logged future ─► posterior q(z) ─┐                  ┌─► [neighbours' latents] ─► decoder ─► knots
//! token c ─► prior p(z) ────────────────────┴─► z of each agent ┘
//! ```
//! `trafficsim`: a joint decoder. `strive`: a decoder per agent, a wide latent, and a prior that guidance stays close to.

mod adjoint;
mod descent;

pub use adjoint::Back;

use crate::compute::backend::Backend;
use crate::compute::cpu::Cpu;
use crate::compute::layers::perceptron::Perceptron;
use crate::compute::layers::social::EdgeAwareLayer;
use crate::compute::numbers::Array;
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guide;
use crate::networks::cpu_planner::on_cpu;
use crate::networks::kind::NetworkKind;
use crate::networks::planner::{Asked, Proposed, Proposes};
use crate::networks::simnet::HIDDEN;
use crate::networks::trunk::{Encoded, Trunk};
use descent::{Gaussian, descended};

/// Latents of all agents decoded jointly, after the paper.
pub const TRAFFICSIM: NetworkKind = NetworkKind::with_trunk("trafficsim", "TrafficSim", on_cpu::<Cvae<Cpu>>);
/// Latents of each agent under a learned prior, optimised.
pub const STRIVE: NetworkKind =
    NetworkKind { road: true, ..NetworkKind::with_trunk("strive", "STRIVE", on_cpu::<Cvae<Cpu>>) };

/// Bounds of ln σ² of latents.
pub const LOG_VARIANCE: (f64, f64) = (-6.0, 2.0);

/// Which of the two it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// A joint decoder.
    Trafficsim,
    /// A prior that guidance stays close to.
    Strive,
}

impl Form {
    fn of(config: &ModelConfig) -> Self {
        match config.kind.as_str() {
            "strive" => Self::Strive,
            _ => Self::Trafficsim,
        }
    }

    /// Numbers of a latent D.
    pub fn latent(self) -> usize {
        match self {
            Self::Trafficsim => 16,
            Self::Strive => 32,
        }
    }
}

/// From latents to plans.
#[derive(Debug)]
pub struct Decoder<B: Backend> {
    /// Mixes the latents of neighbours; `None`: each agent is decoded for itself.
    joint: Option<(B::Linear, EdgeAwareLayer<B>)>,
    layers: Perceptron<B>,
}

impl<B: Backend> Decoder<B> {
    /// Knots of latents [R, 1, D], those of an agent side by side, [R, 1, 2 · knots].
    pub fn forward(&self, seen: &Encoded<B>, z: &B::Tensor) -> B::Tensor {
        let mixed = self.joint.as_ref().map(|(mixed, layer)| {
            let m = B::apply(mixed, &B::beside(&seen.token, z));
            layer.forward(&m, &m, &seen.edges, &seen.slots).0
        });
        self.layers.forward(&self.inputs(seen, z, mixed.as_ref().unwrap_or(&seen.token)))
    }

    fn inputs(&self, seen: &Encoded<B>, z: &B::Tensor, context: &B::Tensor) -> B::Tensor {
        B::beside(&B::beside(z, context), &seen.speed)
    }
}

/// A backend that has gradients of latents.
pub trait Pulls: Backend {
    /// What it needs for them.
    type Back: std::fmt::Debug;

    /// What it needs of a decoder.
    fn turned(decoder: &Decoder<Self>) -> Self::Back;

    /// Gradient by latents z [R, 1, D] of what has the gradient `of_knots` by the knots of their plans, [R · D].
    fn pulled(
        decoder: &Decoder<Self>,
        back: &Self::Back,
        seen: &Encoded<Self>,
        z: &Self::Tensor,
        of_knots: &[f32],
    ) -> Vec<f32>;
}

/// The autoencoder.
#[derive(Debug)]
pub struct Cvae<B: Pulls> {
    form: Form,
    trunk: Trunk<B>,
    future: Perceptron<B>,
    posterior: Perceptron<B>,
    /// `None`: N(0, I).
    prior: Perceptron<B>,
    decoder: Decoder<B>,
    back: B::Back,
}

impl<B: Pulls> Cvae<B> {
    /// Which one it is.
    pub fn form(&self) -> Form {
        self.form
    }

    /// What the trunk says of a batch.
    pub fn encode(&self, batch: &B::Batch<'_>) -> Encoded<B> {
        self.trunk.forward(batch)
    }

    /// Means and ln σ² of the prior [R, 1, 2 D], not yet bounded.
    pub fn prior(&self, seen: &Encoded<B>) -> B::Tensor {
        self.prior.forward(&seen.token)
    }

    /// Those of the posterior given futures [R, 1, 3 · knots]: actions, then shares of steps that are logged.
    pub fn posterior(&self, seen: &Encoded<B>, future: &B::Tensor) -> B::Tensor {
        self.posterior.forward(&B::beside(&seen.token, &self.future.forward(future)))
    }

    /// As [`Decoder::forward`].
    pub fn decode(&self, seen: &Encoded<B>, z: &B::Tensor) -> B::Tensor {
        self.decoder.forward(seen, z)
    }
}

impl<B: Pulls> Proposes<B> for Cvae<B> {
    fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
        let form = Form::of(config);
        let (d, knots, latent) = (config.width, config.num_knots() as i64, form.latent() as i64);
        let at = |name: &str| B::sub(p, name);
        let mlp = |name: &str, widths: &[i64]| Perceptron::new(&at(name), widths);
        let joint = || {
            let q = at("joint");
            let hidden = config.social_feed_forward;
            let social = B::sub(&q, "social");
            let layer = EdgeAwareLayer::new(&social, d, config.edge_width, config.heads, hidden);
            (B::linear(&B::sub(&q, "in"), d + latent, d), layer)
        };
        let trunk = Trunk::new(&at("trunk"), config);
        let future = mlp("future", &[3 * knots, HIDDEN, d]);
        let posterior = mlp("posterior", &[2 * d, HIDDEN, 2 * latent]);
        let prior = mlp("prior", &[d, HIDDEN, 2 * latent]);
        let joint = (form == Form::Trafficsim).then(joint);
        let layers = mlp("decoder", &[latent + d + 1, HIDDEN, HIDDEN, 2 * knots]);
        let decoder = Decoder { joint, layers };
        Self { form, trunk, future, posterior, prior, back: B::turned(&decoder), decoder }
    }

    fn config(&self) -> &ModelConfig {
        self.trunk.config()
    }

    /// Plans of samples of the prior; the first of STRIVE is its mean. Guidance moves the latents, those of STRIVE
    /// under the prior.
    fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        let Asked { rows, seeds, options, .. } = *asked;
        let (latent, seen) = (self.form.latent(), self.encode(batch));
        let of_sample = rows.count() * latent;
        let mut noise = rows.noise(seeds, 0, options.num_samples, latent);
        if self.form == Form::Strive {
            noise[..of_sample].fill(0.0);
        }
        let prior = Gaussian::new(&B::numbers(&self.prior(&seen)), latent);
        let mut z = prior.sample(&noise);
        let placed = |z: &[f32]| B::placed(batch, Array::new(1, latent, z.to_vec()));
        let decode = |z: &[f32]| -> Vec<f32> {
            z.chunks_exact(of_sample).flat_map(|z| B::numbers(&self.decode(&seen, &placed(z)))).collect()
        };
        if let Some(guide) = guide.filter(|g| g.is_active()) {
            let likely = (self.form == Form::Strive).then_some(&prior);
            let pulled = |z: &[f32], of_knots: &[f32]| -> Vec<f32> {
                let samples = z.chunks_exact(of_sample);
                let of_knots = of_knots.chunks_exact(of_knots.len() / samples.len());
                let of =
                    |(z, g): (&[f32], &[f32])| B::pulled(&self.decoder, &self.back, &seen, &placed(z), g);
                samples.zip(of_knots).flat_map(of).collect()
            };
            let before = decode(&z);
            z = descended(&z, latent, likely, guide, decode, pulled);
            let mut knots = decode(&z);
            guide.bound(&before, &mut knots);
            return Ok((knots, None));
        }
        Ok((decode(&z), None))
    }
}
