//! What can be chosen about the traffic of a planning network.

use crate::config::ModelKind;
use crate::error::{ModelError, Result};
use crate::guidance::{AgentCollision, GuidanceConfig, MapCollision, Objective};
use crate::planner::PlanOptions;
use crate::sampler::{SampleOptions, Solver};
use ccdiff_sim::causal::rank::{CliqueSettings, GreedyOrder, Ranker};
use ccdiff_sim::geom::Real;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Who drives the vehicles outside the guided set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Others {
    /// CCDiff without guidance.
    Ccdiff,
    /// The intelligent driver model along their routes.
    Idm,
    /// The log (paper, as released). Who has left the log by being guided once never returns to it.
    Replay,
}

/// How the vehicles to be guided are found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ranking {
    /// Occurrence in heavy cliques of the time-to-contact graph over the history (as the released lists).
    Cliques,
    /// The paper's greedy cliques on G times attention.
    Greedy,
    /// Occurrence in heavy cliques of the distance graph.
    Distance,
    /// The order of the scene, the ego first: what the release calls random.
    First,
    /// A shuffle from the world's own seed.
    Random,
    /// Alignment of the gradients of realism and guidance (the paper's ideal definition).
    Gradient,
    /// Lists of agent ids by scene name, as of a human; scenes without a list are filled by nearness.
    List(BTreeMap<String, Vec<String>>),
}

/// The decision causal graph that the network sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraphMode {
    /// Edges within the thresholds of the weights: 3 s to contact, 50 m.
    Causal,
    /// An edge between all pairs (ablation "Enc" off), as far as the network has slots.
    Full,
}

/// Contacts with whom count in the collision objectives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Partners {
    /// The ego, and every vehicle that is driven from outside.
    Ego,
    /// Every vehicle (paper).
    All,
}

/// Which vehicles stand still for the whole episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frozen {
    /// Those that never move in the log.
    Parked,
    /// Those slower than 0.5 m/s in the log at the start (as released).
    Standing,
}

/// Configuration of CCDiff traffic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CcdiffConfig {
    /// Weights: a name of shipped ones, or a file.
    pub weights: String,
    /// `cpu` or `cuda`.
    pub device: String,
    /// Steps from one plan to the next n.
    pub replan_steps: usize,
    /// Network evaluations of the DDIM sampler; DDPM with all steps if absent.
    pub denoising_steps: Option<usize>,
    /// Samples per plan N.
    pub num_samples: usize,
    /// Weight w of the conditional branch in classifier-free guidance, in [1, 2).
    pub cfg_weight: f64,
    /// Whether a plan starts with the acceleration and the yaw rate that its vehicle has now.
    pub tie_first_knot: bool,
    /// Whether a vehicle keeps the noise that its plans are drawn from for the whole episode.
    pub keep_noise: bool,
    /// The graph G that the network sees.
    pub graph: GraphMode,
    /// Vehicles that are guided K; all if absent.
    pub num_guided: Option<usize>,
    /// How they are found.
    pub ranking: Ranking,
    /// Whether they are found anew at every plan, not only at the first one.
    pub rerank: bool,
    /// Who drives the other vehicles.
    pub others: Others,
    /// Share of each move of the guidance that is made, at least 0: 0 is traffic without guidance, 1 the guidance as
    /// configured. Worlds may be told another one.
    pub criticality: Real,
    /// Name of a guidance preset, or a [`GuidanceConfig`].
    pub guidance: serde_json::Value,
    /// Whether only the K vehicles are moved by guidance (the mask ρ); else all (ablation "Guide" off).
    pub mask_guidance: bool,
    /// Contacts with whom count in the collision objectives.
    pub partners: Partners,
    /// Whether plans keep attention and gradient statistics, at some cost.
    pub explain: bool,
    /// Which vehicles do not move at all.
    pub frozen: Frozen,
}

impl Default for CcdiffConfig {
    fn default() -> Self {
        Self {
            weights: "fast".into(),
            device: "cpu".into(),
            replan_steps: 5,
            denoising_steps: Some(5),
            num_samples: 1,
            cfg_weight: 1.0,
            tie_first_knot: false,
            keep_noise: false,
            graph: GraphMode::Causal,
            num_guided: Some(5),
            ranking: Ranking::Cliques,
            rerank: true,
            others: Others::Ccdiff,
            criticality: 0.0,
            guidance: "rl".into(),
            mask_guidance: true,
            partners: Partners::Ego,
            explain: false,
            frozen: Frozen::Parked,
        }
    }
}

