//! Gradients of guidance: the adjoint against autograd, objectives against differences and their definitions.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use ccdiff_models::config::ModelConfig;
use ccdiff_models::guidance::{
    AgentCollision, Approach, GuidanceConfig, GuidanceContext, KnotMap, MapCollision, Objective, OverSpeed,
    Rollout, StateGradient, WorldGuidance,
};
use ccdiff_models::noise::Noise;
use ccdiff_models::plan_space::PlanSpace;
use ccdiff_models::unicycle;
use ccdiff_sim::geom::Region;
use common::toy::{BOTH_WAYS, T, evaluate, toy};
use proptest::prelude::*;
use tch::Tensor;

fn action_gradient(s: &GuidanceContext<'_>, plan: &Rollout, of_states: &StateGradient) -> Vec<f32> {
    let mut out = vec![0.0; s.num_agents() * 2 * T];
    for (agent, row) in out.chunks_exact_mut(2 * T).enumerate() {
        plan.vjp(s, agent, of_states, row);
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

#[test]
fn the_adjoint_is_that_of_torch_autograd_with_and_without_clipping() {
    let toy = toy(&BOTH_WAYS, ModelConfig::fast());
    let nobody = vec![false; 4];
    let config = GuidanceConfig::default();
    let s = toy.context(&WorldGuidance::new(&nobody), &config);
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
        map.vjp(&of_actions, &mut back);
        let left: f32 = (0..2 * T).map(|k| (out[k] - at_zero[k]) * of_actions[k]).sum();
        let right: f32 = knots.iter().zip(&back).map(|(a, b)| a * b).sum();
        assert!((left - right).abs() < 1e-3 * left.abs().max(1.0), "{left} {right}");
        let space = PlanSpace::new(&model, tch::Device::Cpu);
        let theirs = to_vec(&space.actions(&Tensor::from_slice(&knots).view([1, -1, 2])));
        assert!(out.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

/// All objectives that are differentiable almost everywhere in all states.
fn smooth_objectives() -> Vec<Objective> {
    vec![
        Objective::AgentCollision(AgentCollision { buffer_m: 4.0, ..AgentCollision::default() }),
        Objective::AgentCollision(AgentCollision { buffer_m: 9.0, weight: 1.0 }),
        Objective::Approach(Approach::default()),
        Objective::OverSpeed(OverSpeed { weight: -1.0, limit_mps: Some(5.0) }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn gradients_of_objectives_are_their_differences(seed in 0u64..10_000, which in 0usize..4) {
        let toy = toy(&BOTH_WAYS, ModelConfig::fast());
        let all = vec![true; 4];
        let config = GuidanceConfig { discount: 0.97, least_target_mps: 0.0, ..GuidanceConfig::default() };
        let objective = smooth_objectives().swap_remove(which);
        let s = toy.context(&WorldGuidance::new(&all), &config);
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
        let (after, before, here) = (total(step), total(-step), total(0.0));
        let difference = (after - before) / (2.0 * f64::from(step));
        // where a speed crosses the limit, the slopes to both sides differ, and any between them is a gradient
        let kink = (after + before - 2.0 * here).abs() / (2.0 * f64::from(step));
        let scale: f64 = terms.iter().map(|t| t.abs()).sum();
        prop_assert!((along - difference).abs() < 0.02 * scale + kink + 3e-3, "{}: {along} {difference} of {scale}", objective.name());
    }
}

#[test]
fn who_stands_has_a_collision_loss_where_it_may_start() {
    let toy = toy(&[[0.0; 5], [8.0, 0.0, 0.0, 0.0, 0.0]], ModelConfig::fast());
    let mut actions = vec![0.0; 4 * T];
    actions.iter_mut().take(2 * T).step_by(2).for_each(|a| *a = 2.0);
    let losses = |starts| {
        let guide = WorldGuidance { starts, ..WorldGuidance::new(&[true; 2]) };
        let s = toy.context(&guide, &GuidanceConfig::default());
        let objective = Objective::AgentCollision(AgentCollision::default());
        evaluate(&objective, &s, &toy.roll(&s, &actions)).0
    };
    assert_eq!(losses(false), [0.0; 2]);
    assert!(losses(true).iter().all(|loss| *loss > 0.0));
}

#[test]
fn the_off_road_loss_is_that_of_its_definition_and_autograd_with_frozen_points_gives_its_gradient() {
    let toy = toy(
        &[[0.0, 5.2, 0.13, 6.0, 0.0], [10.0, -6.1, -0.2, 4.0, 0.0], [40.0, 9.0, 0.0, 3.0, 0.0]],
        ModelConfig::fast(),
    );
    let all = vec![true; 3];
    let region = Region::new(&[common::road()]).unwrap();
    let config = GuidanceConfig::default();
    let s = toy.context(&WorldGuidance { road: Some(&region), ..WorldGuidance::new(&all) }, &config);
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
