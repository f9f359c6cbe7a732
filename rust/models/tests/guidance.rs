//! Guidance: the adjoint against autograd, gradients against differences, signs, masks, batches.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::ModelConfig;
use ccdiff_models::dataset::vehicles;
use ccdiff_models::features::{self, SceneFeatures, Window};
use ccdiff_models::guidance::{
    AgentCollision, Approach, Clip, Evaluation, FilterWeights, Goal, GuidanceConfig, Guide, GuideStep,
    KnotMap, MapCollision, Objective, Optimiser, OverSpeed, Rollout, Situation, StateGradient, Target,
    TargetSpeed, WorldGuide, choose_samples,
};
use ccdiff_models::noise::Noise;
use ccdiff_models::planner::{Plan, PlanOptions, Planner, WorldView};
use ccdiff_models::sampler::{SampleOptions, Solver};
use ccdiff_models::unicycle;
use ccdiff_sim::geom::{Point2, Polygon, Region};
use proptest::prelude::*;
use tch::Tensor;

const T: usize = 52;

/// Vehicles as the models see them at one step.
struct Toy {
    window: Window,
    features: SceneFeatures,
    model: ModelConfig,
}

/// `vehicles` are (x, y, heading, speed, acceleration) 4 s before now.
fn toy(list: &[[f32; 5]], model: ModelConfig) -> Toy {
    let model = ModelConfig { map: None, ..model };
    let scene = common::scene(list, 110);
    let window = Window::from_scene(&scene, 40, &vehicles(&scene), model.history_steps);
    let features = features::build(&window, None, &model).unwrap();
    Toy { window, features, model }
}

impl Toy {
    fn situation<'a>(&self, guide: &WorldGuide<'a>, config: &GuidanceConfig) -> Situation<'a> {
        Situation::new(guide, &self.window, &self.features, &self.model, config).unwrap()
    }

    /// Rolled-out actions [M, T, 2].
    fn roll(&self, situation: &Situation<'_>, actions: &[f32]) -> Rollout {
        let mut plan = Rollout::zeros(situation.num_agents(), T);
        for (agent, row) in actions.chunks_exact(2 * T).enumerate() {
            plan.roll(situation, agent, row);
        }
        plan
    }

    /// Normalised knots of zero actions.
    fn still(&self) -> Vec<f32> {
        let n = &self.model.normalisation;
        let zero = [0, 1].map(|c| (-n.action_mean[c] / n.action_std[c]) as f32);
        zero.repeat(self.features.agents.len() * self.model.num_knots())
    }

    /// Rolled-out normalised knots.
    fn roll_knots(&self, situation: &Situation<'_>, knots: &[f32]) -> Rollout {
        let map = KnotMap::new(&self.model);
        let mut actions = vec![0.0; situation.num_agents() * 2 * T];
        for (row, out) in knots.chunks_exact(map.width()).zip(actions.chunks_exact_mut(2 * T)) {
            map.actions(row, out);
        }
        self.roll(situation, &actions)
    }
}

/// Sum over agents of the losses, each agent's loss, and the gradient.
fn evaluate(o: &Objective, s: &Situation<'_>, plan: &Rollout) -> (Vec<f32>, StateGradient) {
    let m = s.num_agents();
    let (mut losses, mut gradient) = (vec![0.0; m], StateGradient::zeros(m, T));
    let wanted = vec![true; m];
    o.evaluate(
        s,
        plan,
        &mut Evaluation { losses: &mut losses, gradient: &mut gradient, wanted: &wanted, scale: 1.0 },
    );
    (losses, gradient)
}

fn action_gradient(s: &Situation<'_>, plan: &Rollout, of_states: &StateGradient) -> Vec<f32> {
    let mut out = vec![0.0; s.num_agents() * 2 * T];
    for (agent, row) in out.chunks_exact_mut(2 * T).enumerate() {
        plan.pull_back(s, agent, of_states, row);
    }
    out
}

fn to_vec(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.contiguous().view([-1])).unwrap()
}

