//! The losses of TrafficSim and STRIVE (rivals.md#trafficsim, rivals.md#strive): a collision loss between sampled plans of
//! TrafficSim, contact and departures from the road of STRIVE's.

use super::contact::{Pairs, off_road};
use super::distributions::Gaussian;
use crate::batch::Targets;
use crate::guidance::MOVING_MPS;
use crate::losses::{logged_actions, trajectory_loss};
use crate::plan_model::{Learns, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::torch::Torch;
use crate::train::config::TrainConfig;
use ccdiff_nets::networks::latents::{Cvae, Form};
use ccdiff_nets::networks::trunk::Encoded;
use tch::{Kind, Reduction, Tensor};

/// Weight of the divergence of learned priors.
const DIVERGENCE: f64 = 2e-3;
/// Weight of contact between sampled plans.
const CONTACT: f64 = 0.05;
/// Weight of sampled plans' departures from the road.
const OFF_ROAD: f64 = 0.1;

/// The posterior given logged futures.
fn posterior(network: &Cvae<Torch>, space: &PlanSpace, seen: &Encoded<Torch>, targets: &Targets) -> Gaussian {
    let config = space.config();
    let logged = targets.valid.view([-1, config.num_knots() as i64, config.knot_stride as i64]);
    let logged = logged.mean_dim([2i64].as_slice(), false, Kind::Float);
    let actions = space.knots_of(&logged_actions(targets));
    let actions = actions * logged.gt(0.0).to_kind(Kind::Float).unsqueeze(2);
    let future = Tensor::cat(&[actions.flatten(1, 2), logged], 1).unsqueeze(1);
    Gaussian::new(&network.posterior(seen, &future).squeeze_dim(1))
}

/// Distance of plans to the log, and what else the form asks of them.
fn imitation(form: Form, space: &PlanSpace, step: &TrainingStep<'_>, knots: &Tensor) -> Tensor {
    let (batch, targets) = (step.batch, step.targets);
    let states = || space.states(knots, &batch.speed_mps());
    match form {
        Form::Trafficsim => huber(space, &states(), targets),
        Form::Strive => trajectory_loss(space, &states(), targets, &targets.valid),
    }
}

/// What sampled plans of all agents may not do to each other and to the road.
fn together(form: Form, space: &PlanSpace, step: &TrainingStep<'_>, knots: &Tensor) -> Tensor {
    let batch = step.batch;
    let states = space.states(knots, &batch.speed_mps());
    let zero = || knots.sum(Kind::Float) * 0.0;
    let pairs = Pairs::new(batch);
    if form == Form::Trafficsim {
        return pairs.map_or_else(zero, |p| p.once(batch, &states)) * CONTACT;
    }
    let off_road = off_road(batch, &states, f64::from(MOVING_MPS));
    pairs.map_or_else(zero, |p| p.mean(batch, &states)) * CONTACT + off_road * OFF_ROAD
}

/// Huber loss (δ = 1) of the six normalised components, mean over logged steps.
fn huber(space: &PlanSpace, states: &Tensor, targets: &Targets) -> Tensor {
    let (got, logged) = (space.standardised_states(states), space.standardised_states(&targets.states));
    let per_step =
        got.huber_loss(&logged, Reduction::None, 1.0).mean_dim([2i64].as_slice(), false, Kind::Float);
    (per_step * &targets.valid).sum(Kind::Float) / targets.valid.sum(Kind::Float).clamp_min(1.0)
}

impl Learns for Cvae<Torch> {
    /// Contact has a loss of its own.
    fn fast(settings: TrainConfig) -> TrainConfig {
        TrainConfig { collision_weight: 0.0, ..settings }
    }

    /// Imitation by a sample of the posterior, its divergence from the prior (its weight rises over the warm-up), and
    /// what a sample of the prior does.
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor {
        let (batch, targets, form) = (step.batch, step.targets, self.form());
        let seen = self.encode(batch);
        let posterior = posterior(self, space, &seen, targets);
        let prior = Gaussian::new(&self.prior(&seen).squeeze_dim(1));
        let normals = |stream: u64| {
            let numbers = step.draw(stream).normals(posterior.mean.numel());
            Tensor::from_slice(&numbers).view_as(&posterior.mean).to_device(posterior.mean.device())
        };
        let decode = |z: Tensor| self.decode(&seen, &z.unsqueeze(1)).view([batch.num_rows() as i64, -1, 2]);
        let knots = decode(posterior.sample(&normals(0)));
        let logged = targets.valid.amax([1i64].as_slice(), false);
        let divergence =
            (posterior.kl(&prior) * &logged).sum(Kind::Float) / logged.sum(Kind::Float).clamp_min(1.0);
        let imitation = imitation(form, space, step, &knots);
        let risen = (step.step as f64 / step.config.warmup_steps.max(1) as f64).min(1.0);
        let sampled = decode(prior.sample(&normals(1)));
        imitation + divergence * (DIVERGENCE * risen) + together(form, space, step, &sampled)
    }
}
