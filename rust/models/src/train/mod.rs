//! Training of planning networks, with exact resume.
//!
//! Everything random is a function of (seed, step), so the state of a run is its step, weights, averages and moments.

pub mod config;
mod optimiser;

pub use config::TrainConfig;

use crate::batch::{Batch, Targets};
use crate::checkpoint::{self, variables};
use crate::config::ModelConfig;
use crate::dataset::Dataset;
use crate::error::{ModelError, Result, require};
use crate::grad::guarded;
use crate::kinds::build;
use crate::plan_model::{self, PlanModel, Taught, TrainingStep};
use crate::sampler::SampleOptions;
use crate::torch_model::TorchModel;
use ccdiff_nets::compute::weights::{self, broken};
use ccdiff_nets::networks::kinds::described;
use ccdiff_nets::networks::planner::PlanOptions;
use optimiser::{Adam, MovingAverage};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tch::{Device, Kind, Tensor, nn};

/// The last steps of a run, in which the learning rate falls linearly to zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cooldown {
    /// First step.
    pub start: u64,
    /// Number of steps.
    pub steps: u64,
}

/// What [`Validation::errors_m`] are: least mean distance to the log among the samples of a plan, and least one at its end; those of
/// one sample; those of constant velocity.
pub const ERRORS: [&str; 6] =
    ["min_ade_m", "min_fde_m", "ade_m", "fde_m", "constant_velocity_ade_m", "constant_velocity_fde_m"];

/// Errors of open-loop plans over held-out samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Validation {
    /// [`ERRORS`], metres, means over agents with a whole logged future.
    pub errors_m: [f64; 6],
    /// Agents counted.
    pub num_agents: usize,
    /// Mean negative logarithm of the probabilities of the logged tokens, with routes and without; of a network of tokens.
    pub nats: Option<[f64; 2]>,
}

/// A training run.
#[derive(Debug)]
pub struct Trainer {
    model: ModelConfig,
    config: TrainConfig,
    dataset: Dataset,
    store: nn::VarStore,
    network: Box<dyn PlanModel>,
    average: MovingAverage,
    adam: Adam,
    teacher: Option<TorchModel>,
    step: u64,
    cooldown: Option<Cooldown>,
}

impl Trainer {
    /// A run from fresh weights, drawn from torch's global generator.
    ///
    /// # Errors
    /// [`ModelError::Config`] for settings out of range.
    pub fn new(model: ModelConfig, config: TrainConfig, dataset: Dataset, device: Device) -> Result<Self> {
        let (model, config) = (model.validated()?, config.validated()?);
        guarded(true, "building the network", || {
            let store = nn::VarStore::new(device);
            let network = build(&store.root(), &model)?;
            let adam = Adam::new(&store);
            let average = tch::no_grad(|| MovingAverage::new(&adam.parameters, |p| build(p, &model)))?;
            Ok(Self {
                adam,
                store,
                network,
                average,
                dataset,
                teacher: None,
                step: 0,
                cooldown: None,
                model,
                config,
            })
        })
    }

    /// The run with a teacher, from whose weights it begins.
    ///
    /// # Errors
    /// What reading weights refuses; [`ModelError::Config`] for a network that does not denoise or differs from this one.
    pub fn taught_by(mut self, path: &Path) -> Result<Self> {
        let (header, entries) = weights::read(path)?;
        let teacher = TorchModel::of(path, &described(path, &header)?, &entries, self.store.device())?;
        let same = *teacher.network.space().config() == self.model;
        require(same, "teacher", "another network", "weights of the network that is trained")?;
        let denoises = self.model.network()?.denoises;
        require(denoises, "teacher", self.model.kind.as_str(), "a network that denoises")?;
        require(self.config.teacher_steps > 0, "teacher", "given", "none where teacher_steps is 0")?;
        for store in [&self.store, &self.average.store] {
            checkpoint::fill(path, &variables(&teacher.store), &mut variables(store))?;
        }
        self.teacher = Some(teacher);
        Ok(self)
    }

    /// The run from the weights of a network that this one extends: what the file has not keeps its first weights.
    ///
    /// # Errors
    /// [`ModelError::Io`]; [`ModelError::Checkpoint`] where the file has what this network has not, or in another shape.
    pub fn begun_with(self, path: &Path) -> Result<Self> {
        guarded(false, "loading weights", || {
            let (_, tensors) = checkpoint::read(path)?;
            for store in [&self.store, &self.average.store] {
                let mut known = variables(store);
                known.retain(|name, _| tensors.contains_key(name));
                checkpoint::fill(path, &tensors, &mut known)?;
            }
            Ok(())
        })?;
        Ok(self)
    }