/// Smooth random actions of `m` agents; `size` 1 stays far from the clips, 8 meets all of them.
fn actions(m: usize, seed: u64, size: f32) -> Vec<f32> {
    let noise = Noise::new(seed, 0).normals(m * 8);
    let mut out = Vec::new();
    for a in noise.chunks_exact(8) {
        for t in 0..T {
            let wave = |k: usize| a[k] + a[k + 1] * (t as f32 * 0.15 + a[k + 2]).sin();
            out.extend([size * wave(0), 0.12 * size * wave(4)]);
        }
    }
    out
}

const BOTH_WAYS: [[f32; 5]; 4] = [
    [0.0, 0.0, 0.4, 6.0, 0.0],
    [30.0, 2.0, 3.0, 3.0, 0.1],
    [10.0, -5.0, 1.7, 0.0, 0.0],
    [-9.0, 4.0, -0.2, 9.0, -0.4],
];

#[test]
fn the_adjoint_is_that_of_torch_autograd_with_and_without_clipping() {
    let toy = toy(&BOTH_WAYS, ModelConfig::fast());
    let nobody = vec![false; 4];
    let config = GuidanceConfig::released();
    let s = toy.situation(&WorldGuide::new(&nobody), &config);
    for (seed, size) in [(1, 1.0), (2, 3.0), (3, 8.0), (4, 20.0)] {
        let given = actions(4, seed, size);
        let plan = toy.roll(&s, &given);
        let random = Noise::new(seed, 9).normals(4 * T * 4);
        let column = |c: usize| random[c * 4 * T..(c + 1) * 4 * T].to_vec();
        let of_states = StateGradient { x: column(0), y: column(1), speed: column(2), heading: column(3) };
        let ours = action_gradient(&s, &plan, &of_states);

        let x = Tensor::from_slice(&given).view([4, T as i64, 2]).set_requires_grad(true);
        let local = unicycle::rollout(&x, &Tensor::from_slice(&s.speed_mps), 0.1);
        let pose = |f: &dyn Fn(usize) -> f32| Tensor::from_slice(&[0, 1, 2, 3].map(f)).unsqueeze(1);
        let (cos, sin) = (pose(&|a| s.poses[a].cos), pose(&|a| s.poses[a].sin));
        let (lx, ly) = (local.select(2, 0), local.select(2, 1));
        let world_x = &lx * &cos - &ly * &sin + pose(&|a| s.poses[a].position.x);
        let world_y = &lx * &sin + &ly * &cos + pose(&|a| s.poses[a].position.y);
        let close = |ours: &[f32], theirs: &Tensor, what: &str| {
            let theirs = to_vec(&theirs.detach());
            let scale = theirs.iter().fold(1.0f32, |m, v| m.max(v.abs()));
            for (k, (a, b)) in ours.iter().zip(&theirs).enumerate() {
                assert!((a - b).abs() < 2e-5 * scale, "{what} of size {size} at {k}: {a}, torch {b}");
            }
        };
        close(&plan.x_m, &world_x, "x");
        close(&plan.y_m, &world_y, "y");
        close(&plan.speed_mps, &local.select(2, 2), "speed");
        let weight = |v: &[f32]| Tensor::from_slice(v).view([4, T as i64]);
        let loss = (world_x * weight(&of_states.x)
            + world_y * weight(&of_states.y)
            + local.select(2, 2) * weight(&of_states.speed)
            + local.select(2, 3) * weight(&of_states.heading))
        .sum(tch::Kind::Float);
        loss.backward();
        close(&ours, &x.grad(), "gradient");
    }
}

