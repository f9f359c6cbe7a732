//! Loads of a tiny data set: what is kept, what is reported, what the cache does.

#![allow(clippy::unwrap_used, reason = "a set-up that fails fails the test")]

mod common;

use ccdiff_nuscenes::{BuildOptions, Interpolation, KeyFrameTiming, LoadOptions, NuscenesError, load};
use ccdiff_sim::scene::AgentKind;
use common::{DataSet, Folder, VERSION, load_from};
use proptest::prelude::*;
use serde_json::json;

#[test]
fn agents_come_ego_first_then_by_first_appearance_and_nothing_is_lost_silently() {
    let loaded = DataSet::new().load().unwrap();
    let scene = &loaded.scenes[0];
    assert_eq!((scene.num_steps, scene.dt_s), (26, 0.1));
    let kinds: Vec<AgentKind> = scene.agents.iter().map(|a| a.kind).collect();
    use AgentKind::{Cyclist, Pedestrian, Static, Vehicle};
    assert_eq!(kinds, [Vehicle, Vehicle, Static, Pedestrian, Cyclist]);
    assert_eq!((scene.agents[0].id.as_str(), scene.origin), ("ego", [102.0, 200.0]));
    assert_eq!((scene.agents[1].length_m, scene.agents[1].width_m), (4.5, 1.9));
    // the ego drives at 10 m/s, the car at 4 m/s with one key frame missing
    assert!((scene.tracks.velocity[scene.at(0, 13)].x - 10.0).abs() < 1e-4);
    assert!((scene.tracks.velocity[scene.at(1, 15)].x - 4.0).abs() < 1e-4);
    // its pose at 100.25 is the middle of the rear axle
    assert!((scene.tracks.position[scene.at(0, 0)].x + scene.origin[0] as f32 - 101.635).abs() < 1e-5);
    let report = &loaded.report.scenes[0];
    assert_eq!(report.filled_gaps, 1);
    assert_eq!(report.ego_channel.as_deref(), Some("LIDAR_TOP"));
    let dropped = ["human.pedestrian.adult: fewer than 2 annotations", "spaceship: unknown category"];
    assert!(report.dropped.keys().eq(dropped) && report.dropped.values().all(|tracks| *tracks == 1));
    assert_eq!(loaded.report.missing_maps, ["nowhere"]);
    assert!(loaded.scenes[1].map.lanes.is_empty());
    assert_eq!(loaded.report.map_notes.len(), 2, "{:?}", loaded.report.map_notes);
}

#[test]
fn the_map_is_cropped_round_the_tracks_and_keeps_holes_and_links() {
    let loaded = DataSet::new().load().unwrap();
    let map = &loaded.scenes[0].map;
    // tracks span x 101.635..126.635 and y 200..215, the margin is 60
    let area = &map.drivable_area[0];
    let (min, max) = area.bounds().unwrap();
    assert!((min.x - -60.365).abs() < 1e-3 && (max.x - 84.635).abs() < 1e-3, "{min} {max}");
    assert!((min.y - -60.0).abs() < 1e-3 && (max.y - 75.0).abs() < 1e-3, "{min} {max}");
    assert_eq!(area.holes.len(), 1);
    assert_eq!(
        (map.lanes[0].successors.as_slice(), map.lanes[1].predecessors.as_slice()),
        (&[1][..], &[0][..])
    );
    assert_eq!(map.lanes[0].centreline.len(), 31);
    assert!(map.road_dividers.is_empty(), "the divider is far away");
}

#[test]
fn options_select_kinds_and_step_lengths() {
    let folder = DataSet::new().written();
    let with = |build: BuildOptions| {
        load(&folder.0, VERSION, &LoadOptions { build, ..LoadOptions::default() })
            .map(|l| l.scenes[0].clone())
    };
    let vehicles = BuildOptions { kinds: Some(vec![AgentKind::Vehicle]), ..BuildOptions::default() };
    assert_eq!(with(vehicles).unwrap().num_agents(), 2);
    let scene = with(BuildOptions { dt_s: 0.05, ..BuildOptions::default() }).unwrap();
    assert_eq!((scene.num_agents(), scene.num_steps), (5, 51));
    for dt_s in [0.3, 0.0, -0.1, f64::NAN, 0.7] {
        let error = with(BuildOptions { dt_s, ..BuildOptions::default() }).unwrap_err();
        assert!(matches!(error, NuscenesError::Option { field: "dt", .. }), "{dt_s}: {error}");
    }
}

