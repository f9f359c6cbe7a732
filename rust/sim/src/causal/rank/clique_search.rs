//! The heaviest cliques of a weighted graph, without listing all cliques.
//!
//! A branch-and-bound search that bounds what candidates can add by colouring them. Ties are settled as a stable
//! sort by falling weight of networkx's `enumerate_all_cliques` settles them: heavier first, then fewer members,
//! then earlier in that listing, which goes by node order.

use std::cmp::Ordering;

/// Fixed-point steps per unit of weight: sums of integers do not depend on their order.
const STEPS_PER_UNIT: f64 = (1u64 << 40) as f64;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Clique {
    /// Positions in the graph's node order, ascending.
    members: Vec<u32>,
    weight: u64,
}

impl Clique {
    /// Order of preference: `Less` comes first.
    fn rank(&self, other: &Self) -> Ordering {
        other
            .weight
            .cmp(&self.weight)
            .then(self.members.len().cmp(&other.members.len()))
            .then_with(|| self.members.cmp(&other.members))
    }
}

/// An undirected graph whose joined pairs have positive weights.
#[derive(Debug, Clone)]
pub(super) struct WeightedGraph {
    /// Agent index of every node, in node order.
    agents: Vec<usize>,
    /// Weights [N, N] in fixed-point steps, symmetric; 0 where nodes are not joined and on the diagonal.
    weights: Vec<u64>,
}

impl WeightedGraph {
    /// Joins agents i and j where `measure(i, j)` or `measure(j, i)`, 0 for NaN, exceeds the threshold, with their sum as
    /// weight. Nodes are in the order in which pairs (i, j), i <= j, first mention them.
    pub(super) fn from_measure(
        num_agents: usize,
        threshold: f64,
        measure: impl Fn(usize, usize) -> f64,
    ) -> Self {
        let value = |i: usize, j: usize| {
            let v = measure(i, j);
            if v.is_nan() { 0.0 } else { v }
        };
        let mut position: Vec<Option<usize>> = vec![None; num_agents];
        let mut agents = Vec::new();
        let mut edges = Vec::new();
        for i in 0..num_agents {
            for j in i..num_agents {
                let (there, back) = (value(i, j), value(j, i));
                if there > threshold || back > threshold {
                    let mut node_of = |agent: usize| {
                        *position[agent].get_or_insert_with(|| {
                            agents.push(agent);
                            agents.len() - 1
                        })
                    };
                    let (a, b) = (node_of(i), node_of(j));
                    if a != b {
                        edges.push((a, b, there + back));
                    }
                }
            }
        }
        let num_nodes = agents.len();
        let mut weights = vec![0; num_nodes * num_nodes];
        for (a, b, weight) in edges {
            // never 0, so that the pair stays joined
            let steps = ((weight * STEPS_PER_UNIT).round() as u64).max(1);
            weights[a * num_nodes + b] = steps;
            weights[b * num_nodes + a] = steps;
        }
        Self { agents, weights }
    }

    fn num_nodes(&self) -> usize {
        self.agents.len()
    }

    fn weight(&self, a: u32, b: u32) -> u64 {
        self.weights[a as usize * self.agents.len() + b as usize]
    }

    fn weight_to(&self, node: u32, others: &[u32]) -> u64 {
        others.iter().map(|&other| self.weight(node, other)).sum()
    }

