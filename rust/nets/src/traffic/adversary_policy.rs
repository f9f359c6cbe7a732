//! A learned choice of the adversary: who is guided from a plan to the next, and how strongly, or nobody.

use crate::compute::weights::{Weights, broken, field, read};
use crate::error::Result;
use ccdiff_sim::geom::Real;
use ccdiff_sim::world::{CANDIDATE_FEATURES, Candidates};
use std::path::Path;

/// What files of such policies say that they are.
const KIND: &str = "adversary_policy";
/// From this feature on, rows say the same: what the ego does.
const EGO: &str = "ego_speed";
/// A file holds few candidates and strengths.
const MOST_OUTPUTS: usize = 1024;
/// Hidden units of every layer, as in `ccdiff_env.envs.selection.sb3_policy`.
const WIDTH: usize = 64;

/// Weights [in, out] and bias.
#[derive(Debug, Clone)]
struct Linear {
    weight: Vec<Real>,
    bias: Vec<Real>,
}

impl Linear {
    /// The layer of a file, which holds its weights [out, in].
    fn new(weights: &Weights, name: &str, inputs: usize, outputs: usize) -> Self {
        let take = |part: &str, shape: &[usize]| {
            weights.take(&format!("{name}.{part}"), shape).map(<[Real]>::to_vec).unwrap_or_default()
        };
        let rows = take("weight", &[outputs, inputs]);
        let weight = (0..inputs).flat_map(|i| rows.iter().skip(i).step_by(inputs).copied()).collect();
        Self { weight, bias: take("bias", &[outputs]) }
    }

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
    /// Scores at each strength, of nobody, and a value that training needs.
    head: [Linear; 2],
}

impl AdversaryPolicy {
    /// Reads a file that `ccdiff_env.envs.selection.sb3_policy.save_policy` wrote.
    ///
    /// # Errors
    /// [`crate::ModelError::Io`], [`crate::ModelError::Checkpoint`] name the file and what does not fit.
    pub(crate) fn load(path: &Path) -> Result<Self> {
        let (header, tensors) = read(path)?;
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
        if !(strengths.iter().all(sound)
            && (1..=MOST_OUTPUTS).contains(&max_candidates.saturating_mul(strengths.len())))
        {
            let got = format!("{max_candidates} candidates, strengths {strengths:?}");
            return Err(broken(path, "strengths", got, "candidates, and strengths above 0"));
        }
        let weights = Weights::new(path, tensors);
        let layer = |name, inputs, outputs| Linear::new(&weights, name, inputs, outputs);
        let row = [layer("row.0", names.len(), WIDTH), layer("row.2", WIDTH, WIDTH)];
        let head = [layer("head.0", 2 * WIDTH, WIDTH), layer("head.2", WIDTH, strengths.len() + 2)];
        weights.finish()?;
        Ok(Self { max_candidates, strengths, row, head })
    }

    /// Candidates that it looks at, at most.
    pub(crate) fn max_candidates(&self) -> usize {
        self.max_candidates
    }

    /// The vehicle that it chooses and its criticality; `None`: nobody.
    pub(crate) fn choose(&self, seen: &Candidates) -> Option<(usize, Real)> {
        let found = |row: &[Real]| self.row[1].rectified(&self.row[0].rectified(row));
        let rows = || seen.features.chunks_exact(CANDIDATE_FEATURES.len());
        let candidates: Vec<Vec<Real>> = rows().take(seen.agents.len()).map(found).collect();
        let greatest = |i: usize| candidates.iter().map(|f| f[i]).fold(0.0, Real::max);
        let greatest: Vec<Real> = (0..WIDTH).map(greatest).collect();
        let scores = |row: &[Real]| self.head[1].apply(&self.head[0].rectified(row.iter().chain(&greatest)));
        let mut nobody = rows().next()?.to_vec();
        nobody
            .iter_mut()
            .zip(&CANDIDATE_FEATURES)
            .take_while(|(_, f)| f.name != EGO)
            .for_each(|(v, _)| *v = 0.0);
        let mut best = (None, scores(&found(&nobody))[self.strengths.len()]);
        for (agent, row) in seen.agents.iter().zip(&candidates) {
            for (score, strength) in scores(row).iter().zip(&self.strengths) {
                if *score > best.1 {
                    best = (Some((*agent, *strength)), *score);
                }
            }
        }
        best.0
    }
}
