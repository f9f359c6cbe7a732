//! Rankings of key agents: who takes part in what is about to happen.
//!
//! A [`Ranker`] orders the agents of one scene; [`Ranker::rank`] takes the first of them and, where the ranker names
//! too few, fills up in a fixed way: by ascending time to contact, then distance, then index.

mod clique_search;
mod greedy;
mod occurrence;

pub use clique_search::{HeaviestCliques, WeightedGraph};
pub use greedy::{GreedyOrder, greedy_order};
pub use occurrence::{CliqueSettings, Occurrences, clique_occurrences};

use super::graph::CausalGraph;
use crate::error::{Result, SimError, check_length};
use crate::geom::Real;

/// How key agents are found.
#[derive(Debug, Clone, PartialEq)]
pub enum Ranker {
    /// Occurrence in heavy cliques of the time-to-contact graph over the history.
    CliqueOccurrence(CliqueSettings),
    /// The same on relative distances in place of times to contact (the ablation "Dist").
    DistanceCliques(CliqueSettings),
    /// The paper's greedy cliques on G times attention.
    Greedy(GreedyOrder),
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
    /// The decision causal graph G now.
    pub graph: Option<&'a CausalGraph>,
    /// Attention [M, M] of row i to column j; 1 everywhere if absent.
    pub attention: Option<&'a [Real]>,
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
            exact = found.exact;
            Ok::<_, SimError>(found.counts.into_iter().map(|(agent, _)| agent).collect())
        };
        let named: Vec<usize> = match self {
            Self::CliqueOccurrence(settings) => cliques(input.ttc, settings)?,
            Self::DistanceCliques(settings) => cliques(input.distance, settings)?,
            Self::Greedy(order) => greedy_order(num_agents, &graph_weights(input)?, *order)?,
            Self::FirstK => (0..num_agents).collect(),
            Self::Random { seed } => shuffled(num_agents, *seed),
            Self::Listed(list) => listed(list, num_agents)?,
            Self::Scores => by_falling_score(input)?,
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

fn missing(what: &'static str, ranker: &str) -> SimError {
    SimError::config(what, "nothing", format!("given for the {ranker} ranking"))
}

/// G times attention [M, M].
fn graph_weights(input: &RankInput<'_>) -> Result<Vec<f64>> {
    let graph = input.graph.ok_or_else(|| missing("rank.graph", "greedy"))?;
    let pairs = input.valid.len() * input.valid.len();
    let attention = input.attention.map_or(pairs, <[Real]>::len);
    for (what, got) in [("graph G", graph.as_slice().len()), ("attention", attention)] {
        check_length(what, got, pairs)?;
    }
    let weight = |k: usize| input.attention.map_or(1.0, |a| f64::from(a[k]));
    Ok(graph.as_slice().iter().enumerate().map(|(k, &joined)| if joined { weight(k) } else { 0.0 }).collect())
}

fn listed(list: &[usize], num_agents: usize) -> Result<Vec<usize>> {
    match list.iter().find(|&&agent| agent >= num_agents) {
        Some(agent) => Err(SimError::unknown("agent index", agent, format!("below {num_agents}"))),
        None => Ok(list.to_vec()),
    }
}

/// By falling score; ties to the smaller index, scores that are not numbers last.
fn by_falling_score(input: &RankInput<'_>) -> Result<Vec<usize>> {
    let scores = input.scores.ok_or_else(|| missing("rank.scores", "score"))?;
    let num_agents = input.valid.len();
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

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR: [Real; 16] = {
        // agent 2 nearest to contact, then 3 (seen by agent 0 only), 0 and 1 not at all
        let mut m = [0.0; 16];
        m[2 * 4 + 3] = 0.9;
        m
    };

    fn rank(ranker: &Ranker, input: &RankInput<'_>, top_k: usize) -> Vec<usize> {
        ranker.rank(input, top_k).unwrap().agents
    }

    #[test]
    fn short_lists_are_filled_by_contact_then_distance_then_index() {
        let mut distance = [0.0; 16];
        distance[1] = 0.3; // agents 0 and 1
        let input = RankInput { valid: &[true; 4], ttc: &NEAR, distance: &distance, ..RankInput::default() };
        let named = Ranker::Listed(vec![1]).rank(&input, 4).unwrap();
        assert_eq!(named, Ranking { agents: vec![1, 2, 3, 0], num_named: 1, exact: true });
        assert_eq!(rank(&Ranker::CliqueOccurrence(CliqueSettings::REFERENCE_IMPL), &input, 3), [2, 3, 0]);
        assert_eq!(rank(&Ranker::DistanceCliques(CliqueSettings::REFERENCE_IMPL), &input, 3), [0, 1, 2]);
    }
}
