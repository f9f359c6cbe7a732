//! What can be chosen about the drivers of a world.

use crate::geom::Real;
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

/// Parameters of the intelligent driver model (Treiber, Hennecke, Helbing 2000).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IdmConfig {
    /// Time headway T, seconds.
    pub headway_s: Real,
    /// Gap at standstill s₀, metres.
    pub min_gap_m: Real,
    /// Greatest acceleration a, m/s².
    pub acceleration_mps2: Real,
    /// Comfortable deceleration b, m/s².
    pub deceleration_mps2: Real,
    /// Hardest braking, m/s².
    pub max_braking_mps2: Real,
    /// Acceleration exponent δ.
    pub exponent: Real,
    /// Others are also looked for where they will be, at constant velocity, after this time, seconds.
    pub anticipation_s: Real,
}

impl Default for IdmConfig {
    fn default() -> Self {
        Self {
            headway_s: 1.2,
            min_gap_m: 2.0,
            acceleration_mps2: 1.5,
            deceleration_mps2: 2.5,
            max_braking_mps2: 8.0,
            exponent: 4.0,
            anticipation_s: 1.0,
        }
    }
}

impl IdmConfig {
    /// The first field that is out of its range, with its value and the range.
    pub fn first_fault(&self) -> Option<(&'static str, Real, &'static str)> {
        let positive = [
            ("idm.headway_s", self.headway_s),
            ("idm.acceleration_mps2", self.acceleration_mps2),
            ("idm.deceleration_mps2", self.deceleration_mps2),
            ("idm.max_braking_mps2", self.max_braking_mps2),
            ("idm.exponent", self.exponent),
        ];
        let not_negative = [("idm.min_gap_m", self.min_gap_m), ("idm.anticipation_s", self.anticipation_s)];
        let bad = positive.into_iter().find(|(_, v)| !(v.is_finite() && *v > 0.0));
        bad.map(|(field, v)| (field, v, "a positive number")).or_else(|| {
            let bad = not_negative.into_iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0));
            bad.map(|(field, v)| (field, v, ">= 0"))
        })
    }
}
