//! Which agents matter to which: pairwise measures, the decision causal graph, and rankings of key agents.
//!
//! [`measures`] turns agent states into matrices [M, M] (time to contact, distance); [`graph`] thresholds them to
//! the decision causal graph G; [`rank`] orders the agents by how much they take part in its cliques, or by
//! another rule. Everything is a pure function, so that training features, the running world and recorded scenes share
//! one code. M is the number of agents; matrices are row-major, entry (i, j) at `i * M + j`.

pub mod graph;
pub mod measures;
pub mod rank;
