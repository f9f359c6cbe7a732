//! Short trainings on scenes made by hand, and their weight files.

#![allow(dead_code, reason = "not every test file uses all of it")]

use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::Dataset;
use ccdiff_models::torch_model;
use ccdiff_models::train::{TrainConfig, Trainer};
use ccdiff_models::trajectory_model::TrajectoryModel;
use ccdiff_sim::scene::Scene;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tch::Device;

/// A file of this process.
pub(crate) fn temporary(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ccdiff-models-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(name)
}

/// Settings of the preset `fast` for batches of so many scenes, which learn from the first step on.
pub(crate) fn quick(kind: &str, batch_scenes: usize) -> TrainConfig {
    let preset = TrainConfig::of(kind, "fast").unwrap();
    TrainConfig { batch_scenes, warmup_steps: 0, perturb: false, ..preset }
}

/// A run on every `stride`-th step of scenes.
pub(crate) fn run_on(
    scenes: Vec<Arc<Scene>>,
    stride: usize,
    model: &ModelConfig,
    training: TrainConfig,
) -> Trainer {
    let data = Dataset::new(scenes, model, stride).unwrap();
    super::seeded(|| Trainer::new(model.clone(), training, data, Device::Cpu).unwrap())
}

/// The weight file of a run.
pub(crate) fn exported(run: &Trainer, name: &str) -> PathBuf {
    let path = temporary(&format!("{name}.safetensors"));
    run.export(&path, &serde_json::json!({})).unwrap();
    path
}

/// A weight file on torch.
pub(crate) fn loaded(path: &Path) -> TrajectoryModel {
    torch_model::load(path, Device::Cpu).unwrap()
}
