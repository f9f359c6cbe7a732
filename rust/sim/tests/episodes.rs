//! How episodes begin, go on and end.

mod common;

use ccdiff_sim::SimError;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{Autoreset, Col, Consequence, Controlled, SceneOrder, WorldConfig};
use common::{Batch, city};
use std::sync::Arc;

fn base() -> WorldConfig {
    WorldConfig { autoreset: Autoreset::Disabled, ..WorldConfig::default() }
}

#[test]
fn swerving_off_the_road_ends_ignores_stops_or_removes_as_configured() {
    for (consequence, ends) in [
        (Consequence::Terminate, true),
        (Consequence::Remove, true),
        (Consequence::Stop, false),
        (Consequence::Ignore, false),
    ] {
        let config = WorldConfig { on_off_road: consequence, ..base() };
        let mut batch = Batch::new(vec![city(1)], config, 1, 1);
        batch.reset_all(0);
        let mut off = false;
        for _ in 0..60 {
            batch.step(&[0.0, -0.4]).unwrap();
            off |= batch.columns[Col::OffRoad as usize] > 0.0;
            if batch.done[0] || (off && consequence == Consequence::Stop) {
                break;
            }
        }
        assert!(off, "{consequence:?}");
        assert_eq!(batch.terminated[0], ends, "{consequence:?}");
        let active = batch.world.status(0).unwrap().states.active[0];
        assert_eq!(active, consequence != Consequence::Remove);
        if consequence == Consequence::Stop {
            batch.step(&[1.0, 0.0]).unwrap();
            assert_eq!(batch.columns[Col::Speed as usize], 0.0);
        }
    }
}

#[test]
fn slots_can_be_chosen_for_each_scene_by_its_name() {
    let scene = |name: &str| {
        let mut scene = city(4).as_ref().clone();
        scene.name = name.into();
        Arc::new(scene)
    };
    let id = |i: usize| city(4).agents[i].id.clone();
    let chosen = [("a".to_string(), vec![id(2), id(0)]), ("b".to_string(), vec![id(3)])];
    let config = WorldConfig {
        controlled: Controlled::PerScene(chosen.into_iter().collect()),
        num_slots: 2,
        scene_order: SceneOrder::Sequential,
        ..base()
    };
    let batch = |scenes| {
        let mut batch = Batch::new(scenes, config.clone(), 2, 1);
        batch.reset_all(0);
        batch
    };
    let both = batch(vec![scene("a"), scene("b")]);
    assert_eq!(both.world.status(0).unwrap().slot_agents(), [Some(2), Some(0)]);
    assert_eq!(both.world.status(1).unwrap().slot_agents(), [Some(3), None]);
    let unknown = ccdiff_sim::world::VecWorld::new(vec![scene("c")], config.clone(), 1, 1, Vec::new());
    assert!(matches!(unknown, Err(SimError::Scene { .. })));
}

#[test]
fn idm_traffic_never_runs_into_its_leader() {
    // a dense single file: everybody brakes behind a parked first car
    let mut scene = GridCity { num_agents: 40, num_roads: 1, gap_m: 14.0, ..GridCity::default() }.scene();
    scene.name = "queue".into();
    let config = WorldConfig {
        traffic: "idm".into(),
        driver: "idm".into(),
        controlled: Controlled::Vehicles,
        num_slots: 4,
        on_collision: Consequence::Ignore,
        terminate_at_goal: false,
        ..base()
    };
    let mut batch = Batch::new(vec![Arc::new(scene.validated().unwrap())], config, 1, 1);
    batch.reset_all(0);
    let mut worst = 0;
    for _ in 0..100 {
        batch.step(&[0.0; 8]).unwrap();
        let lead = batch.world.status(0).unwrap().contacts();
        let rear_end = lead.iter().filter(|(a, b)| {
            let s = batch.world.status(0).unwrap().states;
            let (i, j) = (b.partner as usize, a.partner as usize);
            s.cos[i] * s.cos[j] + s.sin[i] * s.sin[j] > 0.9
        });
        worst = worst.max(rear_end.count());
        if batch.done[0] {
            break;
        }
    }
    assert_eq!(worst, 0, "cars of one lane touch");
}

#[test]
fn starts_are_spread_over_the_log_by_the_seed_and_stand_where_the_log_stands() {
    let config = WorldConfig { start_spread_steps: 40, driver: "replay".into(), ..base() };
    let mut batch = Batch::new(vec![city(3)], config.clone(), 1, 1);
    let mut starts = Vec::new();
    for seed in 0..60 {
        batch.reset_all(seed);
        let first = batch.world.status(0).unwrap().step_idx;
        assert_eq!(batch.columns[Col::LogDistance as usize], 0.0);
        starts.push(first);
        batch.reset_all(seed);
        assert_eq!(batch.world.status(0).unwrap().step_idx, first, "seed {seed}");
    }
    let (least, most) = (starts.iter().min().unwrap(), starts.iter().max().unwrap());
    assert!(*least >= config.history_steps && *most <= config.history_steps + 40, "{least} {most}");
    assert!(most - least > 30, "{least} {most}");

    let mut fixed = Batch::new(vec![city(3)], base(), 1, 1);
    fixed.reset_all(5);
    assert_eq!(fixed.world.status(0).unwrap().step_idx, base().history_steps);
}
