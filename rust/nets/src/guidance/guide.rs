//! Moving the plans of a batch down the guidance loss, in every denoising step.

use super::config::{Clip, GuidanceConfig};
use super::context::GuidanceContext;
use super::descent::Descent;
use super::knots::KnotMap;
use super::objective::{Evaluation, Objective};
use super::report::{GradientSums, GuidanceReport, choose_per_agent, choose_samples, total_variation};
use super::rollout::{Rollout, StateGradient};
use crate::config::ModelConfig;
use rayon::prelude::*;

/// Jobs (one sample of one world) from which on the pool is used.
const PARALLEL_JOBS: usize = 4;

/// Guidance of a batch of worlds: N samples of R rows, all agents of all worlds. Made for every plan.
#[derive(Debug)]
pub struct Guidance<'a> {
    config: &'a GuidanceConfig,
    knots: KnotMap,
    /// 1 for knots that may be moved, per number of an agent's plan.
    mask: Vec<f32>,
    /// One per world; `None` is not guided.
    worlds: Vec<Option<GuidanceContext<'a>>>,
    sizes: Vec<usize>,
    num_samples: usize,
    /// Σ ‖δ‖²/σ² so far, [N · R].
    shift_sq: Vec<f64>,
    /// Gradient statistics so far, sample by sample, if asked for.
    sums: Option<Vec<GradientSums>>,
    /// Predicted knots of all rows [R, knots, 2], against which each agent's sample is selected for itself.
    predicted: Option<Vec<f32>>,
    /// Draws among which a row chooses at a guidance scale of 1; `None`: all.
    draws: Option<usize>,
}

/// Guidance, where there is any.
pub type Guide<'g, 'a> = Option<&'g mut Guidance<'a>>;

/// A denoising step as guidance sees it.
#[derive(Debug, Clone, Copy)]
pub struct GuidanceStep<'s> {
    /// Standard deviation σ of the step, normalised units; of the random step that a deterministic one stands for.
    pub sigma: f64,
    /// How much of a move reaches the step's mean: 1 if the mean itself is moved, the coefficient of x₀ if that is.
    pub gain: f64,
    /// Score of the denoising process [N · R, knots, 2], for the gradient statistics.
    pub score: Option<&'s [f32]>,
}

/// One sample of one world.
struct Job<'j, 'a> {
    context: &'j GuidanceContext<'a>,
    knots: &'j mut [f32],
    shift_sq: &'j mut [f64],
    /// Sums of the gradient statistics and the score, if asked for.
    watch: Option<(&'j mut GradientSums, &'j [f32])>,
}

/// A world, and memory for its plans.
struct Scratch<'s, 'a> {
    config: &'s GuidanceConfig,
    map: &'s KnotMap,
    context: &'s GuidanceContext<'a>,
    actions: Vec<f32>,
    of_actions: Vec<f32>,
    of_knots: Vec<f32>,
    losses: Vec<f32>,
    plan: Rollout,
    of_states: StateGradient,
}

impl<'s, 'a> Scratch<'s, 'a> {
    fn new(config: &'s GuidanceConfig, map: &'s KnotMap, context: &'s GuidanceContext<'a>) -> Self {
        let (m, t) = (context.num_agents(), context.num_steps);
        Self {
            config,
            map,
            context,
            actions: vec![0.0; 2 * t],
            of_actions: vec![0.0; 2 * t],
            of_knots: vec![0.0; map.width()],
            losses: vec![0.0; m],
            plan: Rollout::zeros(m, t),
            of_states: StateGradient::zeros(m, t),
        }
    }

    /// Rolls an agent's part of the world's knots out.
    fn roll(&mut self, agent: usize, knots: &[f32]) {
        let width = self.map.width();
        self.map.actions(&knots[agent * width..(agent + 1) * width], &mut self.actions);
        self.plan.roll(self.context, agent, &self.actions);
    }

    fn roll_all(&mut self, knots: &[f32]) {
        (0..self.context.num_agents()).for_each(|agent| self.roll(agent, knots));
    }

    /// Adds an objective's losses, and its gradient times a scale.
    fn evaluate(&mut self, of: &Objective, wanted: &[bool], scale: f32) {
        let (losses, gradient) = (&mut self.losses, &mut self.of_states);
        of.evaluate(self.context, &self.plan, &mut Evaluation { losses, gradient, wanted, scale });
    }

