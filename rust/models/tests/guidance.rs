//! Guidance: signs, masks, batches, bounds, choice among samples.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::ModelConfig;
use ccdiff_models::guidance::{
    AgentCollision, Approach, Guidance, GuidanceConfig, GuidanceContext, MapCollision, Objective, OverSpeed,
    PythonCost, Rollout, Target, WorldGuidance, choose_samples,
};
use ccdiff_models::noise::Noise;
use common::toy::{BOTH_WAYS, NEAR_MISS, T, Toy, evaluate, toy};

fn config(objectives: Vec<Objective>) -> GuidanceConfig {
    let base = GuidanceConfig::default();
    GuidanceConfig {
        objectives,
        discount: 1.0,
        gradient_steps: 4,
        learning_rate: 0.3,
        least_target_mps: 0.0,
        ..base
    }
}

fn collision(weight: f32) -> Objective {
    Objective::AgentCollision(AgentCollision { weight, ..AgentCollision::default() })
}

fn approach(weight: f32) -> Objective {
    Objective::Approach(Approach { weight })
}

/// Guides a toy for a number of denoising steps; returns knots.
fn guided(toy: &Toy, guide: &WorldGuidance<'_>, config: &GuidanceConfig, steps: usize) -> Vec<f32> {
    let (mut all, mut knots) = (alone(toy, guide, config), toy.still());
    for _ in 0..steps {
        all.adjust(&mut knots, None);
    }
    knots
}

/// The guidance of one sample of a toy.
fn alone<'a>(toy: &Toy, guide: &WorldGuidance<'a>, config: &'a GuidanceConfig) -> Guidance<'a> {
    let (m, context) = (toy.features.agents.len(), toy.context(guide, config));
    Guidance::new(config, &toy.model, vec![Some(context)], &[m], 1, false)
}

/// Least distance between the disks of agents 0 and 1 less that at which they touch, metres.
fn gap_m(s: &GuidanceContext<'_>, plan: &Rollout) -> f32 {
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
        let guide = WorldGuidance::new(&who);
        let s = toy.context(&guide, config);
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
        let config = GuidanceConfig { executed_steps: Some(5), ..base };
        let (before, after) = (toy.still(), guided(&toy, &WorldGuidance::new(&who), &config, 3));
        for (k, (a, b)) in before.iter().zip(&after).enumerate() {
            let (agent, knot) = (k / 2 / knots_per_agent, k / 2 % knots_per_agent);
            if agent != 0 || knot >= free {
                assert_eq!(a.to_bits(), b.to_bits(), "agent {agent}, knot {knot}");
            }
        }
        assert_ne!(before[..2 * free], after[..2 * free]);
    }
}

#[test]
fn a_finished_plan_moves_by_no_more_than_its_bound_and_tells_how_far() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, false];
    let of = |bound_m: Option<f32>| {
        let config = GuidanceConfig { bound_m, ..config(vec![approach(-10.0)]) };
        let context = toy.context(&WorldGuidance::new(&who), &config);
        let (start, mut knots) = (toy.roll_knots(&context, &toy.still()), toy.still());
        let mut guide = alone(&toy, &WorldGuidance::new(&who), &config);
        guide.adjust_finished(&mut knots);
        let report = guide.report(&knots).remove(0).unwrap();
        let end = toy.roll_knots(&context, &knots);
        // 2 s are 20 steps of 0.1 s
        let moved_m = (end.x_m[19] - start.x_m[19]).hypot(end.y_m[19] - start.y_m[19]);
        assert!((report.moved_m[0] - moved_m).abs() < 1e-4, "{} and {moved_m}", report.moved_m[0]);
        assert_eq!(report.moved_m[1..], [0.0, 0.0]);
        (moved_m, knots)
    };
    let (free_m, free) = of(None);
    let (bounded_m, bounded) = of(Some(0.25 * free_m));
    assert!(bounded_m <= 0.25 * free_m && bounded_m > 0.24 * free_m, "{bounded_m} of {free_m}");
    // the whole plan is moved by one share of the free move
    let shares = toy.still().into_iter().zip(free.iter().zip(&bounded)).filter(|(x, (f, _))| *f != x);
    let shares: Vec<f32> = shares.map(|(x, (free, bounded))| (bounded - x) / (free - x)).collect();
    assert!(shares.iter().all(|s| *s > 0.0 && *s < 1.0 && (s - shares[0]).abs() < 1e-3), "{shares:?}");
    assert_eq!(of(Some(2.0 * free_m)), (free_m, free));
}

