//! What can be chosen about CCDiff traffic.

use crate::error::{ModelError, Result};
use crate::sampler::{SampleOptions, Solver};
use ccdiff_sim::causal::rank::{CliqueSettings, GreedyOrder, Ranker};
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

/// Which vehicles stand still for the whole episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Frozen {
    /// Those that never move in the log.
    Parked,
    /// Those slower than 0.5 m/s in the log at the start (as released).
    Standing,
}

/// Configuration of [`super::Ccdiff`].
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
            graph: GraphMode::Causal,
            num_guided: Some(5),
            ranking: Ranking::Cliques,
            rerank: true,
            others: Others::Ccdiff,
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
        self.sampling().validated()?;
        Ok(())
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
            Ranking::List(lists) => {
                let listed = lists.get(scene).into_iter().flatten();
                Ranker::Human(listed.filter_map(|id| ids.iter().position(|i| i == id)).collect())
            }
        }
    }
}