#[test]
fn the_knots_adjoint_is_the_transpose_of_their_spread() {
    for model in [ModelConfig::fast(), ModelConfig::paper()] {
        let map = KnotMap::new(&model);
        let knots = Noise::new(1, 1).normals(map.width());
        let of_actions = Noise::new(1, 2).normals(2 * T);
        let zero = vec![0.0; map.width()];
        let (mut out, mut at_zero, mut back) = (vec![0.0; 2 * T], vec![0.0; 2 * T], vec![0.0; map.width()]);
        map.actions(&knots, &mut out);
        map.actions(&zero, &mut at_zero);
        map.pull_back(&of_actions, &mut back);
        let left: f32 = (0..2 * T).map(|k| (out[k] - at_zero[k]) * of_actions[k]).sum();
        let right: f32 = knots.iter().zip(&back).map(|(a, b)| a * b).sum();
        assert!((left - right).abs() < 1e-3 * left.abs().max(1.0), "{left} {right}");
        let unit = unicycle::Knots::new(&model, tch::Device::Cpu);
        let n = &model.normalisation;
        let physical: Vec<f32> = knots
            .iter()
            .enumerate()
            .map(|(k, v)| v * n.action_std[k % 2] as f32 + n.action_mean[k % 2] as f32)
            .collect();
        let theirs = to_vec(&unit.spread(&Tensor::from_slice(&physical).view([1, -1, 2])));
        assert!(out.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

/// All objectives that are differentiable almost everywhere in all states.
fn smooth_objectives() -> Vec<Objective> {
    vec![
        Objective::AgentCollision(AgentCollision { buffer_m: 4.0, ..AgentCollision::default() }),
        Objective::AgentCollision(AgentCollision { num_disks: 3, buffer_m: 9.0, weight: 1.0 }),
        Objective::Approach(Approach::default()),
        Objective::OverSpeed(OverSpeed { weight: -1.0, limit_mps: Some(5.0) }),
        Objective::TargetSpeed(TargetSpeed { weight: 1.0, speed_mps: Some(4.0) }),
        Objective::Goal(Goal { weight: 1.0, at_step: Some(20) }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn gradients_of_objectives_are_their_differences(seed in 0u64..10_000, which in 0usize..6) {
        let toy = toy(&BOTH_WAYS, ModelConfig::fast());
        let all = vec![true; 4];
        let goals: Vec<Option<Point2>> = (0..4).map(|k| Some(Point2::new(40.0 - 9.0 * k as f32, 20.0))).collect();
        let config = GuidanceConfig { discount: 0.97, ..GuidanceConfig::released() };
        let s = toy.situation(&WorldGuide { goals: Some(&goals), ..WorldGuide::new(&all) }, &config);
        let objective = smooth_objectives()[which];
        let plan = toy.roll(&s, &actions(4, seed, 0.5));
        let gradient = evaluate(&objective, &s, &plan).1;
        // along a random direction of the states of the agents that move; standing ones are held (as released)
        let joint = objective.is_joint();
        let direction: Vec<f32> = Noise::new(seed, 1)
            .normals(4 * 4 * T)
            .into_iter()
            .enumerate()
            .map(|(k, v)| if joint && !s.moving[k / T % 4] { 0.0 } else { v })
            .collect();
        let of = |c: usize, k: usize| direction[c * 4 * T + k];
        let step = 4e-3f32;
        let total = |by: f32| -> f64 {
            let mut moved = plan.clone();
            for k in 0..4 * T {
                moved.x_m[k] += by * of(0, k);
                moved.y_m[k] += by * of(1, k);
                moved.speed_mps[k] += by * of(2, k);
                let heading = plan.sin[k].atan2(plan.cos[k]) + by * of(3, k);
                (moved.sin[k], moved.cos[k]) = heading.sin_cos();
            }
            evaluate(&objective, &s, &moved).0.iter().map(|l| f64::from(*l)).sum()
        };
        let terms: Vec<f64> = (0..4 * T)
            .map(|k| gradient.x[k] * of(0, k) + gradient.y[k] * of(1, k) + gradient.speed[k] * of(2, k) + gradient.heading[k] * of(3, k))
            .map(f64::from)
            .collect();
        let along: f64 = terms.iter().sum();
        let difference = (total(step) - total(-step)) / (2.0 * f64::from(step));
        let scale: f64 = terms.iter().map(|t| t.abs()).sum();
        prop_assert!((along - difference).abs() < 0.02 * scale + 3e-3, "{}: {along} {difference} of {scale}", objective.name());
    }
}

#[test]
fn a_goal_without_a_step_pulls_at_the_step_that_comes_nearest() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let all = vec![true; 3];
    let config = GuidanceConfig::released();
    // agent 0 drives from (32, 0) along x at 8 m/s: it passes x = 48 after 2 s
    let goals = [Some(Point2::new(48.0, 3.0)), None, Some(Point2::new(f32::NAN, 0.0))];
    let s = toy.situation(&WorldGuide { goals: Some(&goals), ..WorldGuide::new(&all) }, &config);
    let (losses, gradient) =
        evaluate(&Objective::Goal(Goal::default()), &s, &toy.roll_knots(&s, &toy.still()));
    assert!((losses[0] - 3.0).abs() < 1e-3 && losses[1..] == [0.0, 0.0]);
    let pulled: Vec<usize> = (0..3 * T).filter(|k| gradient.y[*k] != 0.0).collect();
    assert_eq!(pulled, [19]);
    assert!((gradient.y[19] + 1.0).abs() < 1e-3 && gradient.x[19].abs() < 1e-2);
}

/// A road along x, 8 m to each side.
fn road() -> Region {
    let corner = |x, y| Point2::new(x, y);
    let exterior = vec![corner(-100.0, -8.0), corner(300.0, -8.0), corner(300.0, 8.0), corner(-100.0, 8.0)];
    Region::new(&[Polygon { exterior, holes: Vec::new() }]).unwrap()
}

#[test]
fn the_off_road_loss_is_that_of_its_definition_and_autograd_with_frozen_points_gives_its_gradient() {
    let toy = toy(
        &[[0.0, 5.2, 0.13, 6.0, 0.0], [10.0, -6.1, -0.2, 4.0, 0.0], [40.0, 9.0, 0.0, 3.0, 0.0]],
        ModelConfig::fast(),
    );
    let all = vec![true; 3];
    let region = road();
    let config = GuidanceConfig::released();
    let s = toy.situation(&WorldGuide { road: Some(&region), ..WorldGuide::new(&all) }, &config);
    let plan = toy.roll(&s, &actions(3, 5, 0.3));
    let objective = Objective::MapCollision(MapCollision::default());
    let (losses, gradient) = evaluate(&objective, &s, &plan);
    let grid: Vec<(f64, f64)> =
        (0..100).map(|k| ((k % 10) as f64 / 9.0 - 0.5, (k / 10) as f64 / 9.0 - 0.5)).collect();
    let mut partly = 0;
    for agent in 0..3 {
        let mut expected = 0.0;
        for t in 0..T {
            let at = agent * T + t;
            let leaf = |v: f32| Tensor::from(f64::from(v)).set_requires_grad(true);
            let (x, y) = (leaf(plan.x_m[at]), leaf(plan.y_m[at]));
            let yaw =
                Tensor::from(f64::from(plan.sin[at]).atan2(f64::from(plan.cos[at]))).set_requires_grad(true);
            let along = Tensor::from_slice(&grid.iter().map(|g| g.0 * 4.5).collect::<Vec<_>>());
            let across = Tensor::from_slice(&grid.iter().map(|g| g.1 * 2.0).collect::<Vec<_>>());
            let px = &x + &along * yaw.cos() - &across * yaw.sin();
            let py = &y + &along * yaw.sin() + &across * yaw.cos();
            let on = px.ge(-100.0).logical_and(&py.abs().le(8.0));
            let count = on.sum(tch::Kind::Int64).int64_value(&[]);
            if count == 0 || count == 100 {
                assert_eq!((gradient.x[at], gradient.y[at], gradient.heading[at]), (0.0, 0.0, 0.0));
                continue;
            }
            partly += 1;
            let points = Tensor::stack(&[px, py], 1);
            let pick = |mask: &Tensor| points.index_select(0, &mask.nonzero().squeeze_dim(1));
            let (road_points, lost) = (pick(&on), pick(&on.logical_not()).detach());
            let nearest = (lost.unsqueeze(1) - road_points.unsqueeze(0))
                .norm_scalaropt_dim(2.0, [2i64].as_slice(), false)
                .min_dim(1, false)
                .0;
            let diagonal = (4.5f64 * 4.5 + 4.0).sqrt();
            let loss = (nearest / -diagonal + 1.0).sum(tch::Kind::Double) * f64::from(s.step_weights[t]);
            loss.backward();
            expected += loss.double_value(&[]);
            // ties between equally near points may fall differently: their mean direction is the same for whole rows
            for (ours, theirs, what) in [
                (gradient.x[at], &x, "x"),
                (gradient.y[at], &y, "y"),
                (gradient.heading[at], &yaw, "heading"),
            ] {
                let theirs = theirs.grad().double_value(&[]);
                assert!(
                    (f64::from(ours) - theirs).abs() < 2e-3,
                    "{what} of {agent} at {t}: {ours}, torch {theirs}"
                );
            }
        }
        assert!((f64::from(losses[agent]) - expected).abs() < 1e-3, "{agent}: {} {expected}", losses[agent]);
    }
    assert!(partly > 20 && losses[0] > 0.0, "{partly} {losses:?}");
}

/// Two vehicles that pass each other 0.6 m apart, and a third that stays away.
const NEAR_MISS: [[f32; 5]; 3] =
    [[0.0, 0.0, 0.0, 8.0, 0.0], [80.0, 2.5, std::f32::consts::PI, 6.0, 0.0], [20.0, -30.0, 0.0, 7.0, 0.0]];

fn config(objectives: Vec<Objective>) -> GuidanceConfig {
    GuidanceConfig { objectives, discount: 1.0, gradient_steps: 4, ..GuidanceConfig::rl() }
}

fn collision(weight: f32) -> Objective {
    Objective::AgentCollision(AgentCollision { weight, ..AgentCollision::default() })
}

fn approach(weight: f32) -> Objective {
    Objective::Approach(Approach { weight, ..Approach::default() })
}

/// Guides a toy for a number of denoising steps of standard deviation 0.3; returns knots.
fn guided(toy: &Toy, guide: &WorldGuide<'_>, config: &GuidanceConfig, steps: usize) -> Vec<f32> {
    let m = toy.features.agents.len();
    let mut knots = toy.still();
    let mut all =
        Guide::new(config, &toy.model, vec![Some(toy.situation(guide, config))], &[m], 1, false).unwrap();
    for _ in 0..steps {
        all.adjust(&mut knots, GuideStep { sigma: 0.3, gain: 1.0, score: None }).unwrap();
    }
    knots
}

/// Least distance between the disks of agents 0 and 1 less that at which they touch, metres.
fn gap_m(s: &Situation<'_>, plan: &Rollout) -> f32 {
    let disks = |a: usize, t: usize| {
        [-1.25, 1.25].map(|o: f32| {
            (plan.x_m[a * T + t] + o * plan.cos[a * T + t], plan.y_m[a * T + t] + o * plan.sin[a * T + t])
        })
    };
    assert_eq!((s.length_m[0], s.width_m[0]), (4.5, 2.0));
    let pairs = (0..T).flat_map(|t| disks(0, t).into_iter().flat_map(move |p| disks(1, t).map(|q| (p, q))));
    pairs.map(|(p, q)| (p.0 - q.0).hypot(p.1 - q.1) - 2.0).fold(f32::MAX, f32::min)
}

#[test]
fn a_negative_weight_turns_a_near_miss_into_a_contact_and_a_positive_one_turns_a_contact_into_a_miss() {
    let miss = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, true];
    let gap = |toy: &Toy, config: &GuidanceConfig| {
        let guide = WorldGuide::new(&who);
        let s = toy.situation(&guide, config);
        gap_m(&s, &toy.roll_knots(&s, &guided(toy, &guide, config, 6)))
    };
    let unguided = config(Vec::new());
    assert!(gap(&miss, &unguided) > 0.4);
    assert!(gap(&miss, &config(vec![collision(-50.0), approach(-10.0)])) < -0.2);
    // the paper's loss alone has no gradient here: the gap is wider than its buffer
    assert_eq!(gap(&miss, &config(vec![collision(-50.0)])), gap(&miss, &unguided));
    let mut closer = NEAR_MISS;
    closer[1][1] = 1.9;
    let touch = toy(&closer, ModelConfig::fast());
    assert!(gap(&touch, &unguided) < -0.05);
    assert!(gap(&touch, &config(vec![collision(-50.0)])) < gap(&touch, &unguided) - 0.1);
    assert!(gap(&touch, &config(vec![collision(50.0)])) > 0.1);
}

#[test]
fn only_guided_agents_and_executed_knots_move_and_the_rest_keeps_its_bits() {
    let who = [true, false, true];
    for (model, free) in [(ModelConfig::fast(), 2), (ModelConfig::paper(), 5)] {
        let toy = toy(&NEAR_MISS, model);
        let knots_per_agent = toy.model.num_knots();
        let base = config(vec![collision(-50.0), approach(-10.0)]);
        for optimiser in [Optimiser::Adam, Optimiser::Sgd] {
            for clip in [Clip::Sigma, Clip::Norm] {
                let config = GuidanceConfig { executed_steps: Some(5), optimiser, clip, ..base.clone() };
                let (before, after) = (toy.still(), guided(&toy, &WorldGuide::new(&who), &config, 3));
                for (k, (a, b)) in before.iter().zip(&after).enumerate() {
                    let (agent, knot) = (k / 2 / knots_per_agent, k / 2 % knots_per_agent);
                    if agent != 0 || knot >= free {
                        assert_eq!(a.to_bits(), b.to_bits(), "agent {agent}, knot {knot}");
                    }
                }
                assert_ne!(before[..2 * free], after[..2 * free]);
            }
        }
    }
}

#[test]
fn a_move_stays_within_sigma_and_its_cost_is_the_total_variation_of_the_gaussians() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, false];
    let config = GuidanceConfig { learning_rate: 5.0, ..config(vec![approach(-10.0)]) };
    let situation = toy.situation(&WorldGuide::new(&who), &config);
    let mut guide = Guide::new(&config, &toy.model, vec![Some(situation)], &[3], 1, false).unwrap();
    let before = toy.still();
    let mut after = before.clone();
    guide.adjust(&mut after, GuideStep { sigma: 0.3, gain: 0.5, score: None }).unwrap();
    // moved in units of the mean's standard deviation: a move of x0 reaches the mean at half its size
    let sigmas: Vec<f32> = before.iter().zip(&after).map(|(a, b)| (b - a) * 0.5 / 0.3).collect();
    assert!(sigmas.iter().all(|s| s.abs() <= 1.0 + 1e-5) && sigmas.iter().any(|s| s.abs() > 0.5));
    let report = guide.report(&after).unwrap().remove(0).unwrap();
    let zeros = vec![0.0; 26];
    let ones = vec![1.0; 26];
    let expected = ccdiff_sim::metrics::total_variation(&sigmas[..26], &zeros, &ones).unwrap() as f32;
    assert!((report.realism_cost[0] - expected).abs() < 1e-5);
    assert_eq!((report.realism_cost[1], report.shift_sigmas[2]), (0.0, 0.0));
    // a step without randomness does nothing, as the last one of a plan
    let same = after.clone();
    guide.adjust(&mut after, GuideStep { sigma: 0.0, gain: 1.0, score: None }).unwrap();
    assert_eq!(after, same);
}

#[test]
fn a_worlds_guidance_has_the_same_bits_alone_and_among_others() {
    let (a, b) = (toy(&NEAR_MISS, ModelConfig::fast()), toy(&BOTH_WAYS, ModelConfig::fast()));
    let (who_a, who_b) = ([true, true, false], [true, false, true, true]);
    let config = config(vec![collision(-50.0), approach(-10.0)]);
    let step = GuideStep { sigma: 0.4, gain: 0.7, score: None };
    let noisy = |toy: &Toy, sample: u64| -> Vec<f32> {
        let still = toy.still();
        let noise = Noise::new(3, sample).normals(still.len());
        still.iter().zip(noise).map(|(s, n)| s + 0.5 * n).collect()
    };
    let alone = |toy: &Toy, who: &[bool], sample: u64| {
        let situation = toy.situation(&WorldGuide::new(who), &config);
        let m = toy.features.agents.len();
        let mut knots = noisy(toy, sample);
        Guide::new(&config, &toy.model, vec![Some(situation)], &[m], 1, false)
            .unwrap()
            .adjust(&mut knots, step)
            .unwrap();
        knots
    };
    let worlds = vec![
        Some(a.situation(&WorldGuide::new(&who_a), &config)),
        None,
        Some(b.situation(&WorldGuide::new(&who_b), &config)),
    ];
    let mut guide = Guide::new(&config, &a.model, worlds, &[3, 4, 4], 2, false).unwrap();
    let parts = |sample: u64| [noisy(&a, sample), noisy(&b, sample), noisy(&b, sample)];
    let mut knots = [parts(0).concat(), parts(1).concat()].concat();
    guide.adjust(&mut knots, step).unwrap();
    let expected: Vec<f32> = [0, 1]
        .into_iter()
        .flat_map(|sample| [alone(&a, &who_a, sample), noisy(&b, sample), alone(&b, &who_b, sample)].concat())
        .collect();
    assert_eq!(knots, expected);
    assert!(guide.report(&knots).unwrap()[1].is_none());
}

#[test]
fn only_contacts_with_a_partner_count_where_partners_are_named() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true; 3];
    let config = config(vec![approach(-10.0)]);
    let partners = [false, false, true];
    let guide = WorldGuide { partners: Some(&partners), ..WorldGuide::new(&who) };
    let s = toy.situation(&guide, &config);
    let (losses, _) = evaluate(&approach(-10.0), &s, &toy.roll_knots(&s, &toy.still()));
    assert_eq!(losses, [0.0; 3]);
    assert_eq!(guided(&toy, &guide, &config, 2), toy.still());
}

