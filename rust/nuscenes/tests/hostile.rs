//! Damaged data sets: each gives a typed error that names file, record, field and value; nothing panics, and nothing takes
//! much memory: the tests have 300 MB, and end where more is asked for.

#![allow(clippy::unwrap_used, reason = "a set-up that fails fails the test")]

mod common;

use ccdiff_nuscenes::{LoadOptions, NuscenesError, load};
use common::{DataSet, NUM_KEY_FRAMES, VERSION, damage, load_from, token};
use proptest::prelude::*;
use serde_json::{Value, json};

#[global_allocator]
static ALLOCATOR: cap::Cap<std::alloc::System> = cap::Cap::new(std::alloc::System, 300_000_000);

fn error_of(data: &DataSet) -> NuscenesError {
    data.load().unwrap_err()
}

/// The error after one field of one record is replaced.
fn error_with(table: &'static str, row: usize, field: &str, value: Value) -> String {
    let mut data = DataSet::new();
    data.tables.get_mut(table).unwrap()[row][field] = value;
    error_of(&data).to_string()
}

fn assert_names(message: &str, words: &[&str]) {
    for word in words {
        assert!(message.contains(word), "{word:?} is not in: {message}");
    }
}

#[test]
fn a_missing_table_is_named() {
    for table in DataSet::new().tables.into_keys() {
        let folder = DataSet::new().written();
        std::fs::remove_file(folder.0.join(VERSION).join(format!("{table}.json"))).unwrap();
        let error = load_from(&folder).unwrap_err();
        assert!(matches!(error, NuscenesError::Missing { .. }), "{error}");
        assert_names(&error.to_string(), &[table, ".json"]);
    }
    let folder = DataSet::new().written();
    let error = load(&folder.0, "v9", &LoadOptions::default()).unwrap_err();
    assert_names(&error.to_string(), &["version", "v9"]);
}

#[test]
fn times_that_are_far_apart_are_refused() {
    let start_us = 1_531_883_530_000_000_i64;
    let last = DataSet::new().tables["sample"].len() - 1;
    let message = error_with("sample", last, "timestamp", json!(start_us + 40_000_000));
    assert_names(&message, &["sample.json", "timestamp", "at most 10 s"]);
    for offset_us in [-300_000, 300_000, i64::MAX - start_us] {
        let message = error_with("ego_pose", 0, "timestamp", json!(start_us + offset_us));
        assert_names(&message, &["ego_pose.json", "timestamp", "within 0.25 s"]);
    }
}

#[test]
fn truncated_tables_are_refused() {
    for table in DataSet::new().tables.into_keys() {
        let folder = DataSet::new().written();
        let path = folder.0.join(VERSION).join(format!("{table}.json"));
        let bytes = std::fs::read(&path).unwrap();
        for cut in [0, 1, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let error = load_from(&folder).unwrap_err();
            assert!(matches!(error, NuscenesError::Json { .. }), "{table} {cut}: {error}");
            assert_names(&error.to_string(), &[table, "byte"]);
        }
    }
}

#[test]
fn numbers_that_are_not_finite_are_refused_by_field() {
    let folder = DataSet::new().written();
    for (table, field) in
        [("sample_annotation", "translation"), ("ego_pose", "translation"), ("ego_pose", "rotation")]
    {
        let path = folder.0.join(VERSION).join(format!("{table}.json"));
        let text = std::fs::read_to_string(&path).unwrap();
        let at = text.find(&format!("\"{field}\":[")).unwrap() + field.len() + 4;
        let end = at + text[at..].find(',').unwrap();
        for bad in ["NaN", "Infinity", "-Infinity", "1e999", "null", "\"1\""] {
            std::fs::write(&path, format!("{}{bad}{}", &text[..at], &text[end..])).unwrap();
            let message = load_from(&folder).unwrap_err().to_string();
            assert_names(&message, &[table, field]);
        }
        std::fs::write(&path, text).unwrap();
    }
    let message = error_with("sample_annotation", 0, "translation", json!([1e300, 0, 0]));
    assert_names(&message, &["sample_annotation.json", "translation", "1e300", "finite"]);
    let message = error_with("sample_annotation", 0, "rotation", json!([0, 0, 0, 0]));
    assert_names(&message, &["sample_annotation.json", "rotation", "[0.0, 0.0, 0.0, 0.0]"]);
}

#[test]
fn sizes_must_be_positive() {
    for size in [json!([0.0, 4.5, 1.6]), json!([1.9, -4.5, 1.6]), json!([1.9, 1e30, 1.6])] {
        let message = error_with("sample_annotation", 0, "size", size);
        assert_names(&message, &["sample_annotation.json", "size", "positive"]);
    }
}