#[test]
fn the_channel_that_covers_most_key_frames_carries_the_ego() {
    let mut data = DataSet::new();
    let lidar = |row: &serde_json::Value| row["calibrated_sensor_token"] == "c0";
    let rows = data.tables.get_mut("sample_data").unwrap();
    let first = rows.iter().position(|r| lidar(r) && r["is_key_frame"] == true).unwrap();
    rows.remove(first);
    let report = data.load().unwrap().report;
    assert_eq!(report.scenes[0].ego_channel.as_deref(), Some("CAM_FRONT"));
    assert_eq!(report.scenes[1].ego_channel.as_deref(), Some("LIDAR_TOP"));
    data.tables.insert("sample_data", vec![]);
    let loaded = data.load().unwrap();
    assert_eq!(loaded.report.scenes[0].ego_channel, None);
    assert_ne!(loaded.scenes[0].agents[0].id, "ego");
}

#[test]
fn a_scene_without_agents_is_left_out_and_named() {
    let mut data = DataSet::new();
    data.tables.insert("sample_data", vec![]);
    data.tables
        .get_mut("sample_annotation")
        .unwrap()
        .retain(|a| a["instance_token"] != common::token("instance", 1000));
    let loaded = data.load().unwrap();
    assert_eq!((loaded.scenes.len(), loaded.report.empty.as_slice()), (1, &["scene-0001".to_owned()][..]));
}

fn cached(cache: &Folder) -> LoadOptions {
    LoadOptions { cache_directory: Some(cache.0.clone()), ..LoadOptions::default() }
}

fn files(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

#[test]
fn the_cache_gives_the_same_scenes_and_report_without_reading_a_table() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let options = cached(&cache);
    let plain = load_from(&folder).unwrap();
    let first = load(&folder.0, VERSION, &options).unwrap();
    let second = load(&folder.0, VERSION, &options).unwrap();
    assert_eq!((first.report.cache.built, first.report.cache.hits), (2, 0));
    assert_eq!((second.report.cache.built, second.report.cache.hits), (0, 2));
    assert_eq!(plain.scenes, first.scenes);
    assert_eq!(plain.scenes, second.scenes);
    assert_eq!(plain.report.scenes, second.report.scenes);
    assert_eq!(first.report.missing_maps, second.report.missing_maps);
}

#[test]
fn another_option_or_another_content_is_another_entry() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let options = cached(&cache);
    load(&folder.0, VERSION, &options).unwrap();
    let linear = BuildOptions { interpolation: Interpolation::Linear, ..BuildOptions::default() };
    let other = load(&folder.0, VERSION, &LoadOptions { build: linear, ..options.clone() }).unwrap();
    assert_eq!(other.report.cache.built, 2);
    let mut data = DataSet::new();
    data.tables.get_mut("sample_annotation").unwrap()[0]["translation"] = json!([111.25, 204.0, 0.0]);
    data.write(&folder.0);
    let changed = load(&folder.0, VERSION, &options).unwrap();
    assert_eq!(changed.report.cache.built, 2);
    assert_eq!(changed.scenes, load_from(&folder).unwrap().scenes);
    // a new map rebuilds the scenes of its location only
    data.map["walkway"] = json!([]);
    std::fs::write(folder.0.join("maps/expansion/town.json"), data.map.to_string()).unwrap();
    let remapped = load(&folder.0, VERSION, &options).unwrap();
    assert_eq!((remapped.report.cache.built, remapped.report.cache.hits), (1, 1));
}