#[test]
fn samples_are_chosen_by_signed_weights_and_shared_where_an_objective_is_joint() {
    // two objectives, two samples, two agents
    let losses = [0.0, 0.4, 0.9, 0.1, /* off-road */ 5.0, 0.0, 0.0, 1.0];
    let map = Objective::MapCollision(MapCollision::default());
    let joint = config(vec![collision(-50.0), map]);
    assert_eq!(choose_samples(&joint, &losses, 2, 2), [1, 1]);
    let released = GuidanceConfig { filter_weights: FilterWeights::Unweighted, ..joint };
    assert_eq!(choose_samples(&released, &losses, 2, 2), [1, 1]);
    let map_alone = config(vec![map]);
    assert_eq!(choose_samples(&map_alone, &losses[4..], 2, 2), [1, 0]);
    let seek = config(vec![collision(-50.0)]);
    let filter = GuidanceConfig { filter_weights: FilterWeights::Unweighted, ..seek.clone() };
    assert_eq!(
        (choose_samples(&seek, &losses, 2, 2), choose_samples(&filter, &losses, 2, 2)),
        (vec![1, 1], vec![0, 0])
    );
}

#[test]
fn gradient_statistics_say_who_pulls_which_way() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [false; 3];
    let config = config(vec![
        approach(-10.0),
        Objective::TargetSpeed(TargetSpeed { weight: 1.0, speed_mps: Some(12.0) }),
    ]);
    let situation = toy.situation(&WorldGuide::new(&who), &config);
    let mut guide = Guide::new(&config, &toy.model, vec![Some(situation)], &[3], 1, true).unwrap();
    let mut knots = toy.still();
    let gradients = guide.gradients(0, &knots).unwrap();
    // a score that agrees with guidance for agent 0 and contradicts it for agent 1
    let width = 26;
    let score: Vec<f32> =
        (0..3 * width).map(|k| (gradients[0][k] + gradients[1][k]) * [-2.0, 0.5, 0.0][k / width]).collect();
    guide.adjust(&mut knots, GuideStep { sigma: 0.3, gain: 1.0, score: Some(&score) }).unwrap();
    assert_eq!(knots, toy.still(), "nobody is guided");
    let found = guide.report(&knots).unwrap().remove(0).unwrap().conflict.unwrap();
    assert!((found.cosine[0] - 1.0).abs() < 1e-5 && (found.cosine[1] + 1.0).abs() < 1e-5);
    assert_eq!((found.cosine[2], found.conflict_share.as_slice()), (0.0, [0.0, 1.0, 0.0].as_slice()));
    assert!(found.alignment[0] > 0.0 && found.alignment[1] < 0.0);
    assert!((found.objective_cosine[0] - 1.0).abs() < 1e-5);
    assert_eq!(found.objective_cosine[1], found.objective_cosine[2]);
}

