//! What every planning network is to the rest of the crate: a loss to train it, proposals to plan with.

use crate::batch::{Batch, Targets};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guide;
use crate::noise::Noise;
use crate::plan_space::PlanSpace;
use crate::torch::Torch;
use crate::train::config::TrainConfig;
use ccdiff_nets::networks::planner::{Asked, Proposed, Proposes};
use std::fmt::Debug;
use tch::{Tensor, nn};

/// Streams of random numbers of one training step; the last one moves agents off their log.
const STREAMS: u64 = 4;

/// A network that is trained.
pub trait Learns: Proposes<Torch> {
    /// Settings of its training in the preset `fast`, from those of most networks.
    fn fast(settings: TrainConfig) -> TrainConfig {
        settings
    }

    /// Loss of one batch of a training step, with its gradient.
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor;

    /// Sum of the negative logarithms of the probabilities of the logged tokens, and their number; `None` for other networks.
    fn nats(&self, _: &Batch, _: &Targets) -> Option<(f64, usize)> {
        None
    }
}

/// A network on torch.
pub trait PlanModel: Debug + Send {
    /// The space of its plans.
    fn space(&self) -> &PlanSpace;

    /// As [`Learns::loss`].
    fn loss(&self, step: &TrainingStep<'_>) -> Tensor;

    /// As [`Learns::nats`].
    fn nats(&self, batch: &Batch, targets: &Targets) -> Option<(f64, usize)>;

    /// As [`Proposes::propose`].
    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed>;
}

#[derive(Debug)]
struct Model<N> {
    network: N,
    space: PlanSpace,
}

/// A network with fresh weights under a path.
fn on_torch<N: Learns + Send + 'static>(p: &nn::Path, config: &ModelConfig) -> Box<dyn PlanModel> {
    Box::new(Model { network: N::new(p, config), space: PlanSpace::new(config, p.device()) })
}

impl<N: Learns + Send> PlanModel for Model<N> {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        self.network.loss(&self.space, step)
    }

    fn nats(&self, batch: &Batch, targets: &Targets) -> Option<(f64, usize)> {
        self.network.nats(batch, targets)
    }

    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Guide<'_, '_>) -> Result<Proposed> {
        self.network.propose(batch, asked, guide)
    }
}

/// A network on torch, without its type.
#[derive(Debug, Clone, Copy)]
pub struct TorchKind {
    /// Name of its [`ccdiff_nets::NetworkKind`].
    pub name: &'static str,
    /// Makes it with fresh weights under a path.
    pub build: fn(&nn::Path, &ModelConfig) -> Box<dyn PlanModel>,
    /// As [`Learns::fast`].
    pub fast: fn(TrainConfig) -> TrainConfig,
}

impl TorchKind {
    /// The kind of a name that is a network of this type.
    pub(crate) const fn of<N: Learns + Send + 'static>(name: &'static str) -> Self {
        Self { name, build: on_torch::<N>, fast: N::fast }
    }
}

/// What a teacher plans for a batch in several denoising steps.
#[derive(Debug)]
pub struct Taught {
    /// Seeds of the first noise, one per scene.
    pub seeds: Vec<u64>,
    /// Clean normalised knots that the teacher makes of that noise, [R, knots, 2].
    pub knots: Tensor,
}

/// One training step's batch and random numbers.
#[derive(Debug, Clone, Copy)]
pub struct TrainingStep<'a> {
    /// Inputs.
    pub batch: &'a Batch,
    /// Logged futures.
    pub targets: &'a Targets,
    /// Settings of the run.
    pub config: &'a TrainConfig,
    /// Steps taken before.
    pub step: u64,
    /// Plans of the teacher, where there is one.
    pub taught: Option<&'a Taught>,
}

impl TrainingStep<'_> {
    /// A stream of the step's random numbers, 0 to 2.
    pub(crate) fn draw(&self, stream: u64) -> Noise {
        stream_of(self.config, self.step, stream)
    }
}

/// A stream of a step's random numbers.
fn stream_of(config: &TrainConfig, step: u64, stream: u64) -> Noise {
    Noise::new(config.seed, step * STREAMS + stream)
}

/// Seeds of the plans that a teacher makes in a step, one per scene.
pub(crate) fn taught_seeds(config: &TrainConfig, step: u64, scenes: usize) -> Vec<u64> {
    let draw = stream_of(config, step, 0);
    let seed = |s| draw.block(s);
    (0..scenes as u64).map(seed).map(|w| u64::from(w[0]) << 32 | u64::from(w[1])).collect()
}

/// The batch of a step with some routes untold, for a network that may know them.
pub(crate) fn with_routes_dropped(batch: Batch, config: &TrainConfig, step: u64) -> Batch {
    let draw = stream_of(config, step, 1);
    // after the numbers of the scenes, which drop their graph, one for each row
    let first = batch.scene_sizes.len();
    batch.with_routes_dropped(|row| draw.uniform((first + row) as u64) < config.drop_route)
}

/// The numbers that move a step's agents off their log.
pub(crate) fn pushes(config: &TrainConfig, step: u64) -> Noise {
    stream_of(config, step, STREAMS - 1)
}
