//! Moving the plans of a batch down the guidance loss: finished ones, or in every denoising step.

use super::config::{GuidanceConfig, Target};
use super::context::GuidanceContext;
use super::descent::Descent;
use super::knots::KnotMap;
use super::objective::{Evaluation, Objective};
use super::report::{GradientSums, GuidanceReport, choose_per_agent, choose_samples};
use super::rollout::{Rollout, StateGradient};
use crate::config::ModelConfig;
use ccdiff_sim::geom::Point2;
use rayon::prelude::*;

/// Time at which the move of a finished plan is measured and bounded, seconds.
const MEASURED_S: f32 = 2.0;
/// Halvings by which a move is brought within its bound.
const HALVINGS: usize = 12;

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
    /// How far finished plans were moved by [`MEASURED_S`], metres, [N · R].
    moved_m: Vec<f32>,
    /// Gradient statistics so far, sample by sample, if asked for.
    sums: Option<Vec<GradientSums>>,
    /// Predicted knots of all rows [R, knots, 2], against which each agent's sample is selected for itself.
    predicted: Option<Vec<f32>>,
    /// Draws among which a row chooses at a guidance scale of 1; `None`: all.
    draws: Option<usize>,
}

/// Guidance, where there is any.
pub type Guide<'g, 'a> = Option<&'g mut Guidance<'a>>;

/// One sample of one world.
struct Job<'j, 'a> {
    world: usize,
    context: &'j GuidanceContext<'a>,
    knots: &'j mut [f32],
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
        let (losses, gradient) = (self.losses.as_mut_slice(), &mut self.of_states);
        of.evaluate(self.context, &[&self.plan], &mut [Evaluation { losses, gradient, wanted, scale }]);
    }

    fn vjp(&mut self, agent: usize) {
        self.plan.vjp(self.context, agent, &self.of_states, &mut self.of_actions);
        self.map.vjp(&self.of_actions, &mut self.of_knots);
    }

    /// Place of an agent at [`MEASURED_S`] by its part of the knots.
    fn place(&mut self, agent: usize, knots: &[f32]) -> Point2 {
        self.map.actions(knots, &mut self.actions);
        self.plan.roll(self.context, agent, &self.actions);
        let step = (MEASURED_S / self.context.dt_s).round().max(1.0) as usize;
        let at = agent * self.plan.num_steps + step.min(self.plan.num_steps) - 1;
        Point2::new(self.plan.x_m[at], self.plan.y_m[at])
    }

    /// Brings the move of a guided agent within the bound; returns its metres.
    fn bound(&mut self, agent: usize, before: &[f32], knots: &mut [f32]) -> f32 {
        let start = self.place(agent, before);
        let whole = knots.to_vec();
        let mut moved_m = (self.place(agent, knots) - start).norm();
        let (mut low, mut high) = (0.0, 1.0);
        let Some(bound_m) = self.config.bound_m.filter(|bound_m| moved_m > *bound_m) else {
            return moved_m;
        };
        for _ in 0..HALVINGS {
            let share = 0.5 * (low + high);
            let of = knots.iter_mut().zip(&whole).zip(before);
            of.for_each(|((x, whole), start)| *x = start + share * (whole - start));
            moved_m = (self.place(agent, knots) - start).norm();
            (low, high) = if moved_m > bound_m { (low, share) } else { (share, high) };
        }
        let of = knots.iter_mut().zip(&whole).zip(before);
        of.for_each(|((x, whole), start)| *x = start + low * (whole - start));
        (self.place(agent, knots) - start).norm()
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

/// A sample of a world and its plans.
type Part<'p, 's, 'a> = (Scratch<'s, 'a>, &'p mut [f32]);

