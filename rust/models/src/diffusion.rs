//! Plans by denoising: the loss of a denoising network, and its proposals.

use crate::batch::{Batch, Targets};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::losses::{logged_actions, plan_loss, trajectory_loss};
use crate::plan_model::{PlanModel, Samples, Taught, TorchKind, TrainingStep};
use crate::plan_space::PlanSpace;
use crate::schedule::Schedule;
use crate::tape::{self, Parameters, Tape, Var};
use crate::torch::{Torch, to_vec};
use ccdiff_nets::networks::ccdiff::Network;
use ccdiff_nets::networks::ctg::HalfUnet;
use ccdiff_nets::networks::denoised::denoised;
use ccdiff_nets::networks::planner::{Asked, Denoises, Weighted};
use tch::{Kind, Tensor, nn};

/// CCDiff.
pub(crate) const CCDIFF: TorchKind =
    TorchKind { name: "ccdiff", build: denoising::<Network<Torch>>, fast: |settings| settings };
/// CTG++.
pub(crate) const CTGPP: TorchKind = TorchKind { name: "ctgpp", ..CCDIFF };
/// CTG.
pub(crate) const CTG: TorchKind = TorchKind { name: "ctg", build: denoising::<HalfUnet<Torch>>, ..CCDIFF };

/// A network from noisy plans to clean ones that is trained.
pub trait Denoiser: Denoises<Torch> + Send {
    /// The same network on the tape.
    type Taped: Denoises<Tape>;
}

impl Denoiser for Network<Torch> {
    type Taped = Network<Tape>;
}

impl Denoiser for HalfUnet<Torch> {
    type Taped = HalfUnet<Tape>;
}

fn denoising<D: Denoiser + 'static>(p: &nn::Path, config: &ModelConfig) -> Result<Box<dyn PlanModel>> {
    Ok(Box::new(Diffusion::new(D::new(p, config))?))
}

/// A denoising network with its schedule.
#[derive(Debug)]
pub struct Diffusion<D> {
    denoiser: D,
    schedule: Schedule,
}

impl<D: Denoiser> Diffusion<D> {
    /// A denoiser with the cosine schedule of its configuration.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] for fewer than two diffusion steps.
    pub fn new(denoiser: D) -> Result<Self> {
        let schedule = Schedule::cosine(denoiser.space().config().diffusion_steps)?;
        Ok(Self { denoiser, schedule })
    }
}

impl<D: Denoiser> Diffusion<D> {
    /// The distance of the plan made of the first noise in one step from the one that the teacher makes of it.
    fn distillation_loss(
        &self,
        batch: &Batch,
        taught: &Taught,
        predict: impl FnOnce(&Batch, &Tensor, &[i64]) -> Tensor,
    ) -> Tensor {
        let (space, last) = (self.space(), self.schedule.len());
        let numbers = batch.rows().noise(&taught.seeds, last as u64, 1, space.config().num_knots() * 2);
        let noise = Tensor::from_slice(&numbers).view_as(&taught.knots).to_device(taught.knots.device());
        let predicted = predict(batch, &noise, &vec![last as i64 - 1; batch.num_rows() as usize]);
        let states = space.states(&taught.knots, &batch.speed_mps);
        let valid = states.select(2, 0).ones_like();
        let targets = Targets { states, valid };
        let planned = space.states(&predicted, &batch.speed_mps);
        trajectory_loss(space, &planned, &targets, &targets.valid)
            + (predicted - &taught.knots).square().mean(Kind::Float)
    }

    /// The loss of the plan predicted from the noised log, each scene at a diffusion step of its own, with G replaced by
    /// the identity in some scenes; with a teacher, the distance from its plans.
    fn loss_of(
        &self,
        step: &TrainingStep<'_>,
        predict: impl FnOnce(&Batch, &Tensor, &[i64]) -> Tensor,
    ) -> Tensor {
        if let Some(taught) = step.taught {
            return self.distillation_loss(step.batch, taught, predict);
        }
        let (batch, targets, space) = (step.batch, step.targets, self.space());
        let device = batch.speed_mps.device();
        let (of_step, of_drop) = (step.draw(0), step.draw(1));
        let per_scene = |f: &dyn Fn(u64) -> i64| -> Vec<i64> {
            let scenes = batch.scene_sizes.iter().zip(0u64..);
            scenes.flat_map(|(size, s)| std::iter::repeat_n(f(s), *size)).collect()
        };
        let k = per_scene(&|s| of_step.below(s, self.schedule.len() as u64) as i64);
        let dropped = per_scene(&|s| i64::from(of_drop.uniform(s) < step.config.drop_graph));
        let dropped = Tensor::from_slice(&dropped).to_kind(Kind::Bool).to_device(device);
        let batch = batch.with_graph_dropped(&dropped);

        let clean = space.knots_of(&logged_actions(targets));
        let numbers = step.draw(2).normals(clean.numel());
        let noise = Tensor::from_slice(&numbers).view_as(&clean).to_device(device);
        let of_noise = |f: &dyn Fn(f64) -> f64| {
            let values: Vec<f32> = k.iter().map(|k| f(self.schedule.alpha_bar[*k as usize]) as f32).collect();
            Tensor::from_slice(&values).view([-1, 1, 1]).to_device(device)
        };
        let noisy = &clean * of_noise(&f64::sqrt) + noise * of_noise(&|a| (1.0 - a).sqrt());

        let predicted = predict(&batch, &noisy, &k);
        let share = || of_noise(&f64::sqrt).flatten(0, 2);
        plan_loss(space, &predicted, &batch, targets, step.config.collision_weight, share)
    }
}

impl<D: Denoiser> PlanModel for Diffusion<D> {
    fn space(&self) -> &PlanSpace {
        self.denoiser.space()
    }

    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        self.loss_of(step, |batch, noisy, steps| {
            let context = self.denoiser.encode(batch);
            let steps = Tensor::from_slice(steps).to_device(noisy.device());
            self.denoiser.predict(&context, noisy, &steps).0
        })
    }

    fn learn(&self, step: &TrainingStep<'_>, parameters: &Parameters) -> Option<f64> {
        let config = self.space().config();
        Some(tape::learnt(|| {
            self.loss_of(step, |batch, noisy, steps| {
                let network = D::Taped::new(&parameters.root(), config);
                let context = network.encode(batch);
                let knots = Var::data(config.num_knots(), 2, to_vec(noisy));
                let steps = steps.iter().map(|k| *k as usize).collect();
                tape::leaf(&network.predict(&context, &knots, &steps).0, &noisy.size())
            })
        }))
    }

    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Option<&mut Guidance<'_>>) -> Result<Samples> {
        let alone = (asked.options.guidance_weight > 1.0).then(|| batch.with_identity_graph());
        let made = denoised(&self.denoiser, &self.schedule, batch, alone.as_ref(), asked, guide)?;
        Ok((made.knots, made.attention))
    }
}