    /// What the teacher plans for the batch of a step.
    fn taught(&self, batch: &Batch) -> Result<Option<Taught>> {
        let steps = self.config.teacher_steps;
        let Some(teacher) = &self.teacher else {
            let got = format!("{steps} without a teacher");
            return require(steps == 0, "teacher_steps", got, "the weights of a teacher").map(|()| None);
        };
        let options = SampleOptions { solver_steps: Some(steps), ..SampleOptions::default() };
        let seeds = plan_model::taught_seeds(&self.config, self.step, batch.scene_sizes.len());
        let asked = PlanOptions::from(options).asked(batch.rows(), &seeds, &self.model);
        let (knots, _) = tch::no_grad(|| teacher.network.propose(batch, &asked, None))?;
        Ok(Some(Taught { knots: teacher.network.space().knots(&knots), seeds }))
    }

    /// Steps taken.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Trainable numbers of the network.
    pub fn num_parameters(&self) -> usize {
        self.store.trainable_variables().iter().map(Tensor::numel).sum()
    }

    /// Samples of the training set.
    pub fn num_samples(&self) -> usize {
        self.dataset.len()
    }

    /// Starts the cool-down now, for a number of steps.
    pub fn cool_down(&mut self, steps: u64) {
        self.cooldown = Some(Cooldown { start: self.step, steps: steps.max(1) });
    }

    /// The cool-down, if it has begun.
    pub fn cooldown(&self) -> Option<Cooldown> {
        self.cooldown
    }

    fn learning_rate(&self) -> f64 {
        let warm = (self.step + 1) as f64 / (self.config.warmup_steps + 1) as f64;
        let cool =
            self.cooldown.map_or(1.0, |c| 1.0 - (self.step.saturating_sub(c.start)) as f64 / c.steps as f64);
        self.config.learning_rate * warm.min(1.0) * cool.max(0.0)
    }

    /// Takes `steps` training steps and returns their losses.
    ///
    /// # Errors
    /// [`ModelError::Diverged`] where the loss is not finite; what libtorch refuses.
    pub fn run(&mut self, steps: usize) -> Result<Vec<f64>> {
        guarded(true, "training", || {
            let mut losses = Vec::with_capacity(steps);
            for _ in 0..steps {
                let indices =
                    self.dataset.indices_of_step(self.config.seed, self.step, self.config.batch_scenes);
                let push = self.config.perturb.then(|| plan_model::pushes(&self.config, self.step));
                let (batch, targets) = self.dataset.batch(&indices, push, self.store.device())?;
                let batch = plan_model::with_routes_dropped(batch, &self.config, self.step);
                let taught = self.taught(&batch)?;
                let step = TrainingStep {
                    batch: &batch,
                    targets: &targets,
                    config: &self.config,
                    step: self.step,
                    taught: taught.as_ref(),
                };
                let loss = self.network.loss(&step);
                loss.backward();
                let (value, gradient) = (loss.double_value(&[]), self.adam.parameters.gradient());
                if !value.is_finite() {
                    return Err(ModelError::Diverged { step: self.step, loss: value });
                }
                let rate = self.learning_rate();
                tch::no_grad(|| {
                    self.adam.step(&gradient, self.step + 1, rate, self.config.clip_norm);
                    self.step += 1;
                    let decay = if self.step <= self.config.ema_start { 0.0 } else { self.config.ema_decay };
                    self.average.follow(decay);
                });
                losses.push(value);
            }
            Ok(losses)
        })
    }

    /// Open-loop errors of the averaged weights on `count` samples of another data set, spread evenly over it.
    ///
    /// # Errors
    /// What features, sampling and libtorch refuse.
    pub fn validate(&self, held_out: &Dataset, count: usize, options: SampleOptions) -> Result<Validation> {
        let options = options.validated()?;
        // tokens are cheap, and their logarithms vary
        let count = if self.model.network()?.samples_tokens { 8 * count } else { count };
        let count = count.clamp(1, held_out.len());
        let indices: Vec<usize> = (0..count).map(|i| i * held_out.len() / count).collect();
        guarded(false, "validation", || {
            let (mut sums, mut nats) = (Validation::default(), [(0.0, 0); 2]);
            for chunk in indices.chunks(32) {
                let (batch, targets) = held_out.batch(chunk, None, self.store.device())?;
                let seeds: Vec<u64> = chunk.iter().map(|i| *i as u64).collect();
                let model = &self.average.model;
                let asked = PlanOptions::from(options).asked(batch.rows(), &seeds, &self.model);
                let (knots, n) = (model.propose(&batch, &asked, None)?.0, options.num_samples as i64);
                let knots = model.space().knots(&knots);
                let speed_mps = batch.speed_mps();
                let states = model.space().states(&knots, &speed_mps.repeat([n]));
                sums.add(&states, &speed_mps, &targets, n, self.model.dt_s);
                let mut add = |at: usize, batch: &Batch| {
                    let found = model.nats(batch, &targets).unwrap_or_default();
                    nats[at] = (nats[at].0 + found.0, nats[at].1 + found.1);
                };
                add(0, &batch);
                add(1, &batch.with_routes_dropped(|_| true));
            }
            sums.errors_m = sums.errors_m.map(|sum| sum / sums.num_agents.max(1) as f64);
            sums.nats = (nats[0].1 > 0).then(|| nats.map(|(sum, count)| sum / count as f64));
            Ok(sums)
        })
    }

