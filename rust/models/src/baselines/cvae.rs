//! TrafficSim and STRIVE: plans decoded from latents, a conditional variational autoencoder (rivals.md#trafficsim, rivals.md#strive).
//!
//! ```text
//! token c, logged future ─► posterior q(z) ─┐                  ┌─► [neighbours' latents] ─► decoder ─► knots
//! token c ─► prior p(z) ────────────────────┴─► z of each agent ┘
//! ```
//! `trafficsim`: a joint decoder and a collision loss between sampled plans. `strive`: a decoder per agent, a wide
//! latent, and a prior that guidance stays close to. `trafficsim_port`: the one without a learned prior that the
//! paper's table seems to have been made with.

use super::contact::{Pairs, off_road};
use super::distributions::Gaussian;
use super::latent::descended;
use crate::batch::{Batch, Targets};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::{Guidance, MOVING_MPS};
use crate::losses::{logged_actions, plan_loss, trajectory_loss};
use crate::plan_model::{PlanModel, TorchKind, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::sampler::{SampleOptions, Samples};
use crate::torch::Torch;
use crate::train::TrainConfig;
use crate::trunk::{Encoded, Trunk};
use ccdiff_nets::layers::perceptron::Perceptron;
use ccdiff_nets::layers::social::EdgeAwareLayer;
use ccdiff_nets::simnet::HIDDEN;
use tch::{Kind, Reduction, Tensor, nn};

/// Weight of the divergence of learned priors.
const DIVERGENCE: f64 = 2e-3;
/// And of the fixed one, as in the port.
const PORT_DIVERGENCE: f64 = 1e-4;
/// Weight of the mean squared yaw rate, (rad/s)², as in the port.
const PORT_YAW: f64 = 0.1;
/// Weight of contact between sampled plans.
const CONTACT: f64 = 0.05;
/// Weight of sampled plans' departures from the road.
const OFF_ROAD: f64 = 0.1;

/// TrafficSim.
pub(crate) const TRAFFICSIM: TorchKind = TorchKind {
    name: "trafficsim",
    build: |p, config| Ok(Box::new(Cvae::new(p, config, Form::Trafficsim))),
    fast: with_own_contact,
};
/// STRIVE.
pub(crate) const STRIVE: TorchKind = TorchKind {
    name: "strive",
    build: |p, config| Ok(Box::new(Cvae::new(p, config, Form::Strive))),
    fast: with_own_contact,
};
/// TrafficSim as ported.
pub(crate) const TRAFFICSIM_PORT: TorchKind = TorchKind {
    name: "trafficsim_port",
    build: |p, config| Ok(Box::new(Cvae::new(p, config, Form::TrafficsimPort))),
    fast: |settings| settings,
};

/// Contact has a loss of its own.
fn with_own_contact(settings: TrainConfig) -> TrainConfig {
    TrainConfig { collision_weight: 0.0, ..settings }
}

/// Which of the three it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    TrafficsimPort,
    Trafficsim,
    Strive,
}

/// The autoencoder.
#[derive(Debug)]
pub struct Cvae {
    form: Form,
    space: PlanSpace,
    trunk: Trunk,
    future: Perceptron<Torch>,
    posterior: Perceptron<Torch>,
    /// `None`: N(0, I).
    prior: Option<Perceptron<Torch>>,
    /// Mixes the latents of neighbours; `None`: each agent is decoded for itself.
    joint: Option<(nn::Linear, EdgeAwareLayer<Torch>)>,
    decoder: Perceptron<Torch>,
    latent: i64,
}

impl Cvae {
    /// A network with fresh weights under a path.
    fn new(p: &nn::Path, config: &ModelConfig, form: Form) -> Self {
        let latent = match form {
            Form::Trafficsim => 16,
            Form::Strive => 32,
            Form::TrafficsimPort => 4,
        };
        let (d, knots) = (config.width, config.num_knots() as i64);
        let mlp = |name: &str, widths: &[i64]| Perceptron::new(&(p / name), widths);
        let joint = || {
            let q = p / "joint";
            let hidden = config.social_feed_forward;
            let layer = EdgeAwareLayer::new(&(&q / "social"), d, config.edge_width, config.heads, hidden);
            (nn::linear(&q / "in", d + latent, d, Default::default()), layer)
        };
        Self {
            form,
            space: PlanSpace::new(config, p.device()),
            trunk: Trunk::new(&(p / "trunk"), config),
            future: mlp("future", &[3 * knots, HIDDEN, d]),
            posterior: mlp("posterior", &[2 * d, HIDDEN, 2 * latent]),
            prior: (form != Form::TrafficsimPort).then(|| mlp("prior", &[d, HIDDEN, 2 * latent])),
            joint: (form == Form::Trafficsim).then(joint),
            decoder: mlp("decoder", &[latent + d + 1, HIDDEN, HIDDEN, 2 * knots]),
            latent,
        }
    }

    /// The prior of R agents.
    fn prior(&self, seen: &Encoded) -> Gaussian {
        match &self.prior {
            Some(network) => Gaussian::new(&network.forward(&seen.token)),
            None => Gaussian::standard(seen.token.size()[0], self.latent, seen.token.device()),
        }
    }

    /// The posterior given logged futures.
    fn posterior(&self, seen: &Encoded, targets: &Targets) -> Gaussian {
        let config = self.space.config();
        let knots = config.num_knots() as i64;
        let logged = targets.valid.view([-1, knots, config.knot_stride as i64]);
        let logged = logged.mean_dim([2i64].as_slice(), false, Kind::Float);
        let actions = self.space.knots_of(&logged_actions(targets));
        let actions = actions * logged.gt(0.0).to_kind(Kind::Float).unsqueeze(2);
        let future = self.future.forward(&Tensor::cat(&[actions.flatten(1, 2), logged], 1));
        Gaussian::new(&self.posterior.forward(&Tensor::cat(&[&seen.token, &future], 1)))
    }

