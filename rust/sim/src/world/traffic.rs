//! What can be chosen about the drivers of a world.

use crate::geom::Real;
use crate::options::{Form, Setting};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the driver of agents that take actions from outside.
pub const EXTERNAL: &str = "external";

/// Who drives the vehicles that are not controlled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Traffic {
    /// One policy, by name.
    All(String),
    /// Shares of policies by name, which sum to 1: drawn for each vehicle and episode from the world's seed.
    Mix(BTreeMap<String, Real>),
}

impl Setting for Traffic {
    const FORM: Form = Form::Named(&BTreeMap::<String, Real>::FORM);
}

impl Traffic {
    /// Names of the policies.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let (one, mix) = match self {
            Self::All(name) => (Some(name.as_str()), None),
            Self::Mix(shares) => (None, Some(shares.keys().map(String::as_str))),
        };
        one.into_iter().chain(mix.into_iter().flatten())
    }
}

impl From<&str> for Traffic {
    fn from(name: &str) -> Self {
        Self::All(name.into())
    }
}
