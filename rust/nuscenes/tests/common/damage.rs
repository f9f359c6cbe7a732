//! Files with damage that a few bytes describe; driven by `hostile.rs` and by the fuzz targets in `rust/fuzz`.

use super::world::Batch;
use super::{DataSet, VERSION};
use ccdiff_nuscenes::{LoadOptions, decode_scene, encode_scene, load};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::{Controlled, SceneOrder, TrafficCollision, WorldConfig};
use std::sync::{Arc, OnceLock};

/// Edits bytes as the input says, four bytes an edit: what to do, with which byte, and where (two bytes).
fn edit(bytes: &mut Vec<u8>, input: &[u8]) {
    for [what, byte, place @ ..] in input.as_chunks::<4>().0 {
        if bytes.is_empty() {
            return;
        }
        let at = (usize::from(u16::from_le_bytes(*place)) * bytes.len()) >> 16;
        match what % 6 {
            0 => bytes[at] = *byte,
            // a digit for a digit keeps the JSON whole and changes what it says
            1 if bytes[at].is_ascii_digit() => bytes[at] = b'0' + byte % 10,
            1 => {}
            2 => drop(bytes.drain(at..(at + usize::from(*byte)).min(bytes.len()))),
            3 => bytes.truncate(at),
            4 => {
                let copied = bytes[at..(at + usize::from(*byte)).min(bytes.len())].to_vec();
                bytes.splice(at..at, copied);
            }
            _ => bytes.insert(at, *byte),
        }
    }
}

/// Loads the tiny data set with one file damaged: the first byte says which, the others how.
pub(crate) fn load_damaged(input: &[u8]) {
    let Some((file, edits)) = input.split_first() else { return };
    let data = DataSet::new();
    let folder = data.written();
    let tables: Vec<_> =
        data.tables.keys().map(|table| folder.0.join(VERSION).join(format!("{table}.json"))).collect();
    let map = folder.0.join("maps/expansion/town.json");
    let path = tables.iter().chain([&map, &map]).nth(usize::from(*file) % (tables.len() + 2)).unwrap();
    let mut bytes = std::fs::read(path).unwrap();
    edit(&mut bytes, edits);
    std::fs::write(path, bytes).unwrap();
    if let Ok(loaded) = load(&folder.0, VERSION, &LoadOptions::default()) {
        for scene in loaded.scenes {
            scene.as_ref().clone().validated().unwrap();
        }
    }
}

/// Decodes a scene of the tiny data set from damaged bytes.
pub(crate) fn decode_damaged(input: &[u8]) {
    static SCENE: OnceLock<Vec<u8>> = OnceLock::new();
    let mut bytes = SCENE
        .get_or_init(|| {
            let folder = DataSet::new().written();
            let loaded = load(&folder.0, VERSION, &LoadOptions::default()).unwrap();
            encode_scene(&loaded.scenes[0]).unwrap()
        })
        .clone();
    edit(&mut bytes, input);
    if let Ok(scene) = decode_scene(&bytes) {
        play(Arc::new(scene.validated().unwrap()));
    }
}

/// Restores a world of the tiny data set from damaged bytes, plays on, and begins anew.
pub(crate) fn restore_damaged(input: &[u8]) {
    static SCENES: OnceLock<Vec<Arc<Scene>>> = OnceLock::new();
    let scenes = SCENES.get_or_init(|| {
        let folder = DataSet::new().written();
        load(&folder.0, VERSION, &LoadOptions::default()).unwrap().scenes
    });
    let config = WorldConfig {
        history_steps: 2,
        controlled: Controlled::Vehicles,
        num_slots: 4,
        traffic: "idm".into(),
        scene_order: SceneOrder::Sequential,
        on_traffic_collision: TrafficCollision::Stop,
        ..WorldConfig::default()
    };
    let mut batch = Batch::of(scenes.clone(), config, 1, 1, Vec::new()).unwrap();
    batch.reset_all(0);
    let step = |batch: &mut Batch| {
        batch.step(&[0.5, 0.1].repeat(4)).unwrap();
        let reals = batch.obs.iter().chain(&batch.columns).chain(&batch.reward);
        assert!(reals.into_iter().all(|x| x.is_finite()));
    };
    step(&mut batch);
    let mut bytes = batch.world.snapshot(0).unwrap();
    edit(&mut bytes, input);
    if batch.world.restore(0, &bytes).is_ok() {
        for _ in 0..3 {
            if batch.step(&[0.5, 0.1].repeat(4)).is_err() {
                break;
            }
        }
        assert!(batch.world.metrics(0).unwrap().iter().flatten().all(|x| x.is_finite()));
        batch.reset(&[None], &[None]).unwrap();
        step(&mut batch);
    }
}

/// Steps a world of a scene that holds: whatever a world derives from it fits into memory and stays finite.
fn play(scene: Arc<Scene>) {
    let config = WorldConfig {
        dt_s: scene.dt_s,
        history_steps: 2,
        controlled: Controlled::Vehicles,
        num_slots: 4,
        traffic: "idm".into(),
        ..WorldConfig::default()
    };
    let Ok(mut batch) = Batch::of(vec![scene], config, 1, 1, Vec::new()) else { return };
    batch.reset_all(0);
    for _ in 0..3 {
        batch.step(&[0.5, 0.1].repeat(4)).unwrap();
        assert!(batch.obs.iter().chain(&batch.columns).all(|x| x.is_finite()));
    }
}