    /// At most `count` heaviest cliques of at least `min_size` nodes as agent indices, heaviest first, and whether the
    /// search was completed; it visits at most `node_limit` cliques.
    pub(super) fn heaviest_cliques(
        &self,
        min_size: usize,
        count: usize,
        node_limit: usize,
    ) -> (Vec<Vec<usize>>, bool) {
        let mut search = Search {
            graph: self,
            min_size: min_size.max(1),
            count,
            nodes_left: node_limit,
            best: Vec::with_capacity(count + 1),
            members: Vec::new(),
            exact: true,
        };
        if count > 0 {
            search.seed();
            let nodes = 0..self.num_nodes() as u32;
            let degree: Vec<u64> =
                nodes.clone().map(|a| nodes.clone().map(|b| self.weight(a, b)).sum()).collect();
            let mut candidates: Vec<Candidate> = nodes.map(|node| Candidate { node, gain: 0 }).collect();
            // heavy nodes first makes for few classes
            candidates.sort_by_key(|c| std::cmp::Reverse(degree[c.node as usize]));
            search.expand(0, candidates);
        }
        let agents = |c: &Clique| c.members.iter().map(|&p| self.agents[p as usize]).collect();
        (search.best.iter().map(agents).collect(), search.exact)
    }
}

/// A node that may join the current clique, with the sum of its weights to the members.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    node: u32,
    gain: u64,
}

struct Search<'a> {
    graph: &'a WeightedGraph,
    min_size: usize,
    count: usize,
    nodes_left: usize,
    /// The best cliques so far, best first, at most `count`.
    best: Vec<Clique>,
    members: Vec<u32>,
    exact: bool,
}

impl Search<'_> {
    fn offer(&mut self, clique: Clique) {
        if clique.members.len() < self.min_size {
            return;
        }
        if let Err(at) = self.best.binary_search_by(|kept| kept.rank(&clique))
            && at < self.count
        {
            self.best.insert(at, clique);
            self.best.truncate(self.count);
        }
    }

    /// Offers the greedy clique from every node, and its parts that lack one or two members, as cliques to beat.
    fn seed(&mut self) {
        let graph = self.graph;
        for start in 0..graph.num_nodes() as u32 {
            let mut members = vec![start];
            let mut candidates: Vec<Candidate> = (0..graph.num_nodes() as u32)
                .map(|node| Candidate { node, gain: graph.weight(start, node) })
                .filter(|c| c.gain > 0)
                .collect();
            while let Some(next) =
                candidates.iter().copied().reduce(|a, b| if b.gain > a.gain { b } else { a })
            {
                members.push(next.node);
                candidates.retain(|c| graph.weight(c.node, next.node) > 0);
                candidates.iter_mut().for_each(|c| c.gain += graph.weight(c.node, next.node));
            }
            members.sort_unstable();
            let weight = (1..members.len()).map(|k| graph.weight_to(members[k], &members[..k])).sum();
            self.offer_with_parts(Clique { members, weight }, 2);
        }
    }

    /// Offers a clique and its sub-cliques that lack up to `deletions` members.
    fn offer_with_parts(&mut self, clique: Clique, deletions: usize) {
        // sub-cliques weigh less
        let hopeless =
            self.best.len() == self.count && self.best.last().is_some_and(|w| clique.weight < w.weight);
        if hopeless || self.best.contains(&clique) {
            return;
        }
        self.offer(clique.clone());
        if deletions > 0 {
            for k in 0..clique.members.len() {
                let mut members = clique.members.clone();
                let gone = members.remove(k);
                let weight = clique.weight - self.graph.weight_to(gone, &members);
                self.offer_with_parts(Clique { members, weight }, deletions - 1);
            }
        }
    }

    /// Visits the cliques that extend the members, of some `weight`, by candidates, as far as they can be among the best.
    fn expand(&mut self, weight: u64, candidates: Vec<Candidate>) {
        if self.members.len() + candidates.len() < self.min_size {
            return;
        }
        let classes = Classes::new(self.graph, candidates);
        for class in (0..classes.ends.len()).rev() {
            for &chosen in &classes.nodes[classes.range(class)] {
                // What is left are cliques with nodes of this class and those before it.
                if !self.may_improve(weight, &classes, class) {
                    return;
                }
                if self.nodes_left == 0 {
                    self.exact = false;
                    return;
                }
                self.nodes_left -= 1;
                self.members.push(chosen.node);
                let weight = weight + chosen.gain;
                let mut members = self.members.clone();
                members.sort_unstable();
                self.offer(Clique { members, weight });
                let joined = |c: &Candidate| match self.graph.weight(chosen.node, c.node) {
                    0 => None,
                    w => Some(Candidate { node: c.node, gain: c.gain + w }),
                };
                let rest: Vec<Candidate> =
                    classes.nodes[..classes.range(class).start].iter().filter_map(joined).collect();
                if !rest.is_empty() {
                    self.expand(weight, rest);
                }
                self.members.pop();
            }
        }
    }

    /// Whether a clique of the members and nodes of the classes up to `last` could displace the worst one kept.
    fn may_improve(&self, weight: u64, classes: &Classes, last: usize) -> bool {
        if self.best.len() < self.count {
            return true;
        }
        let Some(worst) = self.best.last() else { return true };
        let bound = weight + classes.adds[..=last].iter().sum::<u64>();
        if bound != worst.weight {
            return bound > worst.weight;
        }
        // A tie at best: only with fewer members, or as many and earlier in the order.
        let needed = worst.members.len().saturating_sub(self.members.len());
        let mut adds = classes.adds[..=last].to_vec();
        adds.sort_unstable_by(|a, b| b.cmp(a));
        if weight + adds.iter().take(needed.saturating_sub(1)).sum::<u64>() >= worst.weight {
            return true;
        }
        if needed == 0 || needed > last + 1 {
            return false;
        }
        let first_of = |class: usize| classes.nodes[classes.range(class)].iter().map(|c| c.node).min();
        let mut earliest: Vec<u32> = (0..=last).filter_map(first_of).collect();
        earliest.sort_unstable();
        earliest.truncate(needed);
        earliest.extend(&self.members);
        earliest.sort_unstable();
        earliest < worst.members
    }
}