    fn vjp(&mut self, agent: usize) {
        self.plan.vjp(self.context, agent, &self.of_states, &mut self.of_actions);
        self.map.vjp(&self.of_actions, &mut self.of_knots);
    }

    /// Moves the guided rows of one sample.
    fn adjust(&mut self, mask: &[f32], knots: &mut [f32], shift_sq: &mut [f64], step: GuidanceStep<'_>) {
        let (config, context, width) = (self.config, self.context, self.map.width());
        let m = context.num_agents();
        let rows: Vec<usize> = (0..m).filter(|a| context.guided[*a]).collect();
        if rows.is_empty() || config.gradient_steps == 0 {
            return;
        }
        let limit = match config.clip {
            Clip::Sigma => f64::from(config.clip_limit) * step.sigma / step.gain,
            Clip::Norm => f64::from(config.clip_limit),
        };
        let before = knots.to_vec();
        let part = |a: usize| a * width..(a + 1) * width;
        let mut descents: Vec<Descent<'_>> =
            rows.iter().map(|a| Descent::new(config, &before[part(*a)], limit as f32)).collect();
        self.roll_all(knots);
        for turn in 0..config.gradient_steps {
            if turn > 0 {
                rows.iter().for_each(|a| self.roll(*a, knots));
            }
            self.of_states.clear();
            for objective in &config.objectives {
                self.evaluate(objective, &context.guided, objective.weight() / m as f32);
            }
            for (a, descent) in rows.iter().zip(&mut descents) {
                self.vjp(*a);
                self.of_knots.iter_mut().zip(mask).for_each(|(g, keep)| *g *= keep);
                descent.step(&self.of_knots, &mut knots[part(*a)]);
            }
        }
        for a in rows {
            if context.guidance_scale != 1.0 {
                let moved = knots[part(a)].iter_mut().zip(&before[part(a)]);
                moved.for_each(|(x, start)| *x = start + context.guidance_scale * (*x - start));
            }
            let moved = knots[part(a)].iter().zip(&before[part(a)]);
            let squared: f64 = moved.map(|(x, s)| f64::from(x - s).powi(2)).sum();
            shift_sq[a] += squared * (step.gain / step.sigma).powi(2);
        }
    }

    /// Weighted gradients of the objectives, [J][M, knots, 2].
    fn gradients(&mut self, knots: &[f32]) -> Vec<Vec<f32>> {
        let (m, config) = (self.context.num_agents(), self.config);
        let wanted = vec![true; m];
        self.roll_all(knots);
        let mut of = |objective: &Objective| {
            self.of_states.clear();
            self.evaluate(objective, &wanted, objective.weight() / m as f32);
            let of_agent = |agent| {
                self.vjp(agent);
                self.of_knots.clone()
            };
            (0..m).flat_map(of_agent).collect()
        };
        config.objectives.iter().map(&mut of).collect()
    }
}

impl<'a> Guidance<'a> {
    /// Guidance of `sizes.len()` worlds with that many agents each. `statistics` turns the gradient statistics on.
    pub fn new(
        config: &'a GuidanceConfig,
        model: &ModelConfig,
        worlds: Vec<Option<GuidanceContext<'a>>>,
        sizes: &[usize],
        num_samples: usize,
        statistics: bool,
    ) -> Self {
        let knots = KnotMap::new(model);
        let mask = knots.mask(config.executed_steps).into_iter().flat_map(|m| [m, m]).collect();
        let rows: usize = sizes.iter().sum();
        let sums = statistics.then(|| {
            let empty = |size: &usize| GradientSums::new(*size, config.objectives.len());
            (0..num_samples).flat_map(|_| sizes.iter().map(empty)).collect()
        });
        Self {
            config,
            knots,
            mask,
            worlds,
            sizes: sizes.to_vec(),
            num_samples,
            shift_sq: vec![0.0; num_samples * rows],
            sums,
            predicted: None,
            draws: None,
        }
    }