#[test]
fn dangling_tokens_name_both_tables() {
    let lost = token("nobody", 7);
    for (table, field, target) in [
        ("scene", "log_token", "log"),
        ("sample", "scene_token", "scene"),
        ("sample_annotation", "sample_token", "sample"),
        ("sample_annotation", "instance_token", "instance"),
        ("instance", "category_token", "category"),
        ("sample_data", "sample_token", "sample"),
        ("sample_data", "ego_pose_token", "ego_pose"),
        ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
        ("calibrated_sensor", "sensor_token", "sensor"),
    ] {
        let message = error_with(table, 0, field, json!(lost));
        assert_names(&message, &[&format!("{table}.json"), field, &lost, &format!("table {target}")]);
    }
}

#[test]
fn duplicates_are_refused() {
    for table in DataSet::new().tables.into_keys() {
        let mut data = DataSet::new();
        let rows = data.tables.get_mut(table).unwrap();
        rows.push(rows[0].clone());
        if table == "sample_data" {
            // two equal rows lead to one and the same ego pose
            data.load().unwrap();
            continue;
        }
        let error = error_of(&data);
        assert!(error.to_string().contains("is there twice"), "{table}: {error}");
    }
    let mut data = DataSet::new();
    let rows = data.tables.get_mut("sample_annotation").unwrap();
    let mut twin = rows[0].clone();
    twin["token"] = json!(token("twin", 0));
    rows.push(twin);
    assert_names(&error_of(&data).to_string(), &["annotation of instance", "frame 0", "twice"]);
    let time = DataSet::new().tables["sample"][1]["timestamp"].clone();
    assert_names(&error_with("sample", 0, "timestamp", time), &["timestamp", "sample.json", "twice"]);
}

#[test]
fn fields_that_are_missing_or_of_another_type_are_named() {
    let mut data = DataSet::new();
    data.tables.get_mut("sample_annotation").unwrap()[3].as_object_mut().unwrap().remove("rotation");
    assert_names(&error_of(&data).to_string(), &["sample_annotation.json", "rotation", "missing"]);
    assert_names(&error_with("sample", 0, "token", json!(5)), &["sample.json", "token"]);
    assert_names(&error_with("sample", 0, "timestamp", json!("now")), &["sample.json", "timestamp"]);
}

#[test]
fn a_location_cannot_lead_out_of_the_data_set() {
    for location in ["../secret", "/etc/passwd", "a\\b"] {
        assert_names(&error_with("log", 0, "location", json!(location)), &["log.json", "location"]);
    }
}

#[test]
fn damaged_maps_are_refused() {
    type Change = fn(&mut Value);
    let cases: [(Change, &[&str]); 8] = [
        (|m| m["polygon"][0]["exterior_node_tokens"][1] = json!("gone"), &["node_tokens", "table node"]),
        (|m| m["lane"][0]["polygon_token"] = json!("gone"), &["polygon_token", "table polygon"]),
        (|m| m["road_divider"][0]["line_token"] = json!("gone"), &["line_token", "table line"]),
        (|m| m["arcline_path_3"]["a"][0]["radius"] = json!(0), &["\"a\"", "radius", "positive"]),
        (|m| m["arcline_path_3"]["a"][0]["shape"] = json!("LXL"), &["\"a\"", "shape", "LXL"]),
        (|m| m["node"][0]["x"] = json!(1e30), &["node x, y", "1e30"]),
        (|m| m["lane_connector"][0]["token"] = json!("a"), &["lane token", "twice"]),
        (|m| *m = json!([]), &["byte"]),
    ];
    for (change, words) in cases {
        let mut data = DataSet::new();
        change(&mut data.map);
        assert_names(&error_of(&data).to_string(), &[&["town.json"], words].concat());
    }
}

/// So many straight paths of 99 km, one behind the other.
fn far_lane(count: usize) -> Value {
    let path =
        json!({"start_pose": [90, 200, 0], "shape": "SSS", "radius": 9, "segment_length": [99e3, 0, 0]});
    json!(vec![path; count])
}

/// Adds a copy of the first record of a table with other fields.
fn add(data: &mut DataSet, table: &'static str, fields: Value) {
    let rows = data.tables.get_mut(table).unwrap();
    let mut row = rows[0].clone();
    row.as_object_mut().unwrap().extend(fields.as_object().unwrap().clone());
    rows.push(row);
}