fn shipped() -> Planner {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../ccdiff_env/data/ccdiff_fast.safetensors");
    Planner::load(&path, tch::Device::Cpu).unwrap()
}

/// Plans of the shipped network for a follower, its leader and a third vehicle far off.
fn planned(
    planner: &mut Planner,
    guided: &[bool],
    guidance: Option<GuidanceConfig>,
    seeds: &[u64],
) -> Vec<Plan> {
    let scene = common::closing_pair();
    let window = Window::from_scene(&scene, 40, &vehicles(&scene), 31);
    let (bitmap, region) = (planner.bitmap(&scene), Region::new(&scene.map.drivable_area).unwrap());
    let guide = WorldGuide { road: Some(&region), ..WorldGuide::new(guided) };
    let view =
        |seed: &u64| WorldView { window: &window, bitmap: bitmap.as_ref(), seed: *seed, guide: Some(guide) };
    let views: Vec<_> = seeds.iter().map(view).collect();
    let sampling = SampleOptions { num_samples: 2, ..SampleOptions::default() };
    let options = PlanOptions { sampling, guidance, attention: true, gradient_statistics: false };
    planner.plan(&views, &options).unwrap()
}

#[test]
fn a_network_plans_contacts_or_avoids_them_as_the_sign_says_and_lone_agents_keep_their_bits() {
    let mut planner = shipped();
    let seeds: Vec<u64> = (0..6).collect();
    let guided = [true, false, false];
    let with = |weight: f32, steps: usize| GuidanceConfig {
        gradient_steps: steps,
        ..config(vec![
            collision(weight),
            approach(weight / 5.0),
            Objective::MapCollision(MapCollision::default()),
        ])
    };
    let free = planned(&mut planner, &guided, None, &seeds);
    assert!(free.iter().all(|p| p.guidance.is_none() && p.chosen() == [0, 0, 0]));
    let mut closeness = |config: GuidanceConfig| -> f32 {
        let plans = planned(&mut planner, &guided, Some(config.clone()), &seeds);
        for (plan, free) in plans.iter().zip(&free) {
            let report = plan.guidance.as_ref().unwrap();
            assert_eq!((report.losses.len(), report.chosen.len()), (3 * 2 * 3, 3));
            assert_eq!(report.realism_cost[0] > 0.0, config.gradient_steps > 0);
            assert_eq!(report.realism_cost[1..], [0.0, 0.0]);
            // the third vehicle has no edge in G: nothing that guidance does can reach it
            for sample in 0..2 {
                let own = (sample * 3 + 2) * T * 2..(sample * 3 + 3) * T * 2;
                assert_eq!(plan.actions[own.clone()], free.actions[own]);
            }
        }
        let losses = |p: &Plan| p.guidance.as_ref().map_or(0.0, |g| g.losses[6 + 3 * g.chosen[0]]);
        plans.iter().map(losses).sum()
    };
    let [seek, none, avoid] = [with(-50.0, 2), with(-50.0, 0), with(50.0, 2)].map(&mut closeness);
    assert!(seek > 1.1 * none && none > 1.1 * avoid, "{seek} {none} {avoid}");
}

