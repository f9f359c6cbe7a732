//! Rankings of key agents.
//!
//! A [`Ranker`] orders the agents of one scene; [`Ranker::rank`] takes the first of them and, where the ranker names
//! too few, fills up in a fixed way: by ascending time to contact, then distance, then index.

mod clique_search;
mod greedy;
mod occurrence;

pub use occurrence::CliqueSettings;

use crate::error::{Result, SimError, check_length};
use crate::geom::Real;
use greedy::greedy_order;
use occurrence::clique_occurrences;

/// How key agents are found.
#[derive(Debug, Clone, PartialEq)]
pub enum Ranker {
    /// Occurrence in heavy cliques of the time-to-contact graph over the history.
    CliqueOccurrence(CliqueSettings),
    /// The same on relative distances in place of times to contact (the ablation "Dist").
    DistanceCliques(CliqueSettings),
    /// The paper's greedy cliques on G times attention.
    Greedy,
    /// Agents in their own order, the ego first: what the release calls random.
    FirstK,
    /// A shuffle that depends on the seed alone.
    Random {
        /// Seed of the shuffle.
        seed: u64,
    },
    /// A given list, as of a human.
    Listed(Vec<usize>),
    /// By falling score of every agent, such as the alignment of the gradients of realism and guidance.
    Scores,
}

/// What rankers look at. Rankers that need an absent part refuse.
#[derive(Debug, Clone, Copy, Default)]
pub struct RankInput<'a> {
    /// Whether each of the M agents is there now.
    pub valid: &'a [bool],
    /// Normalised times to contact [T, M, M], oldest first.
    pub ttc: &'a [Real],
    /// Normalised distances [T, M, M], oldest first.
    pub distance: &'a [Real],
    /// The decision causal graph G now times attention [M, M], see [`super::graph::CausalGraph::weights`].
    pub weights: Option<&'a [Real]>,
    /// Score of each of the M agents.
    pub scores: Option<&'a [Real]>,
}

/// Key agents, most important first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ranking {
    /// Agent indices, no repeats.
    pub agents: Vec<usize>,
    /// How many of them the ranker named; the rest was filled up.
    pub num_named: usize,
    /// False where a clique search was cut short by its limit.
    pub exact: bool,
}

impl Ranker {
    /// The first `top_k` agents that are there now, fewer only where there are not as many.
    ///
    /// # Errors
    /// [`SimError::Length`] for arrays that do not fit, [`SimError::Config`] where the ranker needs a part of the
    /// input that is absent or has values out of range, [`SimError::Unknown`] for a listed agent that does not exist.
    pub fn rank(&self, input: &RankInput<'_>, top_k: usize) -> Result<Ranking> {
        let num_agents = input.valid.len();
        let mut exact = true;
        let mut cliques = |measure: &[Real], settings: &CliqueSettings| {
            let found = clique_occurrences(num_agents, measure, settings)?;
            exact = found.1;
            Ok::<_, SimError>(found.0)
        };
        let named: Vec<usize> = match self {
            Self::CliqueOccurrence(settings) => cliques(input.ttc, settings)?,
            Self::DistanceCliques(settings) => cliques(input.distance, settings)?,
            Self::Greedy => greedy_order(num_agents, given(input.weights, "rank.weights", "greedy")?)?,
            Self::FirstK => (0..num_agents).collect(),
            Self::Random { seed } => shuffled(num_agents, *seed),
            Self::Listed(list) => listed(list, num_agents)?,
            Self::Scores => by_falling_score(given(input.scores, "rank.scores", "score")?, num_agents)?,
        };
        let mut agents = Vec::with_capacity(top_k.min(num_agents));
        let mut take = |candidates: Vec<usize>| {
            for agent in candidates {
                if agents.len() < top_k && input.valid[agent] && !agents.contains(&agent) {
                    agents.push(agent);
                }
            }
            agents.len()
        };
        let num_named = take(named);
        take(fill_order(input)?);
        Ok(Ranking { agents, num_named, exact })
    }
}

fn given<'a>(what: Option<&'a [Real]>, field: &'static str, ranker: &str) -> Result<&'a [Real]> {
    what.ok_or_else(|| SimError::config(field, "nothing", format!("given for the {ranker} ranking")))
}

fn listed(list: &[usize], num_agents: usize) -> Result<Vec<usize>> {
    match list.iter().find(|&&agent| agent >= num_agents) {
        Some(agent) => Err(SimError::unknown("agent index", agent, format!("below {num_agents}"))),
        None => Ok(list.to_vec()),
    }
}

/// By falling score; ties to the smaller index, scores that are not numbers last.
fn by_falling_score(scores: &[Real], num_agents: usize) -> Result<Vec<usize>> {
    check_length("scores", scores.len(), num_agents)?;
    let key = |agent: usize| if scores[agent].is_nan() { Real::NEG_INFINITY } else { scores[agent] };
    let mut agents: Vec<usize> = (0..num_agents).collect();
    agents.sort_by(|&a, &b| key(b).total_cmp(&key(a)).then(a.cmp(&b)));
    Ok(agents)
}

/// Fisher-Yates with SplitMix64 (Steele, Lea and Flood 2014).
fn shuffled(num_agents: usize, seed: u64) -> Vec<usize> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    let mut agents: Vec<usize> = (0..num_agents).collect();
    for k in (1..num_agents).rev() {
        // the high half of the product: no bias worth speaking of for so few agents
        let other = ((u128::from(next()) * (k as u128 + 1)) >> 64) as usize;
        agents.swap(k, other);
    }
    agents
}

/// All agents by nearness to any other at the last step: time to contact, then distance, then index.
fn fill_order(input: &RankInput<'_>) -> Result<Vec<usize>> {
    let num_agents = input.valid.len();
    let ttc = nearness(input.ttc, "normalised TTC", num_agents)?;
    let distance = nearness(input.distance, "normalised distance", num_agents)?;
    let mut agents: Vec<usize> = (0..num_agents).collect();
    agents.sort_by(|&a, &b| {
        ttc[b].total_cmp(&ttc[a]).then(distance[b].total_cmp(&distance[a])).then(a.cmp(&b))
    });
    Ok(agents)
}

/// Largest normalised measure of every agent with any other, in either direction, at the last step; 0 without steps.
fn nearness(measure: &[Real], what: &'static str, num_agents: usize) -> Result<Vec<Real>> {
    let pairs = num_agents * num_agents;
    if measure.is_empty() || pairs == 0 {
        return Ok(vec![0.0; num_agents]);
    }
    if !measure.len().is_multiple_of(pairs) {
        return Err(SimError::Length { what, got: measure.len(), expected: pairs });
    }
    let last = &measure[measure.len() - pairs..];
    let of_agent = |i: usize| {
        let others = (0..num_agents).filter(|&j| j != i);
        // f32::max passes over what is not a number
        others.map(|j| last[i * num_agents + j].max(last[j * num_agents + i])).fold(0.0, Real::max)
    };
    Ok((0..num_agents).map(of_agent).collect())
}
