//! Drivers that plan, mixed traffic, drivers of single vehicles, refusals.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use ccdiff_sim::Result;
use ccdiff_sim::drivers::{DriverModel, PlanRecord, PlanRequest, PlanState};
use ccdiff_sim::world::{Autoreset, Consequence, Traffic, VecWorld, WorldConfig};
use common::{Batch, actions, city};
use std::collections::BTreeMap;

/// Lets every vehicle that it drives go straight on at a speed of its own, planning every few steps.
struct Steady {
    speed_mps: f32,
    replan_steps: usize,
}

const STEPS: usize = 6;

impl Steady {
    fn boxed(speed_mps: f32) -> Box<dyn DriverModel> {
        Box::new(Self { speed_mps, replan_steps: 4 })
    }

    fn plan_one(&self, request: &PlanRequest<'_>) -> PlanState {
        let world = &request.world;
        let agents: Vec<usize> =
            (0..world.states.len()).filter(|a| world.states.active[*a] && request.drives(*a)).collect();
        let m = agents.len();
        let mut record = PlanRecord {
            made_at: world.elapsed_steps,
            follows_plan: vec![true; m],
            guided: vec![false; m],
            graph: vec![false; m * m],
            ttc_s: vec![0.0; m * m],
            num_samples: 1,
            num_steps: STEPS,
            selected_sample: vec![0; m],
            ..PlanRecord::default()
        };
        for a in &agents {
            let pose = world.states.pose(*a);
            for t in 1..=STEPS {
                let way_m = self.speed_mps * world.dt_s * t as f32;
                let p = pose.position;
                record.samples.extend([p.x + way_m * pose.cos, p.y + way_m * pose.sin, pose.heading_rad]);
            }
        }
        record.agents = agents;
        // how many plans the episode has seen
        let seen = request.plan.map_or(0, |p| p.memory[0]);
        PlanState { record, speed_mps: vec![self.speed_mps; m * STEPS], memory: vec![seen + 1] }
    }
}

impl DriverModel for Steady {
    fn name(&self) -> &str {
        "steady"
    }

    fn history_states(&self) -> usize {
        3
    }

    fn plan(&mut self, requests: &[PlanRequest<'_>]) -> Result<Vec<Option<PlanState>>> {
        let plan = |r: &PlanRequest<'_>| {
            assert_eq!(r.world.history.map(|h| h.len() >= 3), Some(true));
            r.is_due(self.replan_steps).then(|| self.plan_one(r))
        };
        Ok(requests.iter().map(plan).collect())
    }
}

fn config(traffic: Traffic) -> WorldConfig {
    WorldConfig {
        traffic,
        horizon_steps: 30,
        autoreset: Autoreset::Disabled,
        on_collision: Consequence::Ignore,
        on_off_road: Consequence::Ignore,
        terminate_at_goal: false,
        ..WorldConfig::default()
    }
}

fn mix(shares: &[(&str, f32)]) -> Traffic {
    Traffic::Mix(shares.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect())
}

fn batch(config: WorldConfig, envs: usize, threads: usize) -> Batch {
    let drivers = vec![("slow".to_owned(), Steady::boxed(3.0)), ("fast".to_owned(), Steady::boxed(9.0))];
    Batch::with_drivers(vec![city(20), city(9)], config, envs, threads, drivers)
}

/// Names of the drivers of a world's agents.
fn names(world: &VecWorld, world_idx: usize) -> Vec<String> {
    let status = world.status(world_idx).unwrap();
    status.drivers.iter().map(|d| world.driver_name(*d).0.to_owned()).collect()
}

#[test]
fn several_drivers_plan_in_one_world_and_each_is_followed() {
    let mut batch = batch(config(mix(&[("slow", 0.5), ("fast", 0.5)])), 2, 1);
    batch.reset_all(3);
    assert_eq!(batch.world.planner_names().collect::<Vec<_>>(), ["slow", "fast"]);
    assert!(batch.world.explain(0, Some("fast")).unwrap().is_none());
    for t in 0..9 {
        batch.step(&actions(t, 4)).unwrap();
        let drivers = names(&batch.world, 0);
        for (name, speed) in [("slow", 3.0), ("fast", 9.0)] {
            let plan = batch.world.explain(0, Some(name)).unwrap().unwrap();
            assert_eq!(plan.made_at, t / 4 * 4);
            assert!(!plan.agents.is_empty() && plan.agents.iter().all(|a| drivers[*a] == name));
            let states = batch.world.status(0).unwrap().states;
            for a in plan.agents.iter().filter(|a| states.active[**a]) {
                assert!((states.speed_mps[*a] - speed).abs() < 1e-4, "agent {a} of {name}");
            }
        }
    }
}

#[test]
fn nobody_plans_for_a_world_that_rests() {
    let mut some = batch(config("slow".into()), 3, 1);
    let mut alone = batch(config("slow".into()), 1, 1);
    some.reset(&[Some(3), Some(4), Some(5)], &[Some(0); 3]).unwrap();
    alone.reset(&[Some(4)], &[Some(0)]).unwrap();
    for t in 0..9 {
        // worlds 0 and 2 go on in the first two steps alone
        some.step_some(&[0.0; 6], &[t < 2, true, t < 2]).unwrap();
        alone.step(&[0.0; 2]).unwrap();
        let plan = |b: &Batch, i: usize| b.world.explain(i, None).unwrap().unwrap().made_at;
        assert_eq!([plan(&some, 0), plan(&some, 1), plan(&some, 2)], [0, t / 4 * 4, 0]);
    }
    assert_eq!(some.obs[some.obs.len() / 3..][..alone.obs.len()], alone.obs);
}

#[test]
fn mixed_traffic_has_its_shares() {
    let shares = [("idm", 0.5), ("slow", 0.3), ("replay", 0.2)];
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut batch = batch(config(mix(&shares)), 1, 1);
    for seed in 0..200 {
        batch.reset(&[Some(seed)], &[Some(0)]).unwrap();
        names(&batch.world, 0).into_iter().skip(1).for_each(|n| *counts.entry(n).or_default() += 1);
    }
    let total: usize = counts.values().sum();
    for (name, share) in shares {
        let got = counts[name] as f32 / total as f32;
        // five standard deviations of a share of 3,800 draws
        assert!((got - share).abs() < 0.041, "{name}: {got}");
    }
}