    /// Knots [R, knots, 2] of latents [R, D].
    fn decode(&self, seen: &Encoded, z: &Tensor) -> Tensor {
        let speed = seen.state.narrow(1, seen.token.size()[1], 1);
        let context = match &self.joint {
            None => seen.token.shallow_clone(),
            Some((mixed, layer)) => {
                let m = Tensor::cat(&[&seen.token, z], 1).apply(mixed).unsqueeze(1);
                layer.forward(&m, &m, &seen.edges, &seen.slots).0.squeeze_dim(1)
            }
        };
        self.decoder.forward(&Tensor::cat(&[z, &context, &speed], 1)).view([z.size()[0], -1, 2])
    }

    /// Distance of plans to the log, and what else the form asks of them.
    fn imitation(&self, step: &TrainingStep<'_>, knots: &Tensor) -> Tensor {
        let (batch, targets) = (step.batch, step.targets);
        let states = || self.space.states(knots, &batch.speed_mps);
        match self.form {
            Form::TrafficsimPort => {
                let share = || Tensor::ones([batch.num_rows()], (Kind::Float, knots.device()));
                let weight = step.config.collision_weight;
                let yaw_rate = self.space.actions(knots).select(2, 1);
                plan_loss(&self.space, knots, batch, targets, weight, share)
                    + yaw_rate.square().mean(Kind::Float) * PORT_YAW
            }
            Form::Trafficsim => huber(&self.space, &states(), targets),
            Form::Strive => trajectory_loss(&self.space, &states(), targets, &targets.valid),
        }
    }

    /// What sampled plans of all agents may not do to each other and to the road.
    fn together(&self, step: &TrainingStep<'_>, knots: &Tensor) -> Tensor {
        let batch = step.batch;
        let states = self.space.states(knots, &batch.speed_mps);
        let zero = || knots.sum(Kind::Float) * 0.0;
        let pairs = Pairs::new(batch);
        if self.form == Form::Trafficsim {
            return pairs.map_or_else(zero, |p| p.once(batch, &states)) * CONTACT;
        }
        let off_road = off_road(batch, &states, self.space.config(), f64::from(MOVING_MPS));
        pairs.map_or_else(zero, |p| p.mean(batch, &states)) * CONTACT + off_road * OFF_ROAD
    }
}

/// Huber loss (δ = 1) of the six normalised components, mean over logged steps.
fn huber(space: &PlanSpace, states: &Tensor, targets: &Targets) -> Tensor {
    let (got, logged) = (space.standardised_states(states), space.standardised_states(&targets.states));
    let per_step =
        got.huber_loss(&logged, Reduction::None, 1.0).mean_dim([2i64].as_slice(), false, Kind::Float);
    (per_step * &targets.valid).sum(Kind::Float) / targets.valid.sum(Kind::Float).clamp_min(1.0)
}

impl PlanModel for Cvae {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    /// Imitation by a sample of the posterior, its divergence from the prior (its weight rises over the warm-up), and,
    /// but for the port, what a sample of the prior does.
    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        let (batch, targets) = (step.batch, step.targets);
        let seen = Encoded::new(&self.trunk, batch, true);
        let (prior, posterior) = (self.prior(&seen), self.posterior(&seen, targets));
        let normals = |stream: u64| {
            let numbers = step.draw(stream).normals(posterior.mean.numel());
            Tensor::from_slice(&numbers).view_as(&posterior.mean).to_device(posterior.mean.device())
        };
        let knots = self.decode(&seen, &posterior.sample(&normals(0)));
        let logged = targets.valid.amax([1i64].as_slice(), false);
        let divergence =
            (posterior.kl(&prior) * &logged).sum(Kind::Float) / logged.sum(Kind::Float).clamp_min(1.0);
        let imitation = self.imitation(step, &knots);
        if self.form == Form::TrafficsimPort {
            return imitation + divergence * PORT_DIVERGENCE;
        }
        let risen = (step.step as f64 / step.config.warmup_steps.max(1) as f64).min(1.0);
        let sampled = self.decode(&seen, &prior.sample(&normals(1)));
        imitation + divergence * (DIVERGENCE * risen) + self.together(step, &sampled)
    }

    /// Plans of samples of the prior; the first of STRIVE is its mean. Guidance moves the latents, those of STRIVE
    /// under the prior.
    fn propose(
        &self,
        batch: &Batch,
        seeds: &[u64],
        options: SampleOptions,
        guide: Option<&mut Guidance<'_>>,
    ) -> Result<Samples> {
        batch.rows().check_seeds(seeds)?;
        let n = options.num_samples as i64;
        let seen = Encoded::new(&self.trunk, batch, false);
        let (prior, seen) = (self.prior(&seen).repeated(n), seen.repeated(n));
        let numbers = batch.rows().noise(seeds, 0, options.num_samples, self.latent as usize);
        let normals = Tensor::from_slice(&numbers).view_as(&prior.mean).to_device(prior.mean.device());
        if self.form == Form::Strive {
            let _ = normals.narrow(0, 0, batch.num_rows()).zero_();
        }
        let mut z = prior.sample(&normals);
        if let Some(guide) = guide.filter(|g| g.is_active()) {
            let likely = (self.form == Form::Strive).then_some(&prior);
            z = descended(&z, likely, guide, &|z| self.decode(&seen, z))?;
        }
        Ok(Samples { knots: self.decode(&seen, &z), attention: None })
    }
}
