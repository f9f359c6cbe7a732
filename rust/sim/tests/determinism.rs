//! Same seed, same bits: whatever the threads, the batch, the snapshot or the run.

mod common;

use ccdiff_sim::world::{Autoreset, Controlled, WorldConfig};
use common::{Batch, actions, city};

fn config(traffic: &str) -> WorldConfig {
    WorldConfig {
        traffic: traffic.into(),
        horizon_steps: 40,
        autoreset: Autoreset::SameStep,
        ..WorldConfig::default()
    }
}

/// Which worlds go on in a step, as if drawn.
fn some(step: usize, envs: usize) -> Vec<bool> {
    actions(step + 1000, envs).iter().map(|x| *x > 0.0).collect()
}

#[test]
fn worlds_that_rest_stay_as_they_are_and_the_others_play_as_alone() {
    const ENVS: usize = 9;
    let scenes = || vec![city(12), city(30), city(8)];
    let run = |threads: usize| {
        let mut all = Batch::new(scenes(), config("idm"), ENVS, threads);
        all.reset_all(100);
        let (row, width) = (all.world.layout().size, all.columns.len() / ENVS);
        let mut alone: Vec<Batch> = (0..ENVS).map(|_| Batch::new(scenes(), config("idm"), 1, 1)).collect();
        for (seed, one) in (100..).zip(&mut alone) {
            one.reset(&[Some(seed)], &[None]).unwrap();
        }
        let mut bits = Vec::new();
        for t in 0..90 {
            let (a, active) = (actions(t, 2 * ENVS), some(t, ENVS));
            let before: Vec<_> = (0..ENVS).map(|i| all.world.snapshot(i).unwrap()).collect();
            all.step_some(&a, &active).unwrap();
            for (i, one) in alone.iter_mut().enumerate() {
                if active[i] {
                    one.step(&a[2 * i..2 * i + 2]).unwrap();
                    assert_eq!(one.columns, all.columns[i * width..(i + 1) * width], "world {i} step {t}");
                    assert_eq!((one.done[0], one.was_reset[0]), (all.done[i], all.was_reset[i]));
                    assert_eq!(one.reward[0].to_bits(), all.reward[i].to_bits());
                } else {
                    assert!(before[i] == all.world.snapshot(i).unwrap(), "world {i} step {t}");
                    assert!(!all.done[i] && !all.was_reset[i] && !all.terminated[i] && !all.truncated[i]);
                    assert_eq!(all.reward[i], 0.0);
                    assert!(all.columns[i * width..(i + 1) * width].iter().all(|x| *x == 0.0));
                }
                assert_eq!(one.obs, all.obs[i * row..(i + 1) * row], "world {i} step {t}");
                assert_eq!(one.alive[0], all.alive[i]);
                let clock = |b: &Batch, i: usize| b.world.status(i).map(|s| (s.episode, s.step_idx)).unwrap();
                assert_eq!(clock(one, 0), clock(&all, i));
            }
            bits.extend(all.bits());
        }
        bits
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}

#[test]
fn joint_and_single_contact_detection_agree() {
    // with one slot contacts are looked for agent by agent, with many among all at once
    let single = WorldConfig { autoreset: Autoreset::Disabled, ..config("replay") };
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