#[test]
fn what_was_moved_before_it_was_finished_has_no_plan_to_be_measured_from() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let config = GuidanceConfig { target: Target::Mean, ..config(vec![approach(-10.0)]) };
    let mut guide = alone(&toy, &WorldGuidance::new(&[true, false, false]), &config);
    let mut knots = toy.still();
    guide.adjust(&mut knots, None);
    let report = guide.report(&knots).remove(0).unwrap();
    assert!(report.moved_m[0].is_nan() && report.moved_m[1..] == [0.0, 0.0]);
}

#[test]
fn who_is_planned_to_stand_is_not_run_into() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, false];
    let moved = |sign: f32, least_target_mps: f32| {
        let objectives = vec![collision(-50.0 * sign), approach(-10.0 * sign)];
        let config = GuidanceConfig { least_target_mps, ..config(objectives) };
        guided(&toy, &WorldGuidance::new(&who), &config, 2) != toy.still()
    };
    let fastest = {
        let config = config(Vec::new());
        let context = toy.context(&WorldGuidance::new(&who), &config);
        let plan = toy.roll_knots(&context, &toy.still());
        plan.speed_mps.iter().fold(0.0f32, |most, v| most.max(v.abs()))
    };
    assert!(moved(1.0, 0.0) && moved(1.0, 0.5 * fastest));
    assert!(!moved(1.0, fastest + 1.0));
    assert!(moved(-1.0, fastest + 1.0), "who avoids contacts avoids these, too");
}

#[test]
fn a_named_target_that_stands_or_is_planned_to_is_avoided() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let (who, targets) = ([true, false, false], [false, true, false]);
    let named = WorldGuidance { collision_targets: Some(&targets), ..WorldGuidance::new(&who) };
    let gap = |guide: &WorldGuidance<'_>, least_target_mps: f32| {
        let config = GuidanceConfig { least_target_mps, ..config(vec![collision(-50.0), approach(-10.0)]) };
        let context = toy.context(guide, &config);
        gap_m(&context, &toy.roll_knots(&context, &guided(&toy, guide, &config, 2)))
    };
    let alone = gap(&WorldGuidance::new(&who), 100.0); // nobody is a target, and nobody is avoided
    assert!(gap(&named, 0.0) < alone - 0.1, "{} {alone}", gap(&named, 0.0));
    assert!(gap(&named, 100.0) > alone + 0.1, "{} {alone}", gap(&named, 100.0));
}

#[test]
fn a_loss_in_python_without_python_is_an_error_and_moves_nothing() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, false];
    let cost = PythonCost { call: "module:cost".into(), ..PythonCost::default() };
    let config = config(vec![Objective::Python(cost)]);
    let mut guide = alone(&toy, &WorldGuidance::new(&who), &config);
    let mut knots = toy.still();
    guide.adjust_finished(&mut knots);
    assert_eq!(knots, toy.still());
    assert_eq!(guide.failure(), Some("module:cost: Python is not there"));
}

#[test]
fn the_strength_scales_the_steps() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true, false, false];
    // a first step of Adam is the rate in each coordinate
    let config = GuidanceConfig { gradient_steps: 1, ..config(vec![approach(-10.0)]) };
    let moved = |guidance_scale: f32| {
        let guide = WorldGuidance { guidance_scale, ..WorldGuidance::new(&who) };
        let after = guided(&toy, &guide, &config, 1);
        toy.still().iter().zip(after).map(|(a, b)| b - a).collect::<Vec<f32>>()
    };
    let (whole, half) = (moved(1.0), moved(0.5));
    assert!(whole.iter().any(|d| *d != 0.0));
    assert!(whole.iter().zip(half).all(|(w, h)| (0.5 * w - h).abs() < 1e-6));
    assert!(moved(0.0).iter().all(|d| *d == 0.0));
}

#[test]
fn a_worlds_guidance_has_the_same_bits_alone_and_among_others() {
    let (a, b) = (toy(&NEAR_MISS, ModelConfig::fast()), toy(&BOTH_WAYS, ModelConfig::fast()));
    let (who_a, who_b) = ([true, true, false], [true, false, true, true]);
    let config = config(vec![collision(-50.0), approach(-10.0)]);
    let noisy = |toy: &Toy, sample: u64| -> Vec<f32> {
        let still = toy.still();
        let noise = Noise::new(3, sample).normals(still.len());
        still.iter().zip(noise).map(|(s, n)| s + 0.5 * n).collect()
    };
    let alone = |toy: &Toy, who: &[bool], sample: u64| {
        let mut knots = noisy(toy, sample);
        alone(toy, &WorldGuidance::new(who), &config).adjust(&mut knots, None);
        knots
    };
    let worlds = vec![
        Some(a.context(&WorldGuidance::new(&who_a), &config)),
        None,
        Some(b.context(&WorldGuidance::new(&who_b), &config)),
    ];
    let mut guide = Guidance::new(&config, &a.model, worlds, &[3, 4, 4], 2, false);
    let parts = |sample: u64| [noisy(&a, sample), noisy(&b, sample), noisy(&b, sample)];
    let mut knots = [parts(0).concat(), parts(1).concat()].concat();
    guide.adjust(&mut knots, None);
    let expected: Vec<f32> = [0, 1]
        .into_iter()
        .flat_map(|sample| [alone(&a, &who_a, sample), noisy(&b, sample), alone(&b, &who_b, sample)].concat())
        .collect();
    assert_eq!(knots, expected);
    assert!(guide.report(&knots)[1].is_none());
}