impl CcdiffConfig {
    /// Checks every range against the horizon of the weights, steps.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn validate(&self, horizon_steps: usize) -> Result<()> {
        if !(1..=horizon_steps).contains(&self.replan_steps) {
            return Err(ModelError::Config {
                field: "ccdiff.replan_steps",
                got: self.replan_steps.to_string(),
                expected: "1 up to the horizon of the plans",
            });
        }
        if !(self.criticality >= 0.0 && self.criticality.is_finite()) {
            return Err(ModelError::Config {
                field: "ccdiff.criticality",
                got: self.criticality.to_string(),
                expected: "a finite number of at least 0",
            });
        }
        self.guided()?.validated()?;
        self.unguided().validated()?;
        Ok(())
    }

    /// Checks that all of it means something to a kind of network.
    ///
    /// # Errors
    /// [`ModelError::Config`] names the field.
    pub fn check_kind(&self, kind: ModelKind) -> Result<()> {
        let fail = |field: &'static str, got: String, expected: &'static str| {
            Err(ModelError::Config { field, got, expected })
        };
        if self.graph == GraphMode::Full && kind != ModelKind::Ccdiff {
            return fail("ccdiff.graph", "full".into(), "causal: this network sees neighbours by distance");
        }
        match self.ranking {
            Ranking::Greedy if !kind.attends() => {
                fail("ccdiff.ranking", "greedy".into(), "one without attention: this network has none")
            }
            Ranking::Gradient if !kind.denoises() => {
                fail("ccdiff.ranking", "gradient".into(), "one without scores: this network does not denoise")
            }
            _ => self.guided()?.of_kind(kind).map(drop),
        }
    }

    /// How the plans of worlds with guidance are drawn.
    ///
    /// # Errors
    /// [`ModelError::Config`] for an unknown preset or settings of another form.
    pub fn guided(&self) -> Result<PlanOptions> {
        let guidance = match &self.guidance {
            serde_json::Value::String(name) => GuidanceConfig::preset(name)?,
            settings => serde_json::from_value(settings.clone()).map_err(|e| ModelError::Config {
                field: "ccdiff.guidance",
                got: e.to_string(),
                expected: "the name of a preset, or settings of guidance",
            })?,
        };
        Ok(PlanOptions {
            sampling: self.sampling(),
            guidance: Some(guidance),
            attention: self.explain,
            gradient_statistics: self.explain,
        })
    }

    /// How the plans of worlds without guidance are drawn: of several samples the one that touches least and stays on
    /// the road is taken, as in the released code (reference.md#sampling).
    pub fn unguided(&self) -> PlanOptions {
        let filter = GuidanceConfig {
            objectives: vec![
                Objective::AgentCollision(AgentCollision { weight: 1.0, ..AgentCollision::default() }),
                Objective::MapCollision(MapCollision { weight: 1.0 }),
            ],
            gradient_steps: 0,
            ..GuidanceConfig::released()
        };
        PlanOptions {
            sampling: self.sampling(),
            guidance: (self.num_samples > 1).then_some(filter),
            attention: self.explain,
            gradient_statistics: false,
        }
    }

    /// Options of the sampler.
    pub fn sampling(&self) -> SampleOptions {
        let solver = self.denoising_steps.map_or(Solver::Ddpm, |steps| Solver::Ddim { steps });
        SampleOptions { solver, num_samples: self.num_samples, guidance_weight: self.cfg_weight }
    }

    /// The ranker of a plan of a scene; `ids` are those of the planned agents.
    pub(super) fn ranker(&self, scene: &str, ids: &[&str], seed: u64) -> Ranker {
        match &self.ranking {
            Ranking::Cliques => Ranker::CliqueOccurrence(CliqueSettings::PARITY),
            Ranking::Distance => Ranker::Distance(CliqueSettings::PARITY),
            Ranking::Greedy => Ranker::Greedy(GreedyOrder::default()),
            Ranking::First => Ranker::FirstK,
            Ranking::Random => Ranker::Random { seed },
            Ranking::Gradient => Ranker::Scores,
            Ranking::List(lists) => {
                let listed = lists.get(scene).into_iter().flatten();
                Ranker::Human(listed.filter_map(|id| ids.iter().position(|i| i == id)).collect())
            }
        }
    }
}
