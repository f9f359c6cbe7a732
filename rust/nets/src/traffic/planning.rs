//! One round of planning: planned agents, rankings, the network, and the plans that agents follow.

use super::config::{BackgroundDriver, CollisionTargets, Ranking};
use super::planned_agents::{self, PlannedAgents, RankingInputs, select_guided};
use super::reach;
use super::way_out::{self, PlannedPoses};
use super::{Memory, PlannedTraffic, side_by_side};
use crate::error::Result;
use crate::guidance::{GradientStatistics, WorldGuidance};
use crate::inputs::segments::MapLines;
use crate::networks::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use crate::sampling::noise::Noise;
use crate::sampling::sampler::SampleOptions;
use ccdiff_sim::drivers::{PlanRecord, PlanRequest, PlanState, WorldView};
use ccdiff_sim::geom::{Real, Region, Vector2};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A world that is planned for.
struct PreparedRequest<'a> {
    request: &'a PlanRequest<'a>,
    memory: Memory,
    planned: PlannedAgents,
    map: Option<Arc<MapLines>>,
    /// The road of each planned agent's level, where the scene has levels.
    roads: Vec<Option<&'a Region>>,
    /// Agents of the scene that may be guided, by falling importance.
    ranking: Vec<usize>,
    /// Agents of the scene that are singled out.
    chosen: Vec<usize>,
    /// Strength of the guidance.
    criticality: Real,
    /// Rows of the window whose plans are moved.
    guided: Vec<bool>,
    /// Rows of the window with which contacts count.
    collision_targets: Vec<bool>,
}

impl PreparedRequest<'_> {
    fn is_guided(&self) -> bool {
        self.criticality > 0.0 && self.guided.contains(&true)
    }

    /// Whether the egos have a way out between the guided vehicles.
    fn has_way_out(&self, plan: &Plan) -> bool {
        let m = plan.agents.len();
        let steps = plan.states.len() / (plan.num_samples * m * 6).max(1);
        let samples = poses(plan, steps);
        let selected = plan.selected_sample();
        let guided = plan.agents.iter().enumerate().filter(|(_, row)| self.guided[**row]);
        let plans: Vec<_> = guided
            .map(|(i, row)| PlannedPoses {
                agent_idx: self.planned.agents[*row],
                poses: &samples[(selected[i] * m + i) * steps * 3..][..steps * 3],
            })
            .collect();
        way_out::exists(&self.request.world, &plans)
    }
}

