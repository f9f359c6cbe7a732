//! A learned choice of the adversary: the vehicle that is guided until the next plan and how strongly, or none.

use crate::compute::weights::{Weights, broken, field, read};
use crate::error::Result;
use crate::kernels::{Packed, linear};
use crate::traffic::CcdiffConfig;
use ccdiff_sim::drivers::PlanRequest;
use ccdiff_sim::geom::Real;
use ccdiff_sim::world::{CANDIDATE_FEATURES, Candidates, OWN_FEATURES};
use std::path::Path;

/// What files of such policies say that they are.
const KIND: &str = "adversary_policy";
/// A file holds few candidates and strengths.
const MOST_OUTPUTS: usize = 1024;
/// Hidden units of every layer, as in `ccdiff_env.training.selection_policy`.
const WIDTH: usize = 64;

/// A network that scores each candidate at each strength, and the choice of none.
#[derive(Debug, Clone)]
pub(crate) struct AdversaryPolicy {
    max_candidates: usize,
    /// Criticality of each of its strengths.
    strengths: Vec<Real>,
    row: [Packed; 2],
    /// Scores at each strength, of none, and a value that training needs.
    head: [Packed; 2],
}

impl AdversaryPolicy {
    /// Reads a file that `ccdiff_env.training.selection_policy.save_policy` wrote.
    fn load(path: &Path) -> Result<Self> {
        let (header, tensors) = read(path)?;
        let kind: String = field(path, &header, "kind")?;
        if kind != KIND {
            return Err(broken(path, "kind", kind, KIND));
        }
        let names: Vec<String> = field(path, &header, "features")?;
        if !names.iter().map(String::as_str).eq(CANDIDATE_FEATURES.iter().map(|f| f.0)) {
            return Err(broken(path, "features", names.join(", "), "the features of this version"));
        }
        let max_candidates: usize = field(path, &header, "max_candidates")?;
        let strengths: Vec<Real> = field(path, &header, "strengths")?;
        let few = (1..=MOST_OUTPUTS).contains(&max_candidates.saturating_mul(strengths.len()));
        if !few || !strengths.iter().all(|s| s.is_finite() && *s > 0.0) {
            let got = format!("{max_candidates} candidates, strengths {strengths:?}");
            return Err(broken(path, "strengths", got, "candidates, and strengths above 0"));
        }
        let weights = Weights::new(path, tensors);
        let layer = |name, inputs, outputs| weights.layer(name, inputs, outputs);
        let row = [layer("row.0", names.len(), WIDTH), layer("row.2", WIDTH, WIDTH)];
        let head = [layer("head.0", 2 * WIDTH, WIDTH), layer("head.2", WIDTH, strengths.len() + 2)];
        weights.finish()?;
        Ok(Self { max_candidates, strengths, row, head })
    }

    /// That of the options.
    pub(crate) fn of(config: &CcdiffConfig) -> Result<Option<Self>> {
        config.adversary_policy.as_ref().map(|file| Self::load(Path::new(file))).transpose()
    }

    /// The vehicle of a ranking that it has guided from the coming plan on, and its criticality.
    pub(crate) fn guided(&self, request: &PlanRequest<'_>, ranking: &[usize]) -> (Vec<usize>, Real) {
        let plan = request.plan.map(|plan| &plan.record);
        let seen = Candidates::new(&request.world, plan, |a| request.drives(a), self.max_candidates);
        let (agent, strength) = self.choose(&seen).unzip();
        (agent.into_iter().filter(|a| ranking.contains(a)).collect(), strength.unwrap_or_default())
    }

    /// The vehicle that it chooses and its criticality; `None`: none is guided.
    fn choose(&self, seen: &Candidates) -> Option<(usize, Real)> {
        let [mut x, mut hidden] = [Vec::new(), Vec::new()];
        // the choice of none is a row of what the ego does, behind the candidates
        let (of, count) = (CANDIDATE_FEATURES.len(), seen.agents.len());
        let mut rows = seen.features[..count * of].to_vec();
        rows.extend([0.0; OWN_FEATURES].iter().chain(&seen.features[OWN_FEATURES..of]));
        linear(&rows, &self.row[0], true, &mut hidden);
        linear(&hidden, &self.row[1], true, &mut x);
        let candidates = || x.chunks_exact(WIDTH).take(count);
        let greatest: Vec<Real> =
            (0..WIDTH).map(|i| candidates().map(|f| f[i]).fold(0.0, Real::max)).collect();
        let both: Vec<Real> =
            x.chunks_exact(WIDTH).flat_map(|f| f.iter().chain(&greatest)).copied().collect();
        linear(&both, &self.head[0], true, &mut hidden);
        linear(&hidden, &self.head[1], false, &mut x);
        let scores: Vec<&[Real]> = x.chunks_exact(self.strengths.len() + 2).collect();
        let mut best = (None, scores[count][self.strengths.len()]);
        for (agent, row) in seen.agents.iter().zip(&scores) {
            for (score, strength) in row.iter().zip(&self.strengths) {
                if *score > best.1 {
                    best = (Some((*agent, *strength)), *score);
                }
            }
        }
        best.0
    }
}