#[test]
fn maps_of_kilobytes_that_make_gigabytes_are_refused() {
    let rows = |row: Value| json!(vec![row; 4_000]);
    for (layer, records) in [
        ("arcline_path_3", json!({"a": far_lane(4_000)})),
        ("walkway", rows(json!({"token": "w", "polygon_token": "wide"}))),
        ("lane", rows(json!({"token": "a", "polygon_token": "wide"}))),
        ("drivable_area", json!([{"token": "d", "polygon_tokens": vec!["wide"; 4_000]}])),
        ("lane_divider", rows(json!({"token": "r", "line_token": "long"}))),
    ] {
        let mut data = DataSet::new();
        let tokens: Vec<String> = (0..3_000).map(|i| format!("n{i}")).collect();
        let nodes = tokens.iter().enumerate().map(|(i, token)| json!({"token": token, "x": i % 7, "y": i}));
        data.map["node"].as_array_mut().unwrap().extend(nodes);
        let hole = json!([{"node_tokens": tokens}]);
        let polygon = json!({"token": "wide", "exterior_node_tokens": tokens[..99], "holes": hole});
        data.map["polygon"].as_array_mut().unwrap().push(polygon);
        data.map["line"].as_array_mut().unwrap().push(json!({"token": "long", "node_tokens": tokens}));
        data.map[layer] = records;
        assert_names(&error_of(&data).to_string(), &["town.json", "more than 5000000 points"]);
    }
}

#[test]
fn many_scenes_of_a_large_map_are_refused() {
    let mut data = DataSet::new();
    for i in 0..100 {
        let (scene, sample) = (format!("s{i}"), format!("k{i}"));
        add(&mut data, "scene", json!({"token": scene, "name": scene}));
        add(&mut data, "sample", json!({"token": sample, "scene_token": scene}));
        add(&mut data, "sample_data", json!({"sample_token": sample, "ego_pose_token": sample}));
        add(&mut data, "ego_pose", json!({"token": sample}));
    }
    assert_eq!(data.load().unwrap().scenes.len(), 102);
    data.map["arcline_path_3"]["a"] = far_lane(1);
    assert_names(&error_of(&data).to_string(), &["maps/expansion", "too many points"]);
}

#[test]
fn tables_of_few_records_and_very_many_states_are_refused() {
    let mut data = DataSet::new();
    let last = data.tables["sample"][NUM_KEY_FRAMES - 1].clone();
    for i in 1..2_000 {
        let instance = json!(format!("i{i}"));
        let timestamp = last["timestamp"].as_i64().unwrap() + 10_000_000 * i;
        add(&mut data, "sample", json!({"token": format!("k{i}"), "timestamp": timestamp}));
        add(&mut data, "instance", json!({"token": instance}));
        for of in [&last["token"], &json!("k1")] {
            let fields = json!({"token": format!("{i}{of}"), "sample_token": of, "instance_token": instance});
            add(&mut data, "sample_annotation", fields);
        }
    }
    assert_names(&error_of(&data).to_string(), &["sample_annotation.json", "states of agents"]);
}

#[test]
fn scenes_and_channels_that_nobody_uses_cost_their_records() {
    let mut data = DataSet::new();
    for (i, channel) in ["Z", "Zz"].into_iter().enumerate() {
        data.tables.get_mut("sensor").unwrap()[i]["channel"] = json!(channel);
    }
    for i in 0..66_000 {
        add(&mut data, "sensor", json!({"token": format!("q{i}"), "channel": format!("A{i:06}")}));
    }
    for i in 0..6_000 {
        add(&mut data, "scene", json!({"token": format!("x{i}"), "name": format!("y{i}")}));
    }
    let report = data.load().unwrap().report;
    assert_eq!((report.scenes.len(), report.empty.len()), (2, 6_000));
    assert_eq!(report.scenes[0].ego_channel.as_deref(), Some("Z"));
}

#[test]
fn texts_that_many_records_repeat_are_short() {
    for (table, field) in [("category", "name"), ("log", "location"), ("sensor", "channel")] {
        let message = error_with(table, 0, field, json!("x".repeat(1_000_000)));
        assert_names(&message, &[&format!("{table}.json"), field, "a text of 1000000 bytes"]);
    }
}

#[test]
fn the_waymo_scene_that_is_damaged_is_sound() {
    let folder = DataSet::new().written();
    let path = folder.0.join("waymo.json");
    std::fs::write(&path, damage::gpudrive_scene()).unwrap();
    let scene = &ccdiff_nuscenes::load_gpudrive(&[path], None).unwrap().scenes[0];
    assert_eq!((scene.agents.len(), scene.map.lanes.len()), (2, 2));
    assert_eq!(scene.map.lanes[0].successors, [1]);
    assert!(scene.map.has_road());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Whatever bytes are changed, copied, inserted or cut in whatever file: an error or scenes, never a panic.
    #[test]
    fn damaged_files_never_panic(input in prop::collection::vec(any::<u8>(), 5..25)) {
        damage::load_damaged(&input);
    }

    #[test]
    fn damaged_waymo_scenes_never_panic(input in prop::collection::vec(any::<u8>(), 4..25)) {
        damage::load_damaged_gpudrive(&input);
    }

    #[test]
    fn damaged_scenes_never_panic(input in prop::collection::vec(any::<u8>(), 4..25)) {
        damage::decode_damaged(&input);
    }

    #[test]
    fn damaged_snapshots_never_panic(input in prop::collection::vec(any::<u8>(), 4..25)) {
        damage::restore_damaged(&input);
    }
}
