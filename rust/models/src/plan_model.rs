//! What every planning network is to the rest of the crate: a loss to train it, proposals to plan with.

use crate::batch::{Batch, Targets};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::guidance::Guidance;
use crate::noise::Noise;
use crate::plan_space::PlanSpace;
use crate::tape::Parameters;
use crate::torch::Torch;
use crate::train::config::TrainConfig;
use ccdiff_nets::networks::planner::{Asked, Proposes};
use std::fmt::Debug;
use tch::{Tensor, nn};

/// Streams of random numbers of one training step; the last one moves agents off their log.
const STREAMS: u64 = 4;

/// A network from a batch to action knots.
pub trait PlanModel: Debug + Send {
    /// The space of its plans.
    fn space(&self) -> &PlanSpace;

    /// Loss of one batch of a training step, with its gradient.
    fn loss(&self, step: &TrainingStep<'_>) -> Tensor;

    /// The same loss of these numbers of the network, to which its gradient is added; `None` where the tape has no such loss.
    fn learn(&self, _step: &TrainingStep<'_>, _parameters: &Parameters) -> Option<f64> {
        None
    }

    /// Sum of the negative logarithms of the probabilities of the logged tokens, and their number; `None` for other networks.
    fn nats(&self, _batch: &Batch, _targets: &Targets) -> Option<(f64, usize)> {
        None
    }

    /// Draws normalised knots for the rows of a batch; `guide` moves the plans on the way.
    ///
    /// # Errors
    /// [`crate::ModelError::Shape`] for a wrong number of seeds, [`crate::ModelError::Config`] for bad options.
    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Option<&mut Guidance<'_>>) -> Result<Samples>;
}

/// Clean normalised knots [N · R, knots, 2], sample by sample, and attention [R, K, tokens, heads] of each sample in the
/// first edge-aware layer, of a network that has it.
pub type Samples = (Vec<f32>, Vec<Tensor>);

/// What a network that plans at once is trained with.
pub trait Imitates: Proposes<Torch> + Send {
    /// Loss of one batch of a training step, with its gradient.
    fn loss(&self, space: &PlanSpace, step: &TrainingStep<'_>) -> Tensor;

    /// The same loss on the tape, as [`PlanModel::learn`].
    fn learn(&self, _: &PlanSpace, _: &TrainingStep<'_>, _: &Parameters) -> Option<f64> {
        None
    }
}

/// A network that plans at once.
#[derive(Debug)]
pub(crate) struct Proposing<N> {
    network: N,
    space: PlanSpace,
}

/// One with fresh weights under a path.
pub(crate) fn proposing<N: Imitates + 'static>(
    p: &nn::Path,
    config: &ModelConfig,
) -> Result<Box<dyn PlanModel>> {
    Ok(Box::new(Proposing { network: N::new(p, config), space: PlanSpace::new(config, p.device()) }))
}

impl<N: Imitates> PlanModel for Proposing<N> {
    fn space(&self) -> &PlanSpace {
        &self.space
    }

    fn loss(&self, step: &TrainingStep<'_>) -> Tensor {
        self.network.loss(&self.space, step)
    }

    fn learn(&self, step: &TrainingStep<'_>, parameters: &Parameters) -> Option<f64> {
        self.network.learn(&self.space, step, parameters)
    }

    fn propose(&self, batch: &Batch, asked: &Asked<'_>, guide: Option<&mut Guidance<'_>>) -> Result<Samples> {
        Ok((self.network.propose(batch, asked, guide)?, Vec::new()))
    }
}

/// A network on torch: its file declares one, `kinds.rs` lists it.
#[derive(Debug, Clone, Copy)]
pub struct TorchKind {
    /// Name of its [`ccdiff_nets::NetworkKind`].
    pub name: &'static str,
    /// Makes it with fresh weights under a path.
    pub build: fn(&nn::Path, &ModelConfig) -> Result<Box<dyn PlanModel>>,
    /// Its settings of training in the preset `fast`, from those of most networks.
    pub fast: fn(TrainConfig) -> TrainConfig,
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
    if batch.route.is_none() {
        return batch;
    }
    let draw = stream_of(config, step, 1);
    // after the numbers of the scenes, which drop their graph, one for each row
    let first = batch.scene_sizes.len() as u64;
    let rows = first..first + batch.num_rows() as u64;
    let untold: Vec<bool> = rows.map(|at| draw.uniform(at) < config.drop_route).collect();
    let untold = Tensor::from_slice(&untold).to_device(batch.speed_mps.device());
    batch.with_routes_dropped(&untold)
}

/// The numbers that move a step's agents off their log.
pub(crate) fn pushes(config: &TrainConfig, step: u64) -> Noise {
    stream_of(config, step, STREAMS - 1)
}
