//! How episodes begin, go on and end.

mod common;

use ccdiff_sim::SimError;
use ccdiff_sim::scene::synthetic::GridCity;
use ccdiff_sim::world::{Autoreset, Col, Consequence, Controlled, SceneOrder, WorldConfig};
use common::{Batch, actions, city};
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
fn every_agent_of_a_game_ends_for_itself() {
    let config = WorldConfig { controlled: Controlled::Vehicles, num_slots: 6, horizon_steps: 60, ..base() };
    let mut batch = Batch::new(vec![city(4)], config, 1, 1);
    batch.reset_all(0);
    assert_eq!(batch.alive, [true, true, true, true, false, false]);
    let mut ended = [0usize; 6];
    for t in 0..60 {
        // agent 1 leaves the road, the others go straight on
        let mut a = vec![0.0; 12];
        a[3] = 0.5;
        batch.step(&a).unwrap();
        for c in 0..6 {
            ended[c] += usize::from(batch.terminated[c] || batch.truncated[c]);
            if !(batch.alive[c] || batch.terminated[c] || batch.truncated[c]) {
                assert_eq!(batch.reward[c], 0.0);
                let row = batch.world.layout().size;
                assert!(batch.obs[c * row..(c + 1) * row].iter().all(|x| *x == 0.0), "slot {c} step {t}");
            }
        }
        if batch.done[0] {
            break;
        }
    }
    assert!(batch.done[0]);
    assert_eq!(ended, [1, 1, 1, 1, 0, 0]);
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
fn late_agents_enter_when_their_place_is_free() {
    let mut scene = GridCity { num_agents: 2, num_roads: 1, ..GridCity::default() }.scene();
    // agent 1 exists from step 60 on, exactly where the ego will stand
    let t_len = scene.num_steps;
    let ego_at_start = scene.tracks.position[30];
    for t in 0..t_len {
        scene.tracks.valid[t_len + t] = t >= 60;
        scene.tracks.position[t_len + t] = ego_at_start;
    }
    let config = WorldConfig { on_collision: Consequence::Ignore, ..base() };
    let mut batch = Batch::new(vec![Arc::new(scene.validated().unwrap())], config, 1, 1);
    batch.reset_all(0);
    for t in 31..=75 {
        // brake hard, stay, then drive off
        batch.step(&[if t < 70 { -1.0 } else { 1.0 }, 0.0]).unwrap();
        assert_eq!(batch.columns[Col::Collision as usize], 0.0);
    }
    assert!(!batch.world.status(0).unwrap().states.active[1], "its place is taken");
    for _ in 0..20 {
        batch.step(&[1.0, 0.0]).unwrap();
    }
    assert!(batch.world.status(0).unwrap().states.active[1], "its place is free");
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

#[test]
fn joint_and_single_contact_detection_agree() {
    // with one slot contacts are looked for agent by agent, with many among all at once
    let single = WorldConfig { traffic: "replay".into(), horizon_steps: 40, ..base() };
    let joint = WorldConfig {
        controlled: Controlled::Vehicles,
        num_slots: 12,
        driver: "replay".into(),
        ..single.clone()
    };
    let single = WorldConfig { driver: "replay".into(), ..single };
    let mut one = Batch::new(vec![city(24)], single, 1, 1);
    let mut many = Batch::new(vec![city(24)], joint, 1, 1);
    one.reset_all(0);
    many.reset_all(0);
    for t in 0..39 {
        one.step(&actions(t, 2)).unwrap();
        many.step(&actions(t, 24)).unwrap();
        assert_eq!(one.columns[..], many.columns[..one.columns.len()], "step {t}");
        if one.done[0] {
            break;
        }
    }
}
