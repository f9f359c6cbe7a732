//! A tiny data set in the official schema, made in memory and written to a folder of its own.
#![allow(dead_code, clippy::unwrap_used, reason = "each user takes its own part; a test fails by panicking")]

pub(crate) mod damage;
#[path = "../../../sim/tests/common/mod.rs"]
mod world;

use ccdiff_nuscenes::{LoadOptions, Loaded, Result, load};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

pub(crate) const VERSION: &str = "v1.0-tiny";
pub(crate) const NUM_KEY_FRAMES: usize = 6;

/// A folder that is removed at the end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static COUNTER: AtomicUsize = AtomicUsize::new(0);
        let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("ccdiff-nuscenes-{}-{unique}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Tables by name and the map of location `town`, ready to be changed before they are written.
#[derive(Clone)]
pub(crate) struct DataSet {
    pub(crate) tables: BTreeMap<&'static str, Vec<Value>>,
    pub(crate) map: Value,
}

fn quaternion(yaw: f64) -> Value {
    json!([(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()])
}

/// Token of 32 digits for a kind of record and a number.
pub(crate) fn token(kind: &str, number: usize) -> String {
    let kind = kind.bytes().fold(0_u64, |h, b| h.wrapping_mul(31).wrapping_add(u64::from(b)));
    format!("{kind:016x}{number:016x}")
}

fn annotation(scene: usize, frame: usize, instance: usize, x: f64, y: f64) -> Value {
    let number = (scene * 100 + frame) * 1000 + instance;
    json!({
        "token": token("annotation", number),
        "sample_token": token("sample", scene * 100 + frame),
        "instance_token": token("instance", scene * 1000 + instance),
        "visibility_token": "4", "attribute_tokens": [], "num_lidar_pts": 1, "num_radar_pts": 0,
        "translation": [x, y, 0.5], "size": [1.9, 4.5, 1.6], "rotation": quaternion(0.25),
        "prev": "", "next": "",
    })
}

/// Categories of the instances of scene 0, in the order of their numbers.
pub(crate) const CATEGORIES: [&str; 6] = [
    "vehicle.car",
    "human.pedestrian.adult",
    "movable_object.barrier",
    "animal",
    "spaceship",
    "vehicle.bicycle",
];

impl DataSet {
    /// Scene 0 in `town`, with a map, six instances and a gap; scene 1 in `nowhere`, with one car and no map.
    pub(crate) fn new() -> Self {
        let mut tables: BTreeMap<&'static str, Vec<Value>> = BTreeMap::new();
        let mut add = |table, row| tables.entry(table).or_default().push(row);
        add("sensor", json!({"token": "s1", "channel": "CAM_FRONT", "modality": "camera"}));
        add("sensor", json!({"token": "s0", "channel": "LIDAR_TOP", "modality": "lidar"}));
        add("calibrated_sensor", json!({"token": "c0", "sensor_token": "s0", "translation": [0, 0, 0]}));
        add("calibrated_sensor", json!({"token": "c1", "sensor_token": "s1", "translation": [0, 0, 0]}));
        for (i, name) in CATEGORIES.iter().enumerate() {
            add("category", json!({"token": token("category", i), "name": name, "description": "{]\"[}"}));
        }
        for (scene, location) in ["town", "nowhere"].into_iter().enumerate() {
            add("log", json!({"token": token("log", scene), "location": location, "logfile": ""}));
            add(
                "scene",
                json!({
                    "token": token("scene", scene), "name": format!("scene-000{scene}"), "description": "",
                    "log_token": token("log", scene), "nbr_samples": NUM_KEY_FRAMES,
                    "first_sample_token": token("sample", scene * 100), "last_sample_token": "",
                }),
            );
            for frame in 0..NUM_KEY_FRAMES {
                let number = scene * 100 + frame;
                let timestamp = 1_531_883_530_000_000_i64 + 500_000 * frame as i64;
                add(
                    "sample",
                    json!({
                        "token": token("sample", number), "timestamp": timestamp,
                        "scene_token": token("scene", scene), "prev": "", "next": "",
                    }),
                );
                for (channel, key) in [(0, true), (0, false), (1, true)] {
                    let pose = token(&format!("pose{channel}{key}"), number);
                    add(
                        "sample_data",
                        json!({
                            "token": pose, "sample_token": token("sample", number), "ego_pose_token": pose,
                            "calibrated_sensor_token": format!("c{channel}"), "timestamp": timestamp,
                            "is_key_frame": key, "fileformat": "pcd", "filename": "", "prev": "", "next": "",
                        }),
                    );
                    add(
                        "ego_pose",
                        json!({
                            "token": pose, "timestamp": timestamp, "rotation": quaternion(0.0),
                            "translation": [100.25 + 5.0 * frame as f64 + f64::from(channel), 200.0, 0.0],
                        }),
                    );
                }
            }
        }
        for (i, _) in CATEGORIES.iter().enumerate() {
            add("instance", json!({"token": token("instance", i), "category_token": token("category", i)}));
        }
        add("instance", json!({"token": token("instance", 1000), "category_token": token("category", 0)}));
        for frame in 0..NUM_KEY_FRAMES {
            let x = 110.0 + 2.0 * frame as f64;
            if frame != 3 {
                add("sample_annotation", annotation(0, frame, 0, x, 204.0));
            }
            for instance in 2..CATEGORIES.len() {
                add(
                    "sample_annotation",
                    annotation(0, frame, instance, 120.0, 200.0 + 3.0 * instance as f64),
                );
            }
            add("sample_annotation", annotation(1, frame, 0, x, 204.0));
        }
        add("sample_annotation", annotation(0, 2, 1, 105.0, 190.0));
        Self { tables, map: map() }
    }

    /// Writes everything.
    pub(crate) fn write(&self, root: &Path) {
        let folder = root.join(VERSION);
        std::fs::create_dir_all(&folder).unwrap();
        for (name, rows) in &self.tables {
            std::fs::write(folder.join(format!("{name}.json")), json!(rows).to_string()).unwrap();
        }
        let maps = root.join("maps").join("expansion");
        std::fs::create_dir_all(&maps).unwrap();
        std::fs::write(maps.join("town.json"), self.map.to_string()).unwrap();
    }

    /// Loads everything with the default options.
    pub(crate) fn load(&self) -> Result<Loaded> {
        load_from(&self.written())
    }

    /// Writes everything to a new folder.
    pub(crate) fn written(&self) -> Folder {
        let folder = Folder::new();
        self.write(&folder.0);
        folder
    }
}

/// Loads the data set of a folder with the default options.
pub(crate) fn load_from(folder: &Folder) -> Result<Loaded> {
    load(&folder.0, VERSION, &LoadOptions::default())
}

/// A square with a hole, two lanes in a row, a line.
fn map() -> Value {
    let corners =
        [(0., 0.), (1000., 0.), (1000., 1000.), (0., 1000.), (115., 195.), (125., 195.), (125., 198.)];
    let nodes: Vec<Value> = corners
        .iter()
        .enumerate()
        .map(|(i, (x, y))| json!({"token": token("node", i), "x": x, "y": y}))
        .collect();
    let ring = |range: std::ops::Range<usize>| range.map(|i| token("node", i)).collect::<Vec<_>>();
    let path = |x: f64| {
        json!([{"start_pose": [x, 200.0, 0.0], "end_pose": [0, 0, 0], "shape": "LSR", "radius": 900.0,
            "segment_length": [0.0, 30.0, 0.0]}])
    };
    json!({
        "version": "1.3",
        "node": nodes,
        "polygon": [
            {"token": "p0", "exterior_node_tokens": ring(0..4), "holes": [{"node_tokens": ring(4..7)}]},
            {"token": "p1", "exterior_node_tokens": ring(4..7), "holes": []},
        ],
        "line": [{"token": "l0", "node_tokens": ring(0..3)}],
        "drivable_area": [{"token": "d0", "polygon_tokens": ["p0"]}],
        "lane": [{"token": "a", "polygon_token": "p0", "lane_type": "CAR"}],
        "lane_connector": [{"token": "b"}],
        "walkway": [{"token": "w0", "polygon_token": "p1"}],
        "ped_crossing": [], "stop_line": [], "carpark_area": [],
        "road_divider": [{"token": "r0", "line_token": "l0"}],
        "lane_divider": [],
        "arcline_path_3": {"a": path(90.0), "b": path(120.0)},
        "connectivity": {"a": {"incoming": [], "outgoing": ["b"]}, "b": {"incoming": ["gone"], "outgoing": []}},
    })
}