/// Moves the guided rows of samples of one world, side by side: a loss of the user's own is asked once for all of them.
fn adjust(parts: &mut [Part<'_, '_, '_>], mask: &[f32]) {
    let Some((Scratch { config, context, map, .. }, _)) = parts.first() else { return };
    let (config, context, width) = (*config, *context, map.width());
    let m = context.num_agents();
    let rows: Vec<usize> = (0..m).filter(|a| context.guided[*a]).collect();
    if rows.is_empty() || config.gradient_steps == 0 {
        return;
    }
    let part = |a: usize| a * width..(a + 1) * width;
    let rate = config.learning_rate * context.guidance_scale;
    let start = |_: &_| -> Vec<Descent> { rows.iter().map(|_| Descent::new(rate, width)).collect() };
    let mut descents: Vec<_> = parts.iter().map(start).collect();
    for (scratch, knots) in &mut *parts {
        scratch.roll_all(knots);
    }
    for turn in 0..config.gradient_steps {
        for (scratch, knots) in &mut *parts {
            if turn > 0 {
                rows.iter().for_each(|a| scratch.roll(*a, knots));
            }
            scratch.of_states.clear();
        }
        for objective in &config.objectives {
            let scale = objective.weight() / m as f32;
            let (plans, mut out): (Vec<_>, Vec<_>) = parts
                .iter_mut()
                .map(|(Scratch { plan, losses, of_states: gradient, .. }, _)| {
                    (&*plan, Evaluation { losses, gradient, wanted: &context.guided, scale })
                })
                .unzip();
            objective.evaluate(context, &plans, &mut out);
        }
        for ((scratch, knots), descents) in parts.iter_mut().zip(&mut descents) {
            for (a, descent) in rows.iter().zip(descents) {
                scratch.vjp(*a);
                scratch.of_knots.iter_mut().zip(mask).for_each(|(g, keep)| *g *= keep);
                descent.step(&scratch.of_knots, &mut knots[part(*a)]);
            }
        }
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
            moved_m: vec![0.0; num_samples * rows],
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

    /// What went wrong in a loss of the user's own.
    pub fn failure(&self) -> Option<&str> {
        self.worlds.iter().flatten().find_map(|world| world.failure.get()).map(String::as_str)
    }

    /// Whether the gradient statistics were asked for.
    pub fn wants_score(&self) -> bool {
        self.sums.is_some()
    }

    /// Moves normalised knots [N · R, knots, 2] (sample by sample), each world and sample for itself. Rows that are not
    /// guided and knots that are not executed keep their bits. The score of the denoising process [N · R, knots, 2] is for the
    /// gradient statistics.
    pub fn adjust(&mut self, knots: &mut [f32], score: Option<&[f32]>) {
        self.visit(knots, score, true);
    }

    /// Looks at a denoising step without moving it: for the gradient statistics.
    pub fn watch(&mut self, knots: &mut [f32], score: &[f32]) {
        self.visit(knots, Some(score), false);
    }

    fn visit(&mut self, knots: &mut [f32], score: Option<&[f32]>, moves: bool) {
        let width = self.knots.width();
        let mut jobs = Vec::with_capacity(self.num_samples * self.sizes.len());
        let (mut knots, mut at) = (knots, 0);
        let mut sums = self.sums.as_mut().map(|s| s.iter_mut());
        for _ in 0..self.num_samples {
            for (world, (context, size)) in self.worlds.iter().zip(&self.sizes).enumerate() {
                let (part, rest) = knots.split_at_mut(size * width);
                let score = score.map(|s| &s[at * width..(at + size) * width]);
                let sums = sums.as_mut().and_then(Iterator::next);
                (knots, at) = (rest, at + size);
                if let Some(context) = context {
                    jobs.push(Job { world, context, knots: part, watch: sums.zip(score) });
                }
            }
        }
        let (config, map, mask) = (self.config, &self.knots, self.mask.as_slice());
        let run = |jobs: Vec<Job<'_, '_>>| {
            let mut parts = Vec::with_capacity(jobs.len());
            for job in jobs {
                let mut scratch = Scratch::new(config, map, job.context);
                if let Some((sums, score)) = job.watch {
                    sums.add(&scratch.gradients(job.knots), score, width);
                }
                parts.push((scratch, job.knots));
            }
            if moves {
                adjust(&mut parts, mask);
            }
        };
        // of samples that are asked about together, the worlds' jobs follow on each other
        let together = config.objectives.iter().any(|o| matches!(o, Objective::Python(_)));
        if together {
            jobs.sort_by_key(|job| job.world);
        }
        let size = if together { self.num_samples } else { 1 };
        let mut left = jobs.into_iter();
        let jobs: Vec<Vec<Job<'_, '_>>> = std::iter::from_fn(|| {
            Some(left.by_ref().take(size).collect::<Vec<_>>()).filter(|j| !j.is_empty())
        })
        .collect();
        if jobs.len() < PARALLEL_JOBS {
            jobs.into_iter().for_each(run);
        } else {
            jobs.into_par_iter().for_each(run);
        }
    }

    /// Moves the knots of finished plans, all steps at once.
    pub fn adjust_finished(&mut self, knots: &mut [f32]) {
        if self.is_active() {
            let before = knots.to_vec();
            self.adjust(knots, None);
            self.bound(&before, knots);
        }
    }

    /// Brings the moves of finished plans, which were `before`, within the bound, and measures them.
    pub fn bound(&mut self, before: &[f32], knots: &mut [f32]) {
        let (width, rows) = (self.knots.width(), self.sizes.iter().sum::<usize>());
        let offsets = crate::inputs::features::row_offsets(&self.sizes);
        for ((context, size), offset) in self.worlds.iter().zip(&self.sizes).zip(offsets) {
            let Some(context) = context else { continue };
            let mut scratch = Scratch::new(self.config, &self.knots, context);
            for sample in 0..self.num_samples {
                for agent in (0..*size).filter(|a| context.guided[*a]) {
                    let row = sample * rows + offset + agent;
                    let part = row * width..(row + 1) * width;
                    self.moved_m[row] = scratch.bound(agent, &before[part.clone()], &mut knots[part]);
                }
            }
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
            let measured = self.config.target == Target::Finished && self.config.gradient_steps > 0;
            let moved = |a: usize| match context.guided[a] && !measured {
                true => f32::NAN,
                false => self.moved_m[selected_sample[a] * rows + offsets[world] + a],
            };
            let sums = self
                .sums
                .as_ref()
                .map(|sums| (0..n).map(|s| sums[s * self.sizes.len() + world].clone()).collect::<Vec<_>>());
            Some(GuidanceReport {
                moved_m: (0..m).map(moved).collect(),
                conflict: sums.and_then(|s| GradientSums::statistics(&s)),
                losses,
                selected_sample,
            })
        };
        self.worlds.par_iter().enumerate().map(of_world).collect()
    }
}
