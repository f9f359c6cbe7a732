//! What a user can choose about a load.

use crate::error::{NuscenesError, Result};
use ccdiff_sim::scene::AgentKind;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Seconds between key frames of nuScenes.
pub const KEY_FRAME_INTERVAL_S: f64 = 0.5;

/// From the rear axle of nuScenes' recording car to the middle of its length, metres. A Renault Zoe is 4.084 m long, has its
/// axles 2.588 m apart and overhangs the rear one by 0.657 m (Renault's drawing of the car; py123d takes the same 1.385 m).
/// That ego poses are of the rear axle says nuscenes-devkit#108.
pub const EGO_AXLE_TO_CENTRE_M: f64 = 1.385;

/// When key frames were.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeyFrameTiming {
    /// At their timestamps.
    #[default]
    Recorded,
    /// Every half second, whatever their timestamps, as the paper's released code has it (reference.md#time-base).
    Nominal,
}

/// Which point of the recording car its poses are of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoReference {
    /// The middle of the rear axle, as in nuScenes: the centre of the box is [`EGO_AXLE_TO_CENTRE_M`] ahead.
    #[default]
    RearAxle,
    /// The centre of the box, as the paper's released code takes them.
    Centre,
}

impl EgoReference {
    /// How far ahead of a pose the centre of the box is, metres.
    pub(crate) fn to_centre_m(self) -> f64 {
        match self {
            Self::RearAxle => EGO_AXLE_TO_CENTRE_M,
            Self::Centre => 0.0,
        }
    }
}

/// How states between key frames are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// Cubic smoothing splines in position and unwrapped heading, through the poses of the ego and within the annotation noise
    /// of those of others; velocity is the slope of the position.
    #[default]
    Smooth,
    /// Straight lines in position, unwrapped heading and velocity (reference.md#time-base).
    Linear,
}

/// How scenes are built from the tables, as `ccdiff_env.load_nuscenes` describes it. All of it is part of the cache key.
#[allow(missing_docs, reason = "fields are described in ccdiff_env/scenes/__init__.py")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BuildOptions {
    pub dt_s: f64,
    pub timing: KeyFrameTiming,
    pub interpolation: Interpolation,
    pub ego_reference: EgoReference,
    pub kinds: Option<Vec<AgentKind>>,
    pub map_margin_m: f64,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self {
            dt_s: 0.1,
            timing: KeyFrameTiming::Recorded,
            interpolation: Interpolation::Smooth,
            ego_reference: EgoReference::RearAxle,
            kinds: None,
            map_margin_m: 60.0,
        }
    }
}

impl BuildOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let steps = KEY_FRAME_INTERVAL_S / self.dt_s;
        if !(self.dt_s > 0.0 && (1.0..=1000.0).contains(&steps) && (steps - steps.round()).abs() < 1e-6) {
            return Err(NuscenesError::Option {
                field: "dt",
                got: self.dt_s.to_string(),
                expected: "a number of seconds that divides 0.5, such as 0.1",
            });
        }
        if !(0.0..=10_000.0).contains(&self.map_margin_m) {
            let got = self.map_margin_m.to_string();
            return Err(NuscenesError::Option { field: "map_margin", got, expected: "0 to 10000 metres" });
        }
        Ok(())
    }
}

/// Which scenes to load.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Selection {
    /// All, in the order of the scene table.
    #[default]
    All,
    /// Those of these names that the data set has, in the order of the scene table; the report lists the others.
    AnyOf(Vec<String>),
    /// Exactly these, by name or token, in this order; one that is missing is an error.
    Exactly(Vec<String>),
}

/// Everything about a load.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LoadOptions {
    /// Which scenes.
    pub selection: Selection,
    /// How they are built.
    pub build: BuildOptions,
    /// Folder for built scenes; `None` switches the cache off.
    pub cache_directory: Option<PathBuf>,
}