    /// The configuration.
    pub fn config(&self) -> &'a GuidanceConfig {
        self.config
    }

    /// Whether a denoising step has anything to do for it.
    pub fn is_active(&self) -> bool {
        let guides = |s: &GuidanceContext<'_>| s.guided.iter().any(|g| *g);
        !self.config.objectives.is_empty()
            && (self.wants_score()
                || (self.config.gradient_steps > 0 && self.worlds.iter().flatten().any(guides)))
    }

    /// Whether the gradient statistics were asked for.
    pub fn wants_score(&self) -> bool {
        self.sums.is_some()
    }

    /// Moves normalised knots [N · R, knots, 2] (sample by sample), each world and sample for itself. Rows that are not
    /// guided and knots that are not executed keep their bits.
    pub fn adjust(&mut self, knots: &mut [f32], step: GuidanceStep<'_>) {
        let width = self.knots.width();
        if !(step.sigma > 0.0 && step.gain > 0.0) {
            return;
        }
        let mut jobs = Vec::with_capacity(self.num_samples * self.sizes.len());
        let (mut knots, mut shifts, mut at) = (knots, self.shift_sq.as_mut_slice(), 0);
        let mut sums = self.sums.as_mut().map(|s| s.iter_mut());
        for _ in 0..self.num_samples {
            for (context, size) in self.worlds.iter().zip(&self.sizes) {
                let (part, rest) = knots.split_at_mut(size * width);
                let (shift_sq, other) = shifts.split_at_mut(*size);
                let score = step.score.map(|s| &s[at * width..(at + size) * width]);
                let sums = sums.as_mut().and_then(Iterator::next);
                (knots, shifts, at) = (rest, other, at + size);
                if let Some(context) = context {
                    jobs.push(Job { context, knots: part, shift_sq, watch: sums.zip(score) });
                }
            }
        }
        let (config, map, mask) = (self.config, &self.knots, self.mask.as_slice());
        let run = |job: Job<'_, '_>| {
            let mut scratch = Scratch::new(config, map, job.context);
            if let Some((sums, score)) = job.watch {
                sums.add(&scratch.gradients(job.knots), score, width);
            }
            scratch.adjust(mask, job.knots, job.shift_sq, step);
        };
        if jobs.len() < PARALLEL_JOBS {
            jobs.into_iter().for_each(run);
        } else {
            jobs.into_par_iter().for_each(run);
        }
    }

    /// Moves the knots of finished plans, all steps at once.
    pub fn adjust_finished(&mut self, knots: &mut [f32]) {
        if self.is_active() {
            self.adjust(knots, GuidanceStep { sigma: 1.0, gain: 1.0, score: None });
        }
    }

    /// Has each agent's sample selected for itself, against predicted plans [R, knots, 2] of all others. Otherwise sample n
    /// of all agents of a world is one future. With `draws`, a guided agent chooses among its first ones, so many at a guidance
    /// scale of 1, and unguided agents take the first.
    pub fn choose_against(&mut self, predicted: Vec<f32>, draws: Option<usize>) {
        (self.predicted, self.draws) = (Some(predicted), draws);
    }

    /// Samples among which each agent of a world chooses, [M].
    fn choices(&self, context: &GuidanceContext<'_>) -> Vec<usize> {
        let (n, anybody) = (self.num_samples, context.guided.contains(&true));
        let of = |guided: &bool| match self.draws.filter(|_| anybody) {
            None => n,
            Some(_) if !guided => 1,
            Some(draws) => n.min(1 + (context.guidance_scale * (draws - 1) as f32).round() as usize),
        };
        context.guided.iter().map(of).collect()
    }

    /// Of each row the share of a move that is made, 0 for rows that are not guided, and one over the agents of its world, [N · R].
    pub fn row_scales(&self) -> Vec<[f32; 2]> {
        let of_world = |(world, size): (&Option<GuidanceContext<'_>>, &usize)| {
            let guided = |agent: &usize| world.as_ref().filter(|world| world.guided[*agent]);
            let scale = |agent| guided(&agent).map_or(0.0, |world| world.guidance_scale);
            (0..*size).map(|agent| [scale(agent), 1.0 / *size as f32]).collect::<Vec<_>>()
        };
        self.worlds.iter().zip(&self.sizes).flat_map(of_world).collect::<Vec<_>>().repeat(self.num_samples)
    }

    /// Gradient of the total of all weighted objectives with respect to knots [N · R, knots, 2]; zero in rows that are not
    /// guided and in knots that are not executed.
    pub fn gradient(&self, knots: &[f32]) -> Vec<f32> {
        let (width, rows) = (self.knots.width(), self.sizes.iter().sum::<usize>());
        let offsets = crate::inputs::features::row_offsets(&self.sizes);
        let jobs: Vec<(usize, usize)> = (0..self.num_samples)
            .flat_map(|sample| (0..self.sizes.len()).map(move |world| (sample, world)))
            .collect();
        let of_job = |&(sample, world): &(usize, usize)| -> Vec<f32> {
            let first = (sample * rows + offsets[world]) * width;
            let part = &knots[first..first + self.sizes[world] * width];
            let mut total = vec![0.0; part.len()];
            let Some(context) = self.worlds[world].as_ref().filter(|s| s.guided.contains(&true)) else {
                return total;
            };
            for gradient in self.gradients(world, part) {
                total.iter_mut().zip(gradient).for_each(|(t, g)| *t += g);
            }
            for (agent, row) in total.chunks_exact_mut(width).enumerate() {
                let free = f32::from(u8::from(context.guided[agent]));
                row.iter_mut().zip(&self.mask).for_each(|(g, keep)| *g *= keep * free);
            }
            total
        };
        jobs.par_iter().map(of_job).collect::<Vec<_>>().concat()
    }

    /// Gradient of each weighted objective, w · mean over agents of the loss, with respect to all knots of one sample of a
    /// world: [J][M, knots, 2]. No mask is applied. Empty for a world without guidance.
    pub fn gradients(&self, world: usize, knots: &[f32]) -> Vec<Vec<f32>> {
        let of = |context| Scratch::new(self.config, &self.knots, context).gradients(knots);
        self.worlds[world].as_ref().map_or_else(Vec::new, of)
    }

    /// What guidance did, given the finished plans [N · R, knots, 2]: one report per guided world.
    pub fn report(&self, knots: &[f32]) -> Vec<Option<GuidanceReport>> {
        let (width, rows) = (self.knots.width(), self.sizes.iter().sum::<usize>());
        let offsets: Vec<usize> = crate::inputs::features::row_offsets(&self.sizes);
        let of_world = |(world, context): (usize, &Option<GuidanceContext<'a>>)| {
            let context = context.as_ref()?;
            let (m, n) = (self.sizes[world], self.num_samples);
            let mut losses = vec![0.0; self.config.objectives.len() * n * m];
            let mut scratch = Scratch::new(self.config, &self.knots, context);
            let predicted = self.predicted.as_ref().map(|p| &p[offsets[world] * width..][..m * width]);
            for sample in 0..n {
                let first = sample * rows + offsets[world];
                let part = &knots[first * width..(first + m) * width];
                scratch.roll_all(predicted.unwrap_or(part));
                let mut evaluate = |scratch: &mut Scratch<'_, '_>, agents: std::ops::Range<usize>| {
                    let wanted: Vec<bool> = (0..m).map(|a| agents.contains(&a)).collect();
                    for (j, objective) in self.config.objectives.iter().enumerate() {
                        scratch.losses.fill(0.0);
                        scratch.evaluate(objective, &wanted, 0.0);
                        let at = (j * n + sample) * m;
                        losses[at..][agents.clone()].copy_from_slice(&scratch.losses[agents.clone()]);
                    }
                };
                let Some(predicted) = predicted else {
                    evaluate(&mut scratch, 0..m);
                    continue;
                };
                for agent in 0..m {
                    scratch.roll(agent, part);
                    evaluate(&mut scratch, agent..agent + 1);
                    scratch.roll(agent, predicted);
                }
            }
            let selected_sample = if predicted.is_some() {
                choose_per_agent(self.config, &losses, n, &self.choices(context))
            } else {
                choose_samples(self.config, &losses, n, m)
            };
            let shift = |a: usize| self.shift_sq[selected_sample[a] * rows + offsets[world] + a].sqrt();
            let sums = self
                .sums
                .as_ref()
                .map(|sums| (0..n).map(|s| sums[s * self.sizes.len() + world].clone()).collect::<Vec<_>>());
            Some(GuidanceReport {
                realism_cost: (0..m).map(|a| total_variation(shift(a)) as f32).collect(),
                shift_sigmas: (0..m).map(|a| shift(a) as f32).collect(),
                conflict: sums.and_then(|s| GradientSums::statistics(&s)),
                losses,
                selected_sample,
            })
        };
        self.worlds.par_iter().enumerate().map(of_world).collect()
    }
}
