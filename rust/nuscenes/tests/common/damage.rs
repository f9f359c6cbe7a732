//! Files with damage that a few bytes describe; driven by `hostile.rs` and by the fuzz targets in `rust/fuzz`.

use super::world::Batch;
use super::{DataSet, VERSION, load_from};
use ccdiff_nuscenes::{decode_scene, encode_scene, load_gpudrive};
use ccdiff_sim::scene::Scene;
use ccdiff_sim::world::{Controlled, SceneOrder, TrafficCollision, VecWorld, WorldConfig};
use serde_json::json;
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
    if let Ok(loaded) = load_from(&folder) {
        for scene in loaded.scenes {
            scene.as_ref().clone().validated().unwrap();
        }
    }
}

/// Loads a tiny scene of GPUDrive's JSON from damaged bytes.
pub(crate) fn load_damaged_gpudrive(input: &[u8]) {
    let folder = DataSet::new().written();
    let path = folder.0.join("waymo.json");
    let mut bytes = gpudrive_scene().into_bytes();
    edit(&mut bytes, input);
    std::fs::write(&path, bytes).unwrap();
    if let Ok(loaded) = load_gpudrive(&[path], None) {
        play(Arc::clone(&loaded.scenes[0]));
    }
}

/// Two vehicles for two seconds on a straight road of two lanes with edges, a driveway and a crosswalk.
pub(crate) fn gpudrive_scene() -> String {
    let object = |id: u32, y: f64| {
        let steps = (0..20).map(f64::from);
        let position: Vec<_> = steps.map(|i| json!({"x": 100.0 + i * 0.7, "y": y, "z": 0.0})).collect();
        json!({
            "id": id, "type": "vehicle", "length": 4.5, "width": 2.0, "height": 1.5, "position": position,
            "heading": vec![0.0; 20], "velocity": vec![json!({"x": 7.0, "y": 0.0}); 20], "valid": vec![true; 20],
        })
    };
    let road = |kind: &str, element: u32, points: &[(f64, f64)]| {
        let geometry: Vec<_> = points.iter().map(|(x, y)| json!({"x": x, "y": y, "z": 0.0})).collect();
        json!({"type": kind, "map_element_id": element, "id": element, "geometry": geometry})
    };
    json!({
        "name": "file", "scenario_id": "s", "tl_states": {}, "metadata": {"sdc_track_index": 1},
        "objects": [object(1, 3.5), object(2, 0.0)],
        "roads": [
            road("lane", 2, &[(90.0, 0.0), (120.0, 0.0)]),
            road("lane", 2, &[(120.0, 0.0), (150.0, 0.0)]),
            road("road_edge", 15, &[(90.0, -2.0), (150.0, -2.0)]),
            road("road_edge", 15, &[(150.0, 6.0), (90.0, 6.0)]),
            road("driveway", 20, &[(100.0, 5.0), (104.0, 5.0), (104.0, 9.0), (100.0, 9.0)]),
            road("crosswalk", 18, &[(110.0, -2.0), (112.0, -2.0), (112.0, 6.0)]),
        ],
    })
    .to_string()
}

/// The scenes of the tiny data set.
fn scenes() -> &'static Vec<Arc<Scene>> {
    static SCENES: OnceLock<Vec<Arc<Scene>>> = OnceLock::new();
    SCENES.get_or_init(|| DataSet::new().load().unwrap().scenes)
}

/// Worlds of four controlled vehicles in IDM traffic.
fn in_idm() -> WorldConfig {
    WorldConfig {
        history_steps: 2,
        controlled: Controlled::Vehicles,
        num_slots: 4,
        traffic: "idm".into(),
        ..WorldConfig::default()
    }
}

/// Decodes a scene of the tiny data set from damaged bytes.
pub(crate) fn decode_damaged(input: &[u8]) {
    let mut bytes = encode_scene(&scenes()[0]).unwrap();
    edit(&mut bytes, input);
    if let Ok(scene) = decode_scene(&bytes) {
        play(Arc::new(scene.validated().unwrap()));
    }
}

/// Restores a world of the tiny data set from damaged bytes, plays on, and restarts.
pub(crate) fn restore_damaged(input: &[u8]) {
    let config = WorldConfig {
        scene_order: SceneOrder::Sequential,
        on_traffic_collision: TrafficCollision::Stop,
        ..in_idm()
    };
    let mut batch = Batch::new(scenes().clone(), config, 1, 1);
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
        assert!(batch.world.status(0).unwrap().slots.iter().flat_map(|s| s.metrics()).all(|x| x.is_finite()));
        batch.reset(&[None], &[None]).unwrap();
        step(&mut batch);
    }
}

/// Steps a world of a scene that holds: whatever a world derives from it fits into memory and stays finite.
fn play(scene: Arc<Scene>) {
    let config = WorldConfig { dt_s: scene.dt_s, ..in_idm() };
    let Ok(world) = VecWorld::new(vec![scene], config, 1, 1, Vec::new()) else { return };
    let mut batch = Batch::around(world);
    batch.reset_all(0);
    for _ in 0..3 {
        batch.step(&[0.5, 0.1].repeat(4)).unwrap();
        assert!(batch.obs.iter().chain(&batch.columns).all(|x| x.is_finite()));
    }
}
