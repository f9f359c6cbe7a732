//! What can be chosen about the drivers of a world.

use crate::geom::Real;
use crate::options::{Form, Setting};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the driver of agents that take actions from outside.
pub const EXTERNAL: &str = "external";

/// Drivers of the vehicles that are not controlled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Traffic {
    /// One driver, by name.
    All(String),
    /// Shares of drivers by name, which sum to 1: drawn for each vehicle and episode from the world's seed.
    Mix(BTreeMap<String, Real>),
}

impl Setting for Traffic {
    const FORM: Form = Form::Named(&BTreeMap::<String, Real>::FORM);
}

impl Traffic {
    /// Drivers by name, each with its share.
    pub fn shares(&self) -> Vec<(&str, Real)> {
        match self {
            Self::All(name) => vec![(name, 1.0)],
            Self::Mix(shares) => shares.iter().map(|(name, share)| (name.as_str(), *share)).collect(),
        }
    }
}

impl From<&str> for Traffic {
    fn from(name: &str) -> Self {
        Self::All(name.into())
    }
}
