//! The network of an ego's policy: other agents pass one small network, the greatest of each feature stays, then three
//! layers give the action.

use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::observe::Layout;
use crate::simd_dispatch::simd_dispatch;
use std::collections::BTreeMap;
use std::ops::Range;

/// Normalised observations are clipped here.
const CLIP: Real = 5.0;
/// The layer that gives the action.
const LAST: &str = "policy.4";

/// Weights by name: shape and numbers.
pub type Tensors = BTreeMap<String, (Vec<usize>, Vec<Real>)>;

/// Weights by input, and bias.
#[derive(Debug)]
struct Linear {
    /// [in, out].
    weight: Vec<Real>,
    bias: Vec<Real>,
}

impl Linear {
    fn num_inputs(&self) -> usize {
        self.weight.len() / self.bias.len().max(1)
    }

    fn apply(&self, x: &[Real], out: &mut Vec<Real>) {
        out.clear();
        out.extend_from_slice(&self.bias);
        add_products(x, &self.weight, out);
    }
}

/// Outputs whose sums are kept in registers.
const BLOCK: usize = 32;

simd_dispatch! {
    /// Adds the products of inputs and weights [in, out], input after input: the sums are the same on every processor.
    fn add_products(x: &[Real], weights: &[Real], out: &mut [Real]) {
        let width = out.len();
        let (blocks, rest) = out.as_chunks_mut::<BLOCK>();
        for (b, block) in blocks.iter_mut().enumerate() {
            let mut sums = *block;
            for (x, row) in x.iter().zip(weights.chunks_exact(width)) {
                let Some(row) = row[b * BLOCK..].first_chunk::<BLOCK>() else { continue };
                for (sum, weight) in sums.iter_mut().zip(row) {
                    *sum += x * weight;
                }
            }
            *block = sums;
        }
        let start = width - rest.len();
        for (x, row) in x.iter().zip(weights.chunks_exact(width)) {
            for (sum, weight) in rest.iter_mut().zip(&row[start..]) {
                *sum += x * weight;
            }
        }
    }
}

fn rectify(x: &mut [Real]) {
    x.iter_mut().for_each(|v| *v = v.max(0.0));
}

/// Network and memory that it works in.
#[derive(Debug)]
pub struct NetworkOfEgo {
    mean: Vec<Real>,
    std: Vec<Real>,
    /// Numbers of an agent in the row, one agent after another, and places of their mask.
    agents: Range<usize>,
    mask: Range<usize>,
    encoder: Vec<Linear>,
    policy: Vec<Linear>,
    x: Vec<Real>,
    hidden: [Vec<Real>; 2],
}

impl NetworkOfEgo {
    /// Network for rows of a layout and actions of some numbers.
    ///
    /// # Errors
    /// [`SimError::Config`] names the weights whose shape does not fit.
    pub fn new(layout: &Layout, width: usize, mut tensors: Tensors) -> Result<Self> {
        // of hidden layers the file says how wide they are
        let outputs: BTreeMap<String, usize> = tensors
            .iter()
            .filter_map(|(name, (shape, _))| {
                Some((name.strip_suffix(".weight")?.to_owned(), *shape.first()?))
            })
            .collect();
        let mut take = |name: &str, shape: &[usize]| match tensors.remove(name) {
            Some((found, numbers)) if found == shape && numbers.iter().all(|x| x.is_finite()) => Ok(numbers),
            found => {
                let got = found.map_or("nothing".into(), |(found, _)| format!("shape {found:?}"));
                let expected = format!("finite numbers of shape {shape:?}");
                Err(SimError::config(format!("policy: {name}"), got, expected))
            }
        };
        let place = |name: &str| {
            let entry = layout.entry(name)?;
            Some((entry.offset..entry.offset + entry.shape.iter().product::<usize>(), entry.columns.len()))
        };
        let none = || (layout.size..layout.size, 0);
        let (agents, columns) = place("agents").unwrap_or_else(none);
        let (mask, _) = place("agents_mask").unwrap_or_else(none);
        let (mean, std) = (take("mean", &[layout.size])?, take("std", &[layout.size])?);
        if let Some(least) = std.iter().find(|s| **s <= 0.0) {
            return Err(SimError::config("policy: std", least, "above 0"));
        }
        let mut layer = |name: &str, inputs: usize| {
            let sizes = outputs.get(name).filter(|n| **n > 0 && name != LAST);
            let outputs = sizes.copied().unwrap_or(width);
            let rows = take(&format!("{name}.weight"), &[outputs, inputs])?;
            let weight = (0..inputs).flat_map(|i| rows.iter().skip(i).step_by(inputs).copied()).collect();
            Ok(Linear { weight, bias: take(&format!("{name}.bias"), &[outputs])? })
        };
        let (mut encoder, mut seen) = (Vec::new(), 0);
        if columns > 0 {
            let first = layer("encoder.0", columns)?;
            let second = layer("encoder.2", first.bias.len())?;
            seen = second.bias.len();
            encoder = vec![first, second];
        }
        let (mut inputs, mut policy) = (layout.size - agents.len() - mask.len() + seen, Vec::new());
        for name in ["policy.0", "policy.2", LAST] {
            policy.push(layer(name, inputs)?);
            inputs = policy.last().map_or(0, |l: &Linear| l.bias.len());
        }
        let (x, hidden) = (Vec::new(), Default::default());
        Ok(Self { mean, std, agents, mask, encoder, policy, x, hidden })
    }

    /// Numbers of a row, and of an action.
    pub fn sizes(&self) -> [usize; 2] {
        [self.mean.len(), self.policy.last().map_or(0, |l| l.bias.len())]
    }

    /// The action for a row, -1 to 1.
    pub fn act(&mut self, row: &[Real]) -> Vec<Real> {
        let scaled = |((x, mean), std): ((&Real, &Real), &Real)| ((x - mean) / std).clamp(-CLIP, CLIP);
        self.x.clear();
        self.x.extend(row.iter().zip(&self.mean).zip(&self.std).map(scaled));
        let [a, b] = &mut self.hidden;
        let mut features: Vec<Real> =
            self.x[..self.agents.start].iter().chain(&self.x[self.mask.end..]).copied().collect();
        if let [first, second] = &self.encoder[..] {
            let mut greatest = vec![0.0 as Real; second.bias.len()];
            let agents = self.x[self.agents.clone()].chunks_exact(first.num_inputs());
            for (agent, _) in agents.zip(&row[self.mask.clone()]).filter(|(_, there)| **there > 0.0) {
                first.apply(agent, a);
                rectify(a);
                second.apply(a, b);
                greatest.iter_mut().zip(b.iter()).for_each(|(g, x)| *g = g.max(*x));
            }
            features.extend(greatest);
        }
        for (i, layer) in self.policy.iter().enumerate() {
            if i > 0 {
                rectify(&mut features);
            }
            layer.apply(&features, a);
            std::mem::swap(&mut features, a);
        }
        features.iter().map(|x| x.clamp(-1.0, 1.0)).collect()
    }
}
