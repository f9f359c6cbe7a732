//! What can be chosen about the drivers of a world.

use crate::geom::Real;
use crate::options;
use crate::options::{Form, Setting, above, at_least};
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

options! {
    /// Parameters of the intelligent driver model (Treiber, Hennecke, Helbing 2000).
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct IdmConfig {
        /// Time headway T.
        headway_s: Real = 1.2, unit "s", range above(0.0);
        /// Gap at standstill s₀.
        min_gap_m: Real = 2.0, unit "m", range at_least(0.0);
        /// Greatest acceleration a.
        acceleration_mps2: Real = 1.5, unit "m/s²", range above(0.0);
        /// Comfortable deceleration b.
        deceleration_mps2: Real = 2.5, unit "m/s²", range above(0.0);
        /// Hardest braking.
        max_braking_mps2: Real = 8.0, unit "m/s²", range above(0.0);
        /// Acceleration exponent δ.
        exponent: Real = 4.0, range above(0.0);
        /// Others are also looked for where they will be, at constant velocity, after this time.
        anticipation_s: Real = 1.0, unit "s", range at_least(0.0);
    }
}