#[test]
fn uniform_motion_at_irregular_times_is_uniform() {
    let mut data = DataSet::new();
    let start_us = 1_531_883_530_000_000_i64;
    let times_us = [0, 400_000, 1_000_000, 1_500_123, 1_950_000, 2_549_000];
    let frame_of =
        |row: &serde_json::Value| ((row["timestamp"].as_i64().unwrap() - start_us) / 500_000) as usize;
    for table in ["sample", "ego_pose"] {
        for row in data.tables.get_mut(table).unwrap() {
            let time_us = times_us[frame_of(row)];
            row["timestamp"] = json!(start_us + time_us);
            if table == "ego_pose" {
                row["translation"] = json!([100.25 + 8.0 * time_us as f64 * 1e-6, 200.0, 0.0]);
            }
        }
    }
    let folder = data.written();
    let with = |build| {
        load(&folder.0, VERSION, &LoadOptions { build, ..LoadOptions::default() })
            .unwrap()
            .scenes
            .swap_remove(0)
    };
    for interpolation in [Interpolation::Smooth, Interpolation::Linear] {
        let build = BuildOptions { interpolation, ..BuildOptions::default() };
        let scene = with(build.clone());
        assert_eq!(scene.num_steps, 26);
        for step in 0..scene.num_steps {
            let x_m = scene.tracks.position[step].x;
            assert!((x_m + 0.365 - 0.8 * step as f32).abs() < 1e-4, "step {step}: {x_m}");
            assert!((scene.tracks.velocity[step].x - 8.0).abs() < 1e-4);
        }
        let scene = with(BuildOptions { timing: KeyFrameTiming::Nominal, ..build });
        // what lasted 0.4 s is played in half a second
        assert_eq!(scene.num_steps, 26);
        assert!((scene.tracks.position[5].x + 0.365 - 3.2).abs() < 1e-4);
    }
}

#[test]
fn damaged_or_deleted_cache_files_are_built_again() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let options = cached(&cache);
    let scenes = load(&folder.0, VERSION, &options).unwrap().scenes;
    for damage in 0..4 {
        for path in files(&cache.0) {
            let mut bytes = std::fs::read(&path).unwrap();
            match damage {
                0 => bytes.truncate(bytes.len() / 2),
                1 => bytes.iter_mut().skip(30).step_by(7).for_each(|b| *b ^= 0x55),
                2 => bytes.clear(),
                _ => {}
            }
            std::fs::write(&path, bytes).unwrap();
            if damage == 3 {
                std::fs::remove_file(&path).unwrap();
            }
        }
        let again = load(&folder.0, VERSION, &options).unwrap();
        assert_eq!(again.scenes, scenes);
        assert_eq!(again.report.cache.built, 2);
        assert_eq!(again.report.cache.notes.is_empty(), damage == 3, "{:?}", again.report.cache.notes);
    }
    assert_eq!(load(&folder.0, VERSION, &options).unwrap().report.cache.hits, 2);
}

#[test]
fn cache_files_are_not_believed_under_another_name() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let options = cached(&cache);
    let scenes = load(&folder.0, VERSION, &options).unwrap().scenes;
    let kept: Vec<_> =
        files(&cache.0).into_iter().filter(|p| p.parent().unwrap().ends_with("scene")).collect();
    assert_eq!(kept.len(), 2);
    std::fs::copy(&kept[0], &kept[1]).unwrap();
    let again = load(&folder.0, VERSION, &options).unwrap();
    assert_eq!(again.scenes, scenes);
    assert_eq!((again.report.cache.built, again.report.cache.hits), (1, 1));
    assert!(again.report.cache.notes[0].contains("damaged"), "{:?}", again.report.cache.notes);
}

#[test]
fn concurrent_loads_share_a_cache() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let options = cached(&cache);
    let expected = load_from(&folder).unwrap().scenes;
    std::thread::scope(|scope| {
        let handles: Vec<_> =
            (0..8).map(|_| scope.spawn(|| load(&folder.0, VERSION, &options).unwrap())).collect();
        for handle in handles {
            assert_eq!(handle.join().unwrap().scenes, expected);
        }
    });
    assert!(files(&cache.0).iter().all(|p| p.extension().is_none()), "no half-written files are left");
}

#[test]
fn a_cache_that_cannot_be_written_is_noted() {
    let (folder, cache) = (DataSet::new().written(), Folder::new());
    let blocked = cache.0.join("file");
    std::fs::write(&blocked, "").unwrap();
    let options = LoadOptions { cache_directory: Some(blocked), ..LoadOptions::default() };
    let loaded = load(&folder.0, VERSION, &options).unwrap();
    assert_eq!(loaded.scenes.len(), 2);
    assert!(!loaded.report.cache.notes.is_empty());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn order_of_records_does_not_matter_but_for_ties(seed in any::<u64>()) {
        let mut data = DataSet::new();
        let mut state = seed | 1;
        for (table, rows) in &mut data.tables {
            // ties of first appearance are broken by the place in the file, scenes keep their order
            if matches!(*table, "sample_annotation" | "scene") {
                continue;
            }
            for i in (1..rows.len()).rev() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                rows.swap(i, (state >> 33) as usize % (i + 1));
            }
        }
        prop_assert_eq!(data.load().unwrap().scenes, DataSet::new().load().unwrap().scenes);
    }
}
