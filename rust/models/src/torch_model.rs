//! Networks of weight files on torch.

use crate::batch::Batch;
use crate::checkpoint::{self, variables};
use crate::config::ModelConfig;
use crate::error::Result;
use crate::features::SceneFeatures;
use crate::grad::guarded;
use crate::guidance::Guide;
use crate::kinds::build;
use crate::plan_model::PlanModel;
use crate::traffic::{CcdiffConfig, PlannedTraffic};
use crate::trajectory_model::{Drawn, PlanOptions, PlanSampler, TrajectoryModel};
use ccdiff_nets::compute::weights::{self, Entry};
use ccdiff_nets::networks::cpu_planner::drawn;
use ccdiff_nets::networks::kinds::described;
use ccdiff_nets::sampling::plan_space::PlanSpace;
use ccdiff_nets::traffic::planning_pool;
use std::collections::BTreeMap;
use std::path::Path;
use tch::{Device, nn};

/// A network on torch with the weights of a file.
#[derive(Debug)]
pub(crate) struct TorchModel {
    pub(crate) network: Box<dyn PlanModel>,
    pub(crate) store: nn::VarStore,
}

impl TorchModel {
    /// From the tensors of a file, checking every name and shape.
    pub(crate) fn of(
        path: &Path,
        config: &ModelConfig,
        entries: &BTreeMap<String, Entry>,
        device: Device,
    ) -> Result<Self> {
        guarded(false, "loading weights", || {
            let mut store = nn::VarStore::new(device);
            let network = build(&store.root(), config)?;
            store.freeze();
            checkpoint::fill(path, &checkpoint::tensors(entries), &mut variables(&store))?;
            Ok(Self { network, store })
        })
    }
}

impl PlanSampler for TorchModel {
    fn most_worlds(&self) -> usize {
        8
    }

    fn draw(
        &self,
        scenes: &[SceneFeatures],
        seeds: &[u64],
        options: &PlanOptions,
        guide: Guide<'_, '_>,
    ) -> Result<Drawn> {
        guarded(false, "planning", || {
            let (config, batch) =
                (self.network.space().config(), Batch::new(scenes.to_vec(), self.store.device())?);
            let asked = options.asked(batch.rows(), seeds, config);
            let proposed = self.network.propose(&batch, &asked, guide)?;
            Ok(drawn(&PlanSpace::new(config), scenes, proposed))
        })
    }
}

/// Loads a weight file on torch, on any device, checking every name and shape.
///
/// # Errors
/// [`crate::ModelError::Io`], [`crate::ModelError::Checkpoint`], [`crate::ModelError::Config`].
pub fn load(path: &Path, device: Device) -> Result<TrajectoryModel> {
    let (header, entries) = weights::read(path)?;
    let config = described(path, &header)?;
    let model = TorchModel::of(path, &config, &entries, device)?;
    let num_parameters = entries.values().map(|(_, numbers)| numbers.len()).sum();
    TrajectoryModel::of(Box::new(model), header, config, num_parameters)
}

/// Traffic of a weight file, of whatever kind of network. On the processor worlds are planned for on `num_threads` threads, in
/// each of which torch uses one: operations of torch never wait for one another. Results do not depend on their number.
///
/// # Errors
/// As [`load`]; [`crate::ModelError::Config`] for options that do not fit the network.
pub fn planned_traffic(config: CcdiffConfig, weights: &Path, num_threads: usize) -> Result<PlannedTraffic> {
    let device = crate::device_named(&config.device)?;
    if device != Device::Cpu {
        return PlannedTraffic::of(config, vec![load(weights, device)?], None);
    }
    let copies = (0..num_threads.max(1)).map(|_| load(weights, device)).collect::<Result<_>>()?;
    let pool = planning_pool(num_threads)?;
    // torch keeps this by thread. A thread that it does not know yet takes the number of the process at its first
    // operation, whatever was set before: asking for the number makes it known. The caller's own setting is as before.
    let callers = tch::get_num_threads();
    pool.broadcast(|_| {
        tch::get_num_threads();
        tch::set_num_threads(1);
    });
    tch::set_num_threads(callers);
    PlannedTraffic::of(config, copies, Some(pool))
}