impl PlannedTraffic {
    /// Plans for worlds, each with the request that it answers.
    pub(super) fn plan_due<'a>(
        &mut self,
        requests: &[&'a PlanRequest<'a>],
    ) -> Result<Vec<(&'a PlanRequest<'a>, PlanState)>> {
        let worlds: Vec<WorldView<'_>> = requests.iter().map(|r| r.world).collect();
        self.read_maps(&worlds);
        let due = side_by_side(self.pool.as_ref(), requests.to_vec(), |r| self.prepare(r));
        let mut due = due.into_iter().collect::<Result<Vec<_>>>()?;
        self.rank(&mut due)?;
        let (with, without): (Vec<_>, Vec<_>) = due.into_iter().partition(PreparedRequest::is_guided);
        let (guided, unguided) = (self.guided.clone(), self.unguided.clone());
        let plans = self.draw(&[(&with, &guided), (&without, &unguided)], true)?;
        let options = std::iter::repeat_n(&guided, with.len()).chain(std::iter::repeat(&unguided));
        let mut made: Vec<_> =
            with.into_iter().chain(without).zip(plans).zip(options).map(|((w, p), o)| (w, p, o)).collect();
        if self.config.avoidable_only {
            let (closed, mut kept): (Vec<_>, Vec<_>) =
                made.into_iter().partition(|(world, plan, _)| world.is_guided() && !world.has_way_out(plan));
            let unguide =
                |(world, ..): (PreparedRequest<'a>, Plan, _)| PreparedRequest { criticality: 0.0, ..world };
            let worlds: Vec<_> = closed.into_iter().map(unguide).collect();
            let plans = self.draw(&[(&worlds, &unguided)], true)?;
            kept.extend(worlds.into_iter().zip(plans).map(|(w, p)| (w, p, &unguided)));
            made = kept;
        }
        Ok(made.into_iter().map(|(w, plan, options)| (w.request, self.adopt(w, plan, options))).collect())
    }

    fn prepare<'a>(&self, request: &'a PlanRequest<'a>) -> Result<PreparedRequest<'a>> {
        let world = &request.world;
        let memory = match request.plan {
            Some(plan) => Memory::of(plan, world.states.len())?,
            None => Memory {
                parked: planned_agents::parked(world, self.config.parked_rule),
                left_log: vec![false; world.states.len()],
                noise_seed: world.noise_seed,
                first_ranking: Vec::new(),
            },
        };
        let backs_up = |a: usize| self.config.follow_route && world.backs_up(a);
        let stands = |a: usize| memory.parked[a] || world.halted[a] || backs_up(a);
        let still: Vec<bool> = (0..world.states.len()).map(stands).collect();
        let mut planned =
            PlannedAgents::new(request, &still, self.model.history_steps, self.config.plan_radius_m)?;
        self.keep_noise(&memory, &mut planned);
        if self.config.follow_route {
            planned.tell_routes(world, &self.model.route_points_m);
        }
        if self.ranks(request) {
            planned.window.measure_contacts();
        }
        let map = self.map(world).cloned();
        let counts = |agent: &usize| match (&self.config.targets[..], self.config.collision_targets) {
            ([], CollisionTargets::All) => true,
            ([], CollisionTargets::Ego) => planned_agents::is_ego(world, *agent),
            (targets, _) => targets.contains(&world.scene.scene.agents[*agent].id),
        };
        let collision_targets = planned.agents.iter().map(counts).collect();
        let (guided, criticality) = (vec![false; planned.agents.len()], 0.0);
        let road_of = |a: &usize| Some(world.scene.at(Some(world.states.elevation_m(*a)?)).road.as_ref());
        let roads = planned.agents.iter().filter_map(road_of).collect();
        Ok(PreparedRequest {
            request,
            memory,
            planned,
            map,
            roads,
            ranking: Vec::new(),
            chosen: Vec::new(),
            criticality,
            guided,
            collision_targets,
        })
    }

    /// Whether the agents of a world are ranked for its coming plan.
    fn ranks(&self, request: &PlanRequest<'_>) -> bool {
        self.config.rerank || request.plan.is_none()
    }

    /// Hands the vehicles the noise that they keep for the episode.
    fn keep_noise(&self, memory: &Memory, planned: &mut PlannedAgents) {
        if self.config.keep_noise {
            let of = |a: &usize| Noise::new(memory.noise_seed, *a as u64).block(0);
            let seeds = planned.agents.iter().map(of).map(|w| u64::from(w[0]) << 32 | u64::from(w[1]));
            planned.window.noise_seed = seeds.collect();
        }
    }

    /// Fills in rankings and the guided agents.
    fn rank(&mut self, due: &mut [PreparedRequest<'_>]) -> Result<()> {
        let mut ranking_inputs = self.ranking_inputs(due)?;
        ranking_inputs.resize_with(due.len(), RankingInputs::default);
        let (traffic, config) = (&*self, &self.config);
        let rank = |(d, mut inputs): (&mut PreparedRequest<'_>, RankingInputs)| -> Result<()> {
            let ranks = traffic.ranks(d.request);
            if ranks && config.ranking == Ranking::Ttc {
                inputs.scores = Some(d.planned.contact_scores(&d.collision_targets));
            }
            if ranks && config.ranking == Ranking::Reach {
                inputs.scores = Some(reach::scores(&d.planned.window, &d.collision_targets));
            }
            d.ranking = if ranks {
                d.planned.ranking(&d.request.world, config, &inputs)?
            } else {
                d.memory.first_ranking.clone()
            };
            let fits = |a: &usize| {
                let conflict = || d.planned.conflict(*a, &d.collision_targets);
                config.conflicts.is_empty() || conflict().is_some_and(|c| config.conflicts.contains(&c))
            };
            let policy = traffic.adversary_policy.as_ref();
            let (chosen, strength) = select_guided(d.request, config, policy, &d.ranking, fits);
            let criticality = d.request.plan_override.criticality.unwrap_or(config.criticality);
            d.chosen = chosen;
            d.criticality = if config.guides_at(&d.request.world) { criticality * strength } else { 0.0 };
            d.guided = d.planned.agents.iter().map(|a| d.chosen.contains(a)).collect();
            Ok(())
        };
        let items = due.iter_mut().zip(ranking_inputs).collect();
        side_by_side(self.pool.as_ref(), items, rank).into_iter().collect()
    }

    /// What some rankings ask the network for: attention, or how the gradients agree. Nothing is guided here.
    fn ranking_inputs(&mut self, due: &[PreparedRequest<'_>]) -> Result<Vec<RankingInputs>> {
        let greedy = self.config.ranking == Ranking::Greedy;
        if !greedy && self.config.ranking != Ranking::Gradient {
            return Ok(Vec::new());
        }
        let sampling = SampleOptions {
            solver_steps: Some(if greedy { 1 } else { 2 }),
            num_samples: 1,
            guidance_weight: 1.0,
            ..SampleOptions::default()
        };
        let guidance = if greedy { None } else { self.guided.guidance.clone() };
        let options = PlanOptions { sampling, guidance, attention: greedy, gradient_statistics: !greedy };
        let plans = self.draw(&[(due, &options)], false)?;
        Ok(plans
            .into_iter()
            .map(|plan| RankingInputs {
                weights: Some(plan.features.graph.weights(plan.attention_matrix().as_deref())),
                scores: plan.guidance.and_then(|g| g.conflict).map(|c| c.alignment),
            })
            .collect())
    }

    /// Plans of groups of worlds, each with its options, one after the other. All batches of the network wait in one line,
    /// from which every thread takes the next.
    fn draw(&mut self, groups: &[(&[PreparedRequest<'_>], &PlanOptions)], moves: bool) -> Result<Vec<Plan>> {
        let named = self.config.names_targets();
        let tokens = self.copies.get_mut().first().is_some_and(|model| model.network().samples_tokens);
        // with the scale of the guidance
        let moved = |d: &PreparedRequest<'_>| match (moves, d.is_guided(), self.config.careful) {
            (true, true, _) => (d.guided.clone(), self.config.guidance_scale(tokens, d.criticality)),
            (true, false, true) => (d.planned.driven.clone(), 1.0),
            _ => (vec![false; d.guided.len()], d.criticality),
        };
        let moved: Vec<Vec<(Vec<bool>, Real)>> =
            groups.iter().map(|(due, _)| due.iter().map(moved).collect()).collect();
        let most = self.copies.get_mut().first().map_or(1, |model| model.planner().most_worlds()).max(1);
        let mut shards: Vec<(Vec<PlanInput<'_>>, &PlanOptions)> = Vec::new();
        for ((due, options), moved) in groups.iter().zip(&moved) {
            // about equally large
            let size = due.len().div_ceil(due.len().div_ceil(most).max(1)).max(1);
            for (due, moved) in due.chunks(size).zip(moved.chunks(size)) {
                let views = due.iter().zip(moved).map(|(d, m)| view_of(d, m, options, (tokens, named)));
                shards.push((views.collect(), options));
            }
        }
        let next = AtomicUsize::new(0);
        let work = |model: &mut TrajectoryModel| {
            let mut own = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some((views, options)) = shards.get(at) else { return own };
                own.push((at, model.plan(views, options)));
            }
        };
        let made = side_by_side(self.pool.as_ref(), self.copies.get_mut().iter_mut().collect(), work);
        let mut made: Vec<_> = made.into_iter().flatten().collect();
        made.sort_unstable_by_key(|(at, _)| *at);
        let plans = made.into_iter().map(|(_, plans)| plans).collect::<Result<Vec<_>>>()?;
        Ok(plans.into_iter().flatten().collect())
    }

    /// The plan that a world follows from now on.
    fn adopt(&self, mut due: PreparedRequest<'_>, plan: Plan, options: &PlanOptions) -> PlanState {
        let (background, mut memory) = (self.config.background_driver, std::mem::take(&mut due.memory));
        let (n, m) = (plan.num_samples, plan.agents.len());
        let steps = plan.states.len() / (n * m * 6).max(1);
        let agents: Vec<usize> = plan.agents.iter().map(|row| due.planned.agents[*row]).collect();
        let follows = |(row, a): (&usize, &usize)| {
            due.planned.driven[*row]
                && match background {
                    BackgroundDriver::Ccdiff => true,
                    BackgroundDriver::Idm => due.chosen.contains(a),
                    BackgroundDriver::Replay => due.chosen.contains(a) || memory.left_log[*a],
                }
        };
        let follows_plan: Vec<bool> = plan.agents.iter().zip(&agents).map(follows).collect();
        for (agent, follows) in agents.iter().zip(&follows_plan) {
            memory.left_log[*agent] |= *follows;
        }
        let selected_sample = plan.selected_sample();
        let speed_mps = speeds(&plan, &selected_sample, steps);
        if due.request.plan.is_none() {
            memory.first_ranking.clone_from(&due.ranking);
        }
        let guided = |row: &usize| due.is_guided() && due.guided[*row];
        let report = plan.guidance.as_ref();
        let objectives = options.guidance.as_ref().filter(|_| report.is_some());
        let gradients = report.and_then(|r| r.conflict.as_ref());
        let kept = |of: fn(&GradientStatistics) -> &Vec<Real>| gradients.map(of).cloned().unwrap_or_default();
        let record = PlanRecord {
            made_at: due.request.world.elapsed_steps,
            follows_plan,
            guided: plan.agents.iter().map(guided).collect(),
            graph: plan.features.graph.as_slice().to_vec(),
            ttc_s: plan.features.ttc_s.clone(),
            attention: plan.attention_matrix().unwrap_or_default(),
            ranking: due.ranking.clone(),
            num_samples: n,
            num_steps: steps,
            samples: poses(&plan, steps),
            selected_sample,
            objectives: objectives
                .map(|g| g.objectives.iter().map(|o| o.name().into()).collect())
                .unwrap_or_default(),
            losses: report.map(|r| r.losses.clone()).unwrap_or_default(),
            moved_m: report.map(|r| r.moved_m.clone()).unwrap_or_default(),
            gradient_cosine: kept(|g| &g.objective_cosine),
            realism_cosine: kept(|g| &g.cosine),
            conflict_share: kept(|g| &g.conflict_share),
            agents,
        };
        PlanState { record, speed_mps, memory: memory.to_bytes() }
    }
}

/// What the model sees of a world, whose rows `moved` says guidance moves, and at which scale: a model of tokens or not, with named
/// targets or all.
fn view_of<'a>(
    due: &'a PreparedRequest<'_>,
    (moved, guidance_scale): &'a (Vec<bool>, Real),
    options: &PlanOptions,
    (tokens, named): (bool, bool),
) -> PlanInput<'a> {
    let world = &due.request.world;
    PlanInput {
        window: &due.planned.window,
        map: due.map.as_deref(),
        seed: world.noise_seed,
        guide: options.guidance.is_some().then(|| WorldGuidance {
            guidance_scale: *guidance_scale,
            road: world.scene.road.as_ref(),
            roads: (!due.roads.is_empty()).then_some(due.roads.as_slice()),
            collision_targets: (named && due.is_guided()).then_some(&due.collision_targets),
            speed_limit_mps: Some(world.speed_limit_mps),
            starts: tokens && !due.is_guided(),
            ..WorldGuidance::new(moved)
        }),
    }
}

/// Poses of all samples in the scene frame, [N, M, T, 3].
fn poses(plan: &Plan, steps: usize) -> Vec<Real> {
    let frames = plan.features.poses.iter().cycle();
    let trajectories = plan.states.chunks_exact((steps * 6).max(1));
    let mut out = Vec::with_capacity(plan.states.len() / 2);
    for (frame, states) in frames.zip(trajectories) {
        for state in states.chunks_exact(6) {
            let at = frame.position + frame.rotate(Vector2::new(state[0], state[1]));
            out.extend([at.x, at.y, frame.heading_rad + state[3]]);
        }
    }
    out
}

/// Speeds of the selected samples, [M, T].
fn speeds(plan: &Plan, selected_sample: &[usize], steps: usize) -> Vec<Real> {
    let m = plan.agents.len();
    let of_row = |(row, sample): (usize, &usize)| {
        let from = (sample * m + row) * steps * 6;
        plan.states[from..from + steps * 6].chunks_exact(6).map(|s| s[2]).collect::<Vec<_>>()
    };
    selected_sample.iter().enumerate().flat_map(of_row).collect()
}
