//! The networks on torch.

use crate::config::ModelConfig;
use crate::error::Result;
use crate::plan_model::{PlanModel, TorchKind};
use crate::torch::Torch;
use crate::train::config::TrainConfig;
use ccdiff_nets::networks::bits::Bits;
use ccdiff_nets::networks::ctg::HalfUnet;
use ccdiff_nets::networks::denoising::Denoising;
use ccdiff_nets::networks::kinds::named;
use ccdiff_nets::networks::latents::Cvae;
use ccdiff_nets::networks::simnet::Simnet;
use ccdiff_nets::networks::{ccdiff, tokens};
use tch::nn;

/// All of [`ccdiff_nets::networks::NETWORKS`]; a new one is a line here.
static NETWORKS: &[TorchKind] = &[
    TorchKind::of::<Denoising<ccdiff::Network<Torch>>>("ccdiff"),
    TorchKind::of::<Simnet<Torch>>("simnet"),
    TorchKind::of::<Cvae<Torch>>("trafficsim"),
    TorchKind::of::<Cvae<Torch>>("strive"),
    TorchKind::of::<Bits<Torch>>("bits"),
    TorchKind::of::<Denoising<HalfUnet<Torch>>>("ctg"),
    TorchKind::of::<Denoising<ccdiff::Network<Torch>>>("ctgpp"),
    TorchKind::of::<tokens::Network<Torch>>("tokens"),
];

fn of(name: &str) -> Result<&'static TorchKind> {
    let name = named(name)?.kind.name;
    let found = NETWORKS.iter().find(|network| network.name == name);
    found.ok_or_else(|| crate::ModelError::torch("building", &format!("no network {name}")))
}

/// A network with fresh weights under a path.
///
/// # Errors
/// [`crate::ModelError::Config`] for a configuration that it cannot be built from.
pub fn build(p: &nn::Path, config: &ModelConfig) -> Result<Box<dyn PlanModel>> {
    config.network()?.check(config)?;
    Ok((of(config.kind.as_str())?.build)(p, config))
}

impl TrainConfig {
    /// Settings of a preset for a network (reference.md#training-settings); `fast` takes larger steps and batches, as it has
    /// minutes, not days. G is dropped in the training of networks that see it.
    ///
    /// # Errors
    /// [`crate::ModelError::Config`] for another name than `paper` and `fast`, or an unknown network.
    pub fn of(network: &str, preset: &str) -> Result<Self> {
        let paper = Self::default();
        let drop_graph = if named(network)?.causal { paper.drop_graph } else { 0.0 };
        match preset {
            "paper" => Ok(Self { drop_graph, ..paper }),
            "fast" => Ok((of(network)?.fast)(Self { drop_graph, ..Self::fast() })),
            _ => Err(crate::config::unknown_preset(preset)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_network_is_there() {
        let known = ccdiff_nets::networks::NETWORKS.iter().map(|network| network.kind.name);
        assert!(NETWORKS.iter().map(|network| network.name).eq(known));
    }
}