/// Candidates split into classes without joined pairs: a clique takes at most one node of each.
struct Classes {
    nodes: Vec<Candidate>,
    /// Where each class ends in `nodes`.
    ends: Vec<usize>,
    /// Most that each class adds: the largest gain of a node plus its largest weight to every earlier class.
    adds: Vec<u64>,
}

impl Classes {
    fn new(graph: &WeightedGraph, mut candidates: Vec<Candidate>) -> Self {
        let mut classes =
            Self { nodes: Vec::with_capacity(candidates.len()), ends: Vec::new(), adds: Vec::new() };
        while !candidates.is_empty() {
            let start = classes.nodes.len();
            candidates.retain(|c| {
                let free = classes.nodes[start..].iter().all(|o| graph.weight(o.node, c.node) == 0);
                if free {
                    classes.nodes.push(*c);
                }
                !free
            });
            let adds = classes.nodes[start..].iter().map(|c| c.gain + classes.reach(graph, c.node)).max();
            classes.adds.push(adds.unwrap_or(0));
            classes.ends.push(classes.nodes.len());
        }
        classes
    }

    fn range(&self, class: usize) -> std::ops::Range<usize> {
        let start = if class == 0 { 0 } else { self.ends[class - 1] };
        start..self.ends[class]
    }

    /// Sum over the classes so far of the largest weight from a node to one of theirs.
    fn reach(&self, graph: &WeightedGraph, node: u32) -> u64 {
        let largest = |class: usize| {
            self.nodes[self.range(class)].iter().map(|o| graph.weight(node, o.node)).max().unwrap_or(0)
        };
        (0..self.ends.len()).map(largest).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_graph_with_three_to_the_twenty_cliques_of_equal_weight_is_settled_by_order() {
        let graph = WeightedGraph::from_measure(60, 0.0, |i, j| if i / 3 == j / 3 { 0.0 } else { 1.0 });
        let (cliques, exact) = graph.heaviest_cliques(2, 3, 100_000);
        assert!(exact);
        let first = |last: usize| (0..19).map(|k| 3 * k).chain([last]).collect::<Vec<_>>();
        assert_eq!(cliques, [first(57), first(58), first(59)]);
    }
}
