//! What guidance did: losses, the selected sample, how far plans moved, how gradients pull against each other.

use super::config::GuidanceConfig;
use super::objective::Objective;

/// What guidance did to the plans of the M agents of one world.
#[derive(Debug, Clone, PartialEq)]
pub struct GuidanceReport {
    /// Unweighted losses of the finished plans, [J, N, M], objectives in the order of the configuration. What is avoided against a
    /// weight ([`super::GuidanceContext::sign`]) counts negative.
    pub losses: Vec<f32>,
    /// Sample selected for each agent, [M]; one for all where an objective is joint.
    pub selected_sample: Vec<usize>,
    /// How far guidance moved each agent's selected plan by 2 s, metres, [M]; NaN for guided agents whose plans it moved
    /// before they were finished, or chose, since those have no plan without it.
    pub moved_m: Vec<f32>,
    /// Gradient statistics, if asked for.
    pub conflict: Option<GradientStatistics>,
}

/// How the gradients of realism and guidance, and of the objectives among each other, agree, for the M agents of one
/// world, guided or not: means over samples and guided denoising steps.
///
/// Realism is the score of the denoising process, (√ᾱ x₀ - x_k) / (1 - ᾱ); guidance is minus the gradient of the weighted
/// losses with respect to the knots.
#[derive(Debug, Clone, PartialEq)]
pub struct GradientStatistics {
    /// Inner product ⟨∇log π, ∇R⟩, [M]: the score of the gradient-alignment ranking.
    pub alignment: Vec<f32>,
    /// Its cosine over the steps with a gradient, [M]; 0 without any.
    pub cosine: Vec<f32>,
    /// Share of those steps with a negative cosine, [M].
    pub conflict_share: Vec<f32>,
    /// Mean cosine of the weighted gradients of two objectives over agents that have both, [J, J]; 0 without any.
    pub objective_cosine: Vec<f32>,
}

/// Running sums of [`GradientStatistics`] for the rows of one sample of one world.
#[derive(Debug, Clone)]
pub(super) struct GradientSums {
    /// Inner products, cosines, how many of them are negative, and their number, [M].
    agents: Vec<[f64; 4]>,
    /// Cosines of two objectives and their number, [J, J].
    pairs: Vec<[f64; 2]>,
    steps: f64,
}

impl GradientSums {
    pub(super) fn new(num_agents: usize, num_objectives: usize) -> Self {
        let pairs = vec![[0.0; 2]; num_objectives * num_objectives];
        Self { agents: vec![[0.0; 4]; num_agents], pairs, steps: 0.0 }
    }

    /// Adds one denoising step: weighted gradients [J][M, width] and the score [M, width].
    pub(super) fn add(&mut self, gradients: &[Vec<f32>], score: &[f32], width: usize) {
        self.steps += 1.0;
        for (agent, sums) in self.agents.iter_mut().enumerate() {
            let part = agent * width..(agent + 1) * width;
            let mut total = vec![0.0f32; width];
            for gradient in gradients {
                total.iter_mut().zip(&gradient[part.clone()]).for_each(|(t, g)| *t -= g);
            }
            let (inner, cosine) = compare(&total, &score[part.clone()]);
            sums[0] += inner;
            if let Some(cosine) = cosine {
                sums[1] += cosine;
                sums[2] += f64::from(u8::from(cosine < 0.0));
                sums[3] += 1.0;
            }
            let both = gradients.iter().flat_map(|one| gradients.iter().map(move |other| (one, other)));
            for ((one, other), sums) in both.zip(&mut self.pairs) {
                if let (_, Some(cosine)) = compare(&one[part.clone()], &other[part.clone()]) {
                    sums[0] += cosine;
                    sums[1] += 1.0;
                }
            }
        }
    }

    /// The statistics of all samples of a world.
    pub(super) fn statistics(samples: &[Self]) -> Option<GradientStatistics> {
        let (first, rest) = samples.split_first()?;
        let mut all = first.clone();
        for other in rest {
            all.steps += other.steps;
            let agents = all.agents.as_flattened_mut().iter_mut().zip(other.agents.as_flattened());
            let pairs = all.pairs.as_flattened_mut().iter_mut().zip(other.pairs.as_flattened());
            agents.chain(pairs).for_each(|(sum, of)| *sum += of);
        }
        let mean = |sum: f64, count: f64| if count == 0.0 { 0.0 } else { (sum / count) as f32 };
        let of_agents = |of: &dyn Fn(&[f64; 4]) -> f32| all.agents.iter().map(of).collect();
        Some(GradientStatistics {
            alignment: of_agents(&|sums| mean(sums[0], all.steps)),
            cosine: of_agents(&|sums| mean(sums[1], sums[3])),
            conflict_share: of_agents(&|sums| mean(sums[2], sums[3])),
            objective_cosine: all.pairs.iter().map(|sums| mean(sums[0], sums[1])).collect(),
        })
    }
}

/// Inner product, and cosine where neither vector is zero.
fn compare(a: &[f32], b: &[f32]) -> (f64, Option<f64>) {
    let dot = |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(x, y)| f64::from(x * y)).sum() };
    let (inner, norms) = (dot(a, b), (dot(a, a) * dot(b, b)).sqrt());
    (inner, (norms > 0.0).then(|| (inner / norms).clamp(-1.0, 1.0)))
}

/// The sample to take for each of M agents by losses [J, N, M] (reference.md#sampling): the least sum of weighted losses, per agent,
/// or summed over all agents where an objective is joint. Ties go to the first.
///
/// Differs from the released code: weights keep their signs unless the configuration says otherwise.
pub fn choose_samples(
    config: &GuidanceConfig,
    losses: &[f32],
    num_samples: usize,
    num_agents: usize,
) -> Vec<usize> {
    if !config.objectives.iter().any(Objective::is_joint) {
        return choose_per_agent(config, losses, num_samples, &vec![num_samples; num_agents]);
    }
    let score = weighted(config, losses, [num_samples, num_agents]);
    vec![least(num_samples, |sample| (0..num_agents).map(|agent| score(sample, agent)).sum()); num_agents]
}

/// The sample of least weighted losses [J, N, M] of each agent, among its first `choices` [M].
pub(super) fn choose_per_agent(
    config: &GuidanceConfig,
    losses: &[f32],
    num_samples: usize,
    choices: &[usize],
) -> Vec<usize> {
    let score = weighted(config, losses, [num_samples, choices.len()]);
    choices.iter().enumerate().map(|(agent, count)| least(*count, |s| score(s, agent))).collect()
}

/// Weighted sum of the losses [J, N, M] of a sample of an agent.
fn weighted(config: &GuidanceConfig, losses: &[f32], [n, m]: [usize; 2]) -> impl Fn(usize, usize) -> f64 {
    move |sample, agent| {
        let of = |(j, o): (usize, &Objective)| {
            f64::from(o.weight()) * f64::from(losses[(j * n + sample) * m + agent])
        };
        config.objectives.iter().enumerate().map(of).sum()
    }
}

/// The first of the samples with the least score.
fn least(num_samples: usize, score: impl Fn(usize) -> f64) -> usize {
    (0..num_samples).min_by(|a, b| score(*a).total_cmp(&score(*b))).unwrap_or(0)
}
