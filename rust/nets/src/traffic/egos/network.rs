//! The network of an ego's policy: other agents pass one small network, the greatest of each feature stays, then three
//! layers give the action.

use crate::compute::weights::{Entry, Weights, broken};
use crate::error::Result;
use crate::kernels::{Packed, linear};
use ccdiff_sim::geom::Real;
use ccdiff_sim::observe::Layout;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

/// Normalised observations are clipped here.
const CLIP: Real = 5.0;

/// Network and memory that it works in.
#[derive(Debug)]
pub struct NetworkOfEgo {
    mean: Vec<Real>,
    std: Vec<Real>,
    /// Numbers of an agent in the row, one agent after another, and places of their mask.
    agents: Range<usize>,
    mask: Range<usize>,
    encoder: Option<[Packed; 2]>,
    policy: [Packed; 3],
    /// Of each number in a mirror, where left is right: its place, and its sign. Where there is one, the policy is even.
    mirror: Vec<(usize, Real)>,
    x: Vec<Real>,
    hidden: [Vec<Real>; 2],
}

impl NetworkOfEgo {
    /// Network for rows of a layout and actions of some numbers, of weights by name.
    ///
    /// # Errors
    /// [`crate::ModelError::Checkpoint`] names the weights whose shape or numbers do not fit.
    pub fn new(layout: &Layout, num_actions: usize, tensors: BTreeMap<String, Entry>) -> Result<Self> {
        let path = Path::new("policy");
        let wrong = |(_, (_, numbers)): &(&String, &Entry)| numbers.iter().any(|x| !x.is_finite());
        if let Some((name, _)) = tensors.iter().find(wrong) {
            return Err(broken(path, name, "of other numbers", "finite ones"));
        }
        // of hidden layers the file says how wide they are
        let width = |name: &str| {
            let found = tensors.get(&format!("{name}.weight")).and_then(|(shape, _)| shape.first().copied());
            found.unwrap_or(1).max(1)
        };
        let [first, near, wide, last] = ["encoder.0", "encoder.2", "policy.0", "policy.2"].map(width);
        let place = |name: &str| {
            let entry = layout.entry(name)?;
            Some((entry.offset..entry.offset + entry.shape.iter().product::<usize>(), entry.columns.len()))
        };
        let none = || (layout.size..layout.size, 0);
        let (agents, columns) = place("agents").unwrap_or_else(none);
        let (mask, _) = place("agents_mask").unwrap_or_else(none);
        let is_even = tensors.contains_key("mirror");
        let weights = Weights::new(path, tensors);
        let row = |name: &str| weights.take(name, &[layout.size]).unwrap_or_default().to_vec();
        let layer = |name, inputs, outputs| weights.layer(name, inputs, outputs);
        let (mean, std) = (row("mean"), row("std"));
        let places = if is_even { row("mirror") } else { Vec::new() };
        let encoder =
            (columns > 0).then(|| [layer("encoder.0", columns, first), layer("encoder.2", first, near)]);
        let inputs = layout.size - agents.len() - mask.len() + encoder.as_ref().map_or(0, |_| near);
        let policy = [
            layer("policy.0", inputs, wide),
            layer("policy.2", wide, last),
            layer("policy.4", last, num_actions),
        ];
        weights.finish()?;
        if let Some(least) = std.iter().find(|s| **s <= 0.0) {
            return Err(broken(path, "std", least.to_string(), "above 0"));
        }
        if is_even && num_actions != 2 {
            return Err(broken(
                path,
                "mirror",
                format!("of {num_actions} actions"),
                "two, the second to the left",
            ));
        }
        let far = |p: &&Real| p.fract() != 0.0 || !(1.0..=layout.size as Real).contains(&p.abs());
        if let Some(place) = places.iter().find(far) {
            return Err(broken(
                path,
                "mirror",
                place.to_string(),
                format!("a place, 1 to {}, with a sign", layout.size),
            ));
        }
        let mirror = places.iter().map(|p| (p.abs() as usize - 1, p.signum())).collect();
        let (x, hidden) = (Vec::new(), Default::default());
        Ok(Self { mean, std, agents, mask, encoder, policy, mirror, x, hidden })
    }

    /// Numbers of a row, and of an action.
    pub fn sizes(&self) -> [usize; 2] {
        [self.mean.len(), self.policy[2].columns]
    }

    /// The action for a row, -1 to 1.
    pub fn act(&mut self, row: &[Real]) -> Vec<Real> {
        let scaled = |((x, mean), std): ((&Real, &Real), &Real)| ((x - mean) / std).clamp(-CLIP, CLIP);
        self.x.clear();
        self.x.extend(row.iter().zip(&self.mean).zip(&self.std).map(scaled));
        let mut action = self.decide(row);
        if !self.mirror.is_empty() {
            self.x = self.mirror.iter().map(|(place, sign)| sign * self.x[*place]).collect();
            let turned = self.decide(row);
            let sides = turned.iter().zip([1.0, -1.0]);
            action.iter_mut().zip(sides).for_each(|(x, (other, side))| *x = 0.5 * (*x + side * other));
        }
        action.iter().map(|x| x.clamp(-1.0, 1.0)).collect()
    }

    /// The action for normalised numbers; agents are there where they are in the row.
    fn decide(&mut self, row: &[Real]) -> Vec<Real> {
        let [a, b] = &mut self.hidden;
        let mut features: Vec<Real> =
            self.x[..self.agents.start].iter().chain(&self.x[self.mask.end..]).copied().collect();
        if let Some([first, second]) = &self.encoder {
            let agents = self.x[self.agents.clone()].chunks_exact(first.inputs);
            let there = agents.zip(&row[self.mask.clone()]).filter(|(_, there)| **there > 0.0);
            let rows: Vec<Real> = there.flat_map(|(agent, _)| agent).copied().collect();
            linear(&rows, first, true, a);
            linear(a, second, true, b);
            let mut greatest = vec![0.0 as Real; second.columns];
            for agent in b.chunks_exact(second.columns) {
                greatest.iter_mut().zip(agent).for_each(|(g, x)| *g = g.max(*x));
            }
            features.extend(greatest);
        }
        let [first, second, last] = &self.policy;
        linear(&features, first, true, a);
        linear(a, second, true, b);
        linear(b, last, false, a);
        a.clone()
    }
}
