//! A learned choice of the adversary: who is guided from a plan to the next, and how strongly, or nobody.

use crate::compute::weights::{Entry, broken, field, read};
use crate::error::Result;
use ccdiff_sim::geom::Real;
use ccdiff_sim::world::{CANDIDATE_FEATURES, Candidates};
use std::collections::BTreeMap;
use std::path::Path;

/// What files of such policies say that they are.
const KIND: &str = "adversary_policy";
/// From this feature on, rows say the same: what the ego does.
const EGO: &str = "ego_speed";
/// A file holds few candidates and strengths.
const MOST_OUTPUTS: usize = 1024;

/// Weights by input, and bias.
#[derive(Debug, Clone)]
struct Linear {
    /// [in, out].
    weight: Vec<Real>,
    bias: Vec<Real>,
}

impl Linear {
    /// Adds input after input, so that the sums are the same on every processor.
    fn apply<'a>(&self, x: impl IntoIterator<Item = &'a Real>) -> Vec<Real> {
        let mut out = self.bias.clone();
        for (x, weights) in x.into_iter().zip(self.weight.chunks_exact(self.bias.len())) {
            out.iter_mut().zip(weights).for_each(|(o, w)| *o += x * w);
        }
        out
    }

    fn rectified<'a>(&self, x: impl IntoIterator<Item = &'a Real>) -> Vec<Real> {
        self.apply(x).into_iter().map(|v| v.max(0.0)).collect()
    }
}

/// A network that scores each candidate at each strength, and nobody.
#[derive(Debug, Clone)]
pub(crate) struct AdversaryPolicy {
    max_candidates: usize,
    /// Criticality of each of its strengths.
    strengths: Vec<Real>,
    row: [Linear; 2],
    among: Linear,
    nobody: Linear,
    somebody_scores: Linear,
    nobody_score: Linear,
}

impl AdversaryPolicy {
    /// Reads a file that `ccdiff_env.envs.selection.save_policy` wrote.
    ///
    /// # Errors
    /// [`crate::ModelError::Io`], [`crate::ModelError::Checkpoint`] name the file and what does not fit.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let (header, mut tensors) = read(path)?;
        let kind: String = field(path, &header, "kind")?;
        if kind != KIND {
            return Err(broken(path, "kind", kind, KIND));
        }
        let names: Vec<String> = field(path, &header, "features")?;
        if !names.iter().map(String::as_str).eq(CANDIDATE_FEATURES.iter().map(|f| f.name)) {
            return Err(broken(path, "features", names.join(", "), "the features of this version"));
        }
        let max_candidates: usize = field(path, &header, "max_candidates")?;
        let strengths: Vec<Real> = field(path, &header, "strengths")?;
        let sound = |s: &Real| s.is_finite() && *s > 0.0;
        if strengths.is_empty()
            || !strengths.iter().all(sound)
            || !(1..=MOST_OUTPUTS).contains(&(max_candidates.saturating_mul(strengths.len())))
        {
            let got = format!("{max_candidates} candidates, strengths {strengths:?}");
            return Err(broken(path, "strengths", got, "candidates, and strengths above 0"));
        }
        let (num_features, egos) = (names.len(), names.iter().skip_while(|n| *n != EGO).count());
        let mut layer = |name: &str, inputs: usize, outputs: Option<usize>| {
            linear(path, &mut tensors, name, inputs, outputs)
        };
        let first = layer("row.0", num_features, None)?;
        let width = first.bias.len();
        Ok(Self {
            row: [first, layer("row.2", width, Some(width))?],
            among: layer("among.0", 2 * width, Some(width))?,
            nobody: layer("nobody.0", width + egos, Some(width))?,
            somebody_scores: layer("somebody", width, Some(strengths.len()))?,
            nobody_score: layer("nobody_score", width, Some(1))?,
            max_candidates,
            strengths,
        })
    }

    /// Candidates that it looks at, at most.
    pub(crate) fn max_candidates(&self) -> usize {
        self.max_candidates
    }

    /// The vehicle that it chooses and its criticality; `None`: nobody.
    pub(crate) fn choose(&self, seen: &Candidates) -> Option<(usize, Real)> {
        let rows: Vec<&[Real]> = seen.features.chunks_exact(CANDIDATE_FEATURES.len()).collect();
        let found: Vec<Vec<Real>> = rows
            .iter()
            .take(seen.agents.len())
            .map(|row| self.row[1].rectified(&self.row[0].rectified(*row)))
            .collect();
        let greatest = |i: usize| found.iter().map(|f| f[i]).fold(0.0, Real::max);
        let greatest: Vec<Real> = (0..self.row[1].bias.len()).map(greatest).collect();
        let ego = CANDIDATE_FEATURES.iter().position(|f| f.name == EGO).unwrap_or_default();
        let nobody = self.nobody.rectified(greatest.iter().chain(&rows.first()?[ego..]));
        let mut best = (None, self.nobody_score.apply(&nobody)[0]);
        for (agent, row) in seen.agents.iter().zip(&found) {
            let scores = self.somebody_scores.apply(&self.among.rectified(row.iter().chain(&greatest)));
            for (score, strength) in scores.iter().zip(&self.strengths) {
                if *score > best.1 {
                    best = (Some((*agent, *strength)), *score);
                }
            }
        }
        best.0
    }
}

/// A layer of a file, whose weights stand there by output.
fn linear(
    path: &Path,
    tensors: &mut BTreeMap<String, Entry>,
    name: &str,
    inputs: usize,
    outputs: Option<usize>,
) -> Result<Linear> {
    let mut take = |part: &str| {
        let entry = format!("{name}.{part}");
        tensors.remove(&entry).ok_or_else(|| broken(path, &entry, "missing", "a tensor"))
    };
    let ((weight_shape, rows), (bias_shape, bias)) = (take("weight")?, take("bias")?);
    let outputs = outputs.unwrap_or(bias.len());
    if weight_shape != [outputs, inputs] || bias_shape != [outputs] || outputs == 0 {
        let got = format!("shapes {weight_shape:?} and {bias_shape:?}");
        return Err(broken(path, name, got, format!("[{outputs}, {inputs}] and [{outputs}]")));
    }
    let weight = (0..inputs).flat_map(|i| rows.iter().skip(i).step_by(inputs).copied()).collect();
    Ok(Linear { weight, bias })
}