#[test]
fn attention_is_given_between_joined_agents_and_adds_up_to_one() {
    let plan = planned(&mut shipped(), &[true; 3], None, &[3]).remove(0);
    let matrix = plan.attention_matrix().unwrap();
    assert_eq!(matrix.len(), 9);
    for (k, weight) in matrix.iter().enumerate() {
        let joined = plan.features.graph.contains(k / 3, k % 3) && k / 3 != k % 3;
        assert_eq!(*weight > 0.0, joined, "{k}");
    }
    assert!((matrix[..3].iter().sum::<f32>() - 1.0).abs() < 1e-5, "{matrix:?}");
}

#[test]
fn guidance_needs_more_than_one_solver_step() {
    let sampling = SampleOptions { solver: Solver::Ddim { steps: 1 }, ..SampleOptions::default() };
    let options = PlanOptions { sampling, guidance: Some(GuidanceConfig::rl()), ..PlanOptions::default() };
    assert!(options.validated().unwrap_err().to_string().contains("solver.steps"));
}

#[test]
fn guides_of_the_wrong_length_are_refused() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let config = GuidanceConfig::released();
    let short = [true, false];
    let error = Situation::new(&WorldGuide::new(&short), &toy.window, &toy.features, &toy.model, &config);
    assert!(error.unwrap_err().to_string().contains("guide guided is 2, expected 3"));
    let who = [true; 3];
    let situation = toy.situation(&WorldGuide::new(&who), &config);
    assert!(Guide::new(&config, &toy.model, vec![Some(situation.clone())], &[2], 1, false).is_err());
    let mut guide = Guide::new(&config, &toy.model, vec![Some(situation)], &[3], 1, false).unwrap();
    assert!(guide.adjust(&mut [0.0; 7], GuideStep { sigma: 1.0, gain: 1.0, score: None }).is_err());
    assert_eq!(guide.config().target, Target::Mu);
}