    /// Writes the averaged weights with a header that rebuilds the network; `notes` is kept in it as it is.
    ///
    /// # Errors
    /// [`ModelError::Io`] where the file cannot be written.
    pub fn export(&self, path: &Path, notes: &serde_json::Value) -> Result<()> {
        guarded(false, "writing weights", || {
            let header = serde_json::json!({
                "kind": self.model.kind,
                "model": self.model,
                "training": self.config,
                "step": self.step,
                "notes": notes,
            });
            checkpoint::write(path, &header, &variables(&self.average.store))
        })
    }

    /// All numbers that an exact resume needs, in the memory where the run has them.
    fn state(&self) -> BTreeMap<String, Tensor> {
        let Adam { parameters, first, second } = &self.adam;
        let parts = [
            ("weights", variables(&self.store)),
            ("average", variables(&self.average.store)),
            ("first", parameters.views(first)),
            ("second", parameters.views(second)),
        ];
        let named = |(part, tensors): (&'static str, BTreeMap<String, Tensor>)| {
            tensors.into_iter().map(move |(name, tensor)| (format!("{part}.{name}"), tensor))
        };
        parts.into_iter().flat_map(named).collect()
    }

    /// Writes everything that an exact resume needs.
    ///
    /// # Errors
    /// [`ModelError::Io`] where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        guarded(false, "writing a training state", || {
            let header = serde_json::json!({
                "kind": "ccdiff-training",
                "model": self.model,
                "training": self.config,
                "step": self.step,
                "cooldown": self.cooldown,
            });
            checkpoint::write(path, &header, &self.state())
        })
    }

    /// Continues where [`Self::save`] stood; model and training settings must be the file's.
    ///
    /// # Errors
    /// [`ModelError::Checkpoint`] where the file is of another run, or damaged.
    pub fn resume(&mut self, path: &Path) -> Result<()> {
        guarded(false, "reading a training state", || {
            let (header, tensors) = checkpoint::read(path)?;
            let (model, training): (ModelConfig, TrainConfig) = settings_in(path, &header)?;
            for (name, same) in [("model", model == self.model), ("training", training == self.config)] {
                if !same {
                    return Err(broken(path, name, "of other settings", "the settings of this run"));
                }
            }
            checkpoint::fill(path, &tensors, &mut self.state())?;
            self.step = checkpoint::field(path, &header, "step")?;
            self.cooldown = checkpoint::field(path, &header, "cooldown")?;
            Ok(())
        })
    }
}

/// Model and training settings of a training state, so that a resumed run is built alike.
///
/// # Errors
/// [`ModelError::Io`], [`ModelError::Checkpoint`].
pub fn settings_of(path: &Path) -> Result<(ModelConfig, TrainConfig)> {
    settings_in(path, &weights::read(path)?.0)
}

fn settings_in(path: &Path, header: &serde_json::Value) -> Result<(ModelConfig, TrainConfig)> {
    Ok((checkpoint::field(path, header, "model")?, checkpoint::field(path, header, "training")?))
}

impl Validation {
    /// Adds the errors of plans to the sums of those before.
    fn add(&mut self, states: &Tensor, speed: &Tensor, targets: &Targets, samples: i64, dt_s: f64) {
        let size = targets.states.size();
        let (rows, steps) = (size[0], size[1]);
        let logged = targets.states.narrow(2, 0, 2);
        let whole = targets.valid.amin([1i64].as_slice(), false);
        let distance = |path: &Tensor| {
            (path - &logged).square().sum_dim_intlist([-1i64].as_slice(), false, Kind::Float).sqrt()
        };
        let of_samples = distance(&states.narrow(2, 0, 2).view([samples, rows, steps, 2]));
        let times = (Tensor::arange(steps, (Kind::Float, speed.device())) + 1.0) * dt_s;
        let ahead = speed.unsqueeze(1) * times;
        let of_constant = distance(&Tensor::stack(&[&ahead, &ahead.zeros_like()], 2));
        let mean = |t: &Tensor| t.mean_dim([-1i64].as_slice(), false, Kind::Float);
        let end = |t: &Tensor| t.select(-1, steps - 1);
        let found = [
            mean(&of_samples).amin([0i64].as_slice(), false),
            end(&of_samples).amin([0i64].as_slice(), false),
            mean(&of_samples.select(0, 0)),
            end(&of_samples.select(0, 0)),
            mean(&of_constant),
            end(&of_constant),
        ];
        for (sum, value) in self.errors_m.iter_mut().zip(&found) {
            *sum += (value * &whole).sum(Kind::Double).double_value(&[]);
        }
        self.num_agents += whole.sum(Kind::Double).double_value(&[]) as usize;
    }
}
