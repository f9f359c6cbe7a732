//! Networks by name, and the sizes that they may have.

use crate::compute::weights;
use crate::config::{HistoryTokens, ModelConfig};
use crate::error::{Result, require};
use crate::networks::NETWORKS;
use crate::networks::kind::NetworkKind;
use ccdiff_sim::SimError;
use std::path::Path;

/// The network of a name.
///
/// # Errors
/// [`crate::ModelError::Sim`] for any other name, with those that there are.
pub fn named(name: &str) -> Result<&'static NetworkKind> {
    let found = NETWORKS.iter().find(|network| network.kind.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = NETWORKS.iter().map(|network| network.kind.name).collect();
        let (got, expected) = (format!("{name:?}"), format!("one of {}", names.join(", ")));
        SimError::Config { field: "model".into(), got, expected }.into()
    })
}

impl ModelConfig {
    /// A network in a preset's sizes.
    ///
    /// # Errors
    /// [`crate::ModelError`] for an unknown name or preset, and for a preset that the network does not fit.
    pub fn of(name: &str, preset: &str) -> Result<Self> {
        let network = named(name)?;
        (network.sizes)(Self { kind: name.into(), ..Self::preset(preset)? }).validated()
    }

    /// What is known of its network.
    ///
    /// # Errors
    /// As [`named`].
    pub fn network(&self) -> Result<&'static NetworkKind> {
        named(self.kind.as_str())
    }

    /// Checks every range, that the sizes fit together, and that its network can have them: a header of a weight file could
    /// say anything.
    ///
    /// # Errors
    /// [`crate::ModelError`] names the first field that is wrong.
    pub fn validated(self) -> Result<Self> {
        self.check_sizes()?;
        self.network()?.check(&self)?;
        Ok(self)
    }
}

/// What a weight file says of its network: header and configuration, checked.
///
/// # Errors
/// [`crate::ModelError::Checkpoint`], [`crate::ModelError::Config`].
pub fn described(path: &Path, header: &serde_json::Value) -> Result<ModelConfig> {
    let config = weights::field::<ModelConfig>(path, header, "model")?.validated()?;
    let kind: String = weights::field(path, header, "kind")?;
    if kind != config.kind.as_str() {
        let expected = format!("weights of {:?}", config.kind.as_str());
        return Err(weights::broken(path, "kind", format!("{kind:?}"), expected));
    }
    Ok(config)
}

/// Checks that a network of these sizes is computed by the kernels of this crate.
///
/// # Errors
/// [`crate::ModelError::Config`] names what they lack.
pub fn check_cpu(config: &ModelConfig) -> Result<()> {
    let fits = config.network()?.samples_tokens || config.history == HistoryTokens::Summary;
    require(fits, "model.history", config.history.name(), "\"summary\" without torch")
}
