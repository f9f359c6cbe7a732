//! Agents that matter to one of them, the ego, by their states alone: cliques, nearness, contact, order or chance.

use super::{CliqueSettings, RankInput, Ranker};
use crate::causal::measures::{AgentHistory, Ttc, normalised_distance, normalised_ttc};
use crate::error::{Result, SimError};
use crate::geom::Real;

/// How the agents are ranked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyRanking {
    /// Occurrence in heavy cliques of the time-to-contact graph over the history.
    Cliques,
    /// Distance of the centres from the ego now.
    Nearest,
    /// Time to contact with the ego now, then distance from it.
    Ttc,
    /// The scene's order.
    First,
    /// A shuffle that depends on the seed alone.
    Random {
        /// Seed of the shuffle.
        seed: u64,
    },
}

impl KeyRanking {
    /// The candidates [M] that are there at the last step, the ego left out, most important first.
    ///
    /// # Errors
    /// [`SimError::Length`] where `candidates` does not fit the history, [`SimError::Unknown`] for an ego that it does not
    /// have.
    pub fn rank(self, history: &AgentHistory<'_>, candidates: &[bool], ego_idx: usize) -> Result<Vec<usize>> {
        let num_agents = history.num_agents();
        if candidates.len() != num_agents {
            return Err(SimError::Length { what: "candidates", got: candidates.len(), expected: num_agents });
        }
        if ego_idx >= num_agents {
            let (got, expected) = (ego_idx.to_string(), format!("below {num_agents}"));
            return Err(SimError::Unknown { what: "ego index", got, expected });
        }
        let Some(now) = history.frames().last() else { return Ok(Vec::new()) };
        let there: Vec<bool> =
            (0..num_agents).map(|i| i != ego_idx && candidates[i] && now.is_valid(i)).collect();
        let of_ranker = |ranker: &Ranker, input: &RankInput<'_>| {
            let agents = ranker.rank(input, num_agents)?.agents;
            Ok(agents.into_iter().filter(|&i| there[i]).collect())
        };
        let mut agents: Vec<usize> = (0..num_agents).filter(|&i| there[i]).collect();
        let distance_m = now.distance_from_m(ego_idx);
        match self {
            Self::Nearest => agents.sort_by(|&a, &b| distance_m[a].total_cmp(&distance_m[b])),
            Self::Ttc => {
                let mut ttc_s = vec![0.0; num_agents * num_agents];
                now.ttc_s(Ttc::Oriented, &vec![0.0; num_agents], &mut ttc_s)?;
                let of_ego = &ttc_s[ego_idx * num_agents..(ego_idx + 1) * num_agents];
                let key = |i: usize| (of_ego[i], distance_m[i]);
                agents.sort_by(|&a, &b| {
                    let ((one_s, one_m), (other_s, other_m)) = (key(a), key(b));
                    one_s.total_cmp(&other_s).then(one_m.total_cmp(&other_m))
                });
            }
            Self::Cliques => {
                let valid: Vec<bool> = (0..num_agents).map(|i| now.is_valid(i)).collect();
                let ttc: Vec<Real> = history.ttc_s(Ttc::Oriented).into_iter().map(normalised_ttc).collect();
                let distance: Vec<Real> =
                    history.distance_m()?.into_iter().map(normalised_distance).collect();
                let input =
                    RankInput { valid: &valid, ttc: &ttc, distance: &distance, ..RankInput::default() };
                return of_ranker(&Ranker::CliqueOccurrence(CliqueSettings::REFERENCE_IMPL), &input);
            }
            Self::First => {}
            Self::Random { seed } => {
                return of_ranker(
                    &Ranker::Random { seed },
                    &RankInput { valid: &there, ..RankInput::default() },
                );
            }
        }
        Ok(agents)
    }
}