#[test]
fn only_contacts_with_a_partner_count_where_partners_are_named() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [true; 3];
    let config = config(vec![approach(-10.0)]);
    let collision_targets = [false, false, true];
    let guide = WorldGuidance { collision_targets: Some(&collision_targets), ..WorldGuidance::new(&who) };
    let s = toy.context(&guide, &config);
    let (losses, _) = evaluate(&approach(-10.0), &s, &toy.roll_knots(&s, &toy.still()));
    assert_eq!(losses, [0.0; 3]);
    assert_eq!(guided(&toy, &guide, &config, 2), toy.still());
}

#[test]
fn samples_are_chosen_by_signed_weights_and_shared_where_an_objective_is_joint() {
    // two objectives, two samples, two agents
    let losses = [0.0, 0.4, 0.9, 0.1, /* off-road */ 5.0, 0.0, 0.0, 1.0];
    let map = Objective::MapCollision(MapCollision::default());
    let joint = config(vec![collision(-50.0), map.clone()]);
    assert_eq!(choose_samples(&joint, &losses, 2, 2), [1, 1]);
    let map_alone = config(vec![map]);
    assert_eq!(choose_samples(&map_alone, &losses[4..], 2, 2), [1, 0]);
    let seek = config(vec![collision(-50.0)]);
    assert_eq!(choose_samples(&seek, &losses, 2, 2), [1, 1]);
    // contact 0.10, 0, 0.30 and road 0.02, 0.05, 0.01 of three samples of one agent
    let losses = [0.10, 0.0, 0.30, 0.02, 0.05, 0.01];
    assert_eq!(choose_samples(&joint, &losses, 3, 1), [2]);
    // rows of three samples and two agents: one index for both, or one for each
    let rows = [-3.0, -1.0, -1.0, -4.0, -2.0, -2.5].map(|v: f32| v / -50.0);
    assert_eq!(choose_samples(&seek, &rows, 3, 2), [1, 1]);
    let each = [-3.0, -1.0, -1.0, -4.0, -2.0, -2.5];
    assert_eq!(choose_samples(&map_alone, &each, 3, 2), [0, 1]);
}

#[test]
fn gradient_statistics_say_who_pulls_which_way() {
    let toy = toy(&NEAR_MISS, ModelConfig::fast());
    let who = [false; 3];
    let config =
        config(vec![approach(-10.0), Objective::OverSpeed(OverSpeed { weight: -1.0, limit_mps: Some(1.0) })]);
    let context = toy.context(&WorldGuidance::new(&who), &config);
    let mut guide = Guidance::new(&config, &toy.model, vec![Some(context)], &[3], 1, true);
    let mut knots = toy.still();
    let gradients = guide.gradients(0, &knots);
    // a score that agrees with guidance for agent 0 and contradicts it for agent 1
    let width = 26;
    let score: Vec<f32> =
        (0..3 * width).map(|k| (gradients[0][k] + gradients[1][k]) * [-2.0, 0.5, 0.0][k / width]).collect();
    guide.adjust(&mut knots, Some(&score));
    assert_eq!(knots, toy.still(), "nobody is guided");
    let found = guide.report(&knots).remove(0).unwrap().conflict.unwrap();
    assert!((found.cosine[0] - 1.0).abs() < 1e-5 && (found.cosine[1] + 1.0).abs() < 1e-5);
    assert_eq!((found.cosine[2], found.conflict_share.as_slice()), (0.0, [0.0, 1.0, 0.0].as_slice()));
    assert!(found.alignment[0] > 0.0 && found.alignment[1] < 0.0);
    assert!((found.objective_cosine[0] - 1.0).abs() < 1e-5);
    assert_eq!(found.objective_cosine[1], found.objective_cosine[2]);
}
