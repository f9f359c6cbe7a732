//! The rows of the official tables, and the join of them to the logged facts of each scene.

use crate::budget::name;
use crate::error::{NuscenesError, Result};
use crate::stream::read_table;
use crate::token::{Index, Token, index};
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Tables that are read; a data set must have them all.
pub(crate) const TABLES: [&str; 10] = [
    "scene",
    "log",
    "sample",
    "sample_annotation",
    "instance",
    "category",
    "sample_data",
    "calibrated_sensor",
    "sensor",
    "ego_pose",
];

/// Coordinates beyond this are not on Earth's maps, metres.
const MAX_COORDINATE_M: f64 = 1e6;
/// Longest time between key frames of a scene: what a scene costs is bounded by the size of its tables.
const MAX_INTERVAL_US: u64 = 10_000_000;
/// Farthest that a pose of the ego may be from the time of its key frame.
const MAX_POSE_OFFSET_US: u64 = 250_000;

/// One version of a data set on disk.
#[derive(Debug, Clone)]
pub(crate) struct Tables {
    /// Folder with the tables.
    pub(crate) folder: PathBuf,
}

/// A scene of the scene table with its location.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SceneEntry {
    pub(crate) name: String,
    pub(crate) token: String,
    pub(crate) location: String,
}

/// A pose on the ground plane in the global frame, at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Key {
    /// Index of the key frame in its scene.
    pub(crate) frame: usize,
    pub(crate) timestamp_us: i64,
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    pub(crate) yaw_rad: f64,
}

/// The annotations of one instance in one scene, in time order.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoggedTrack {
    pub(crate) instance: String,
    pub(crate) category: String,
    /// Medians of the annotations' width, length and height, metres, as the table orders them.
    pub(crate) size_m: [f64; 3],
    pub(crate) keys: Vec<Key>,
}

/// What the tables say about one scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct LoggedScene {
    /// Times of the key frames, strictly increasing.
    pub(crate) timestamps_us: Vec<i64>,
    /// Centres of the ego's box at the key frames that have a pose of it, in time order.
    pub(crate) ego: Vec<Key>,
    /// Channel they are of.
    pub(crate) ego_channel: Option<String>,
    /// Instances by first appearance.
    pub(crate) tracks: Vec<LoggedTrack>,
}

/// A row of a table that is a token and a text: `location` of logs, `channel` of sensors, `name` of categories.
#[derive(Deserialize)]
struct NamedRow {
    token: Token,
    #[serde(alias = "location", alias = "channel", deserialize_with = "name")]
    name: String,
}

#[derive(Deserialize)]
struct SceneRow {
    token: String,
    name: String,
    log_token: Token,
}

#[derive(Deserialize)]
struct SampleRow {
    token: Token,
    timestamp: i64,
    scene_token: Token,
}

#[derive(Deserialize)]
struct AnnotationRow {
    token: Token,
    sample_token: Token,
    instance_token: Token,
    translation: [f64; 3],
    size: [f64; 3],
    rotation: [f64; 4],
}

#[derive(Deserialize)]
struct InstanceRow {
    token: String,
    category_token: Token,
}

#[derive(Deserialize)]
struct CalibratedSensorRow {
    token: Token,
    sensor_token: Token,
}

#[derive(Deserialize)]
struct SampleDataRow {
    token: Token,
    sample_token: Token,
    ego_pose_token: Token,
    calibrated_sensor_token: Token,
    is_key_frame: bool,
}

#[derive(Deserialize)]
struct EgoPoseRow {
    token: Token,
    timestamp: i64,
    translation: [f64; 3],
    rotation: [f64; 4],
}

impl Tables {
    pub(crate) fn path(&self, table: &str) -> PathBuf {
        self.folder.join(format!("{table}.json"))
    }

    /// What `keep` makes of the rows of a table, see [`read_table`].
    fn read<Row: DeserializeOwned, Kept: Send>(
        &self,
        table: &str,
        keep: impl Fn(Row) -> Result<Option<Kept>> + Sync,
    ) -> Result<Vec<Kept>> {
        read_table(&self.path(table), &format!("table {table}"), &keep)
    }

    fn index<T>(&self, table: &str, rows: impl IntoIterator<Item = (Token, T)>) -> Result<Index<T>> {
        index(rows).map_err(|token| self.duplicate(table, "token", token))
    }

    /// The texts of a table by token.
    fn names(&self, table: &str) -> Result<Index<String>> {
        self.index(table, self.read(table, |row: NamedRow| Ok(Some((row.token, row.name))))?)
    }

    fn duplicate(&self, table: &str, what: &str, got: impl Display) -> NuscenesError {
        NuscenesError::duplicate(&self.path(table), what, got)
    }

    fn dangling(
        &self,
        (from, field): (&str, &str),
        token: impl Display,
        got: Token,
        table: &str,
    ) -> NuscenesError {
        NuscenesError::dangling(&self.path(from), token, field, got, table)
    }

    /// The scene table, in its order, with the location of each scene.
    pub(crate) fn read_scenes(&self) -> Result<Vec<SceneEntry>> {
        let locations = self.names("log")?;
        let scenes = self.read("scene", |SceneRow { token, name, log_token }| {
            let location = locations
                .get(&log_token)
                .ok_or_else(|| self.dangling(("scene", "log_token"), &token, log_token, "log"))?;
            Ok(Some(SceneEntry { name, token, location: location.clone() }))
        })?;
        for field in [|s: &SceneEntry| s.name.clone(), |s: &SceneEntry| s.token.clone()] {
            let mut values: Vec<String> = scenes.iter().map(field).collect();
            values.sort_unstable();
            if let Some(pair) = values.windows(2).find(|w| w[0] == w[1]) {
                return Err(self.duplicate("scene", "name or token", pair[0].clone()));
            }
        }
        Ok(scenes)
    }

    /// What the tables say about the scenes at these indices of `scenes`, in the order of `wanted`; the centre of the ego's
    /// box is `ego_ahead_m` ahead of its poses.
    pub(crate) fn read_logged(
        &self,
        scenes: &[SceneEntry],
        wanted: &[usize],
        ego_ahead_m: f64,
    ) -> Result<Vec<LoggedScene>> {
        let samples = self.read_samples(scenes, wanted)?;
        let mut logged = vec![LoggedScene::default(); wanted.len()];
        for sample in &samples.list {
            if let Some(slot) = sample.slot {
                logged[slot].timestamps_us.push(sample.timestamp_us);
            }
        }
        let (tracks, egos) = rayon::join(
            || self.read_tracks(&samples),
            || self.read_egos(&samples, wanted.len(), ego_ahead_m),
        );
        for (slot, track) in tracks? {
            logged[slot].tracks.push(track);
        }
        for (scene, (keys, channel)) in logged.iter_mut().zip(egos?) {
            (scene.ego, scene.ego_channel) = (keys, channel);
        }
        Ok(logged)
    }

    fn read_samples(&self, scenes: &[SceneEntry], wanted: &[usize]) -> Result<Samples> {
        let mut slots = vec![None; scenes.len()];
        for (slot, scene) in wanted.iter().enumerate() {
            slots[*scene] = Some(slot);
        }
        let tokens = scenes.iter().map(|s| Token::from(s.token.as_str()));
        let slots = self.index("scene", tokens.zip(slots))?;
        let mut list = self.read("sample", |SampleRow { token, timestamp, scene_token }| {
            let slot = *slots
                .get(&scene_token)
                .ok_or_else(|| self.dangling(("sample", "scene_token"), token, scene_token, "scene"))?;
            Ok(Some(Sample { slot, timestamp_us: timestamp, token, frame: 0 }))
        })?;
        list.par_sort_by_key(|s| (s.slot, s.timestamp_us));
        for i in 1..list.len() {
            let (before, sample) = (list[i - 1], &mut list[i]);
            if sample.slot == before.slot && sample.slot.is_some() {
                sample.frame = before.frame + 1;
                if sample.timestamp_us <= before.timestamp_us {
                    return Err(self.duplicate("sample", "timestamp in one scene", sample.timestamp_us));
                }
                if sample.timestamp_us.abs_diff(before.timestamp_us) > MAX_INTERVAL_US {
                    let expected = "at most 10 s after the key frame before";
                    let (path, got) = (self.path("sample"), sample.timestamp_us);
                    return Err(NuscenesError::value(&path, sample.token, "timestamp", got, expected));
                }
            }
        }
        let by_token = self.index("sample", list.iter().map(|s| s.token).zip(0..))?;
        Ok(Samples { by_token, list })
    }

    /// Tracks, each with the slot of its scene.
    fn read_tracks(&self, samples: &Samples) -> Result<Vec<(usize, LoggedTrack)>> {
        const TABLE: &str = "sample_annotation";
        let path = self.path(TABLE);
        let rows = self.read(TABLE, |row: AnnotationRow| {
            let (token, of) = (row.token, row.sample_token);
            let found = samples.by_token.get(&of);
            let place = *found.ok_or_else(|| self.dangling((TABLE, "sample_token"), token, of, "sample"))?;
            let sample = &samples.list[place];
            let Some(slot) = sample.slot else { return Ok(None) };
            let pose = (row.translation, row.rotation);
            let key = ground_pose(&path, token, sample, sample.timestamp_us, pose, 0.0)?;
            Ok(Some(Annotation { slot, instance: row.instance_token, key, token, size_m: row.size }))
        })?;
        self.index(TABLE, rows.iter().map(|row| (row.token, ())))?;
        let instances = self.read_instances(&rows)?;
        let track =
            |group: Vec<u32>| Ok((rows[group[0] as usize].slot, self.track(&rows, &group, &instances)?));
        group(&rows).into_iter().map(track).collect()
    }

    /// Id and category of the instances that are annotated.
    fn read_instances(&self, rows: &[Annotation]) -> Result<Index<(String, String)>> {
        let categories = self.names("category")?;
        let runs = rows.chunk_by(|a, b| a.instance == b.instance);
        let mut used: Vec<Token> = runs.map(|run| run[0].instance).collect();
        used.par_sort_unstable();
        used.dedup();
        let rows = self.read("instance", |InstanceRow { token: text, category_token }| {
            let token = Token::from(text.as_str());
            if used.binary_search(&token).is_err() {
                return Ok(None);
            }
            let category = categories.get(&category_token).ok_or_else(|| {
                self.dangling(("instance", "category_token"), &text, category_token, "category")
            })?;
            Ok(Some((token, (text, category.clone()))))
        })?;
        self.index("instance", rows)
    }

    /// The track of a group of annotations.
    fn track(
        &self,
        rows: &[Annotation],
        group: &[u32],
        instances: &Index<(String, String)>,
    ) -> Result<LoggedTrack> {
        const TABLE: &str = "sample_annotation";
        let first = &rows[group[0] as usize];
        let (instance, category) = instances.get(&first.instance).cloned().ok_or_else(|| {
            self.dangling((TABLE, "instance_token"), first.token, first.instance, "instance")
        })?;
        for row in group.iter().map(|i| &rows[*i as usize]) {
            let [width, length, height] = row.size_m;
            if !(width > 0.0 && length > 0.0 && height >= 0.0 && width.max(length).max(height) < 1e4) {
                let (got, expected) = (format!("{:?}", row.size_m), "a positive width and length in metres");
                return Err(NuscenesError::value(&self.path(TABLE), row.token, "size", got, expected));
            }
        }
        let keys: Vec<Key> = group.iter().map(|i| rows[*i as usize].key).collect();
        if let Some(pair) = keys.windows(2).find(|w| w[0].frame == w[1].frame) {
            let got = format!("{} in frame {}", instance, pair[0].frame);
            return Err(self.duplicate(TABLE, "annotation of instance", got));
        }
        let is_constant = group.iter().all(|i| rows[*i as usize].size_m == first.size_m);
        let size_m = if is_constant { first.size_m } else { [0, 1, 2].map(|side| median(rows, group, side)) };
        Ok(LoggedTrack { instance, category, size_m, keys })
    }

    /// For each scene the centres of the ego at key frames, and the channel they are of.
    fn read_egos(
        &self,
        samples: &Samples,
        num_scenes: usize,
        ahead_m: f64,
    ) -> Result<Vec<(Vec<Key>, Option<String>)>> {
        let (channels, rows) = self.read_key_frame_data(samples)?;
        let chosen = choose_channels(&rows, samples, num_scenes);
        let mut wanted: Vec<(Token, u32)> = rows
            .iter()
            .filter(|r| samples.list[r.sample as usize].slot.and_then(|s| chosen[s]) == Some(r.channel))
            .map(|r| (r.ego_pose, r.sample))
            .collect();
        // several records of one pose: it is that of the first key frame
        wanted.par_sort_unstable();
        wanted.dedup_by_key(|(token, _)| *token);
        let places: Index<usize> =
            self.index("sample_data", wanted.iter().map(|(token, _)| *token).zip(0..))?;
        let path = self.path("ego_pose");
        let poses = self.read("ego_pose", |EgoPoseRow { token, timestamp, translation, rotation }| {
            let Some(&place) = places.get(&token) else { return Ok(None) };
            let sample = &samples.list[wanted[place].1 as usize];
            if timestamp.abs_diff(sample.timestamp_us) > MAX_POSE_OFFSET_US {
                let expected = "within 0.25 s of its sample's";
                return Err(NuscenesError::value(&path, token, "timestamp", timestamp, expected));
            }
            let key = ground_pose(&path, token, sample, timestamp, (translation, rotation), ahead_m)?;
            Ok(Some((place, sample.slot, key)))
        })?;
        let mut egos: Vec<Vec<Key>> = vec![Vec::new(); num_scenes];
        let mut found = vec![false; wanted.len()];
        for (place, slot, key) in poses {
            if std::mem::replace(&mut found[place], true) {
                return Err(self.duplicate("ego_pose", "token", wanted[place].0));
            }
            if let Some(slot) = slot {
                egos[slot].push(key);
            }
        }
        if let Some(place) = found.iter().position(|found| !found) {
            let (token, sample) = wanted[place];
            let of = format!("of sample {}", samples.list[sample as usize].token);
            return Err(self.dangling(("sample_data", "ego_pose_token"), of, token, "ego_pose"));
        }
        for keys in &mut egos {
            keys.sort_by_key(|k| k.frame);
            if let Some(pair) = keys.windows(2).find(|w| w[0].timestamp_us >= w[1].timestamp_us) {
                let (what, got) = ("key frame or its time, in one scene,", pair[1].timestamp_us);
                return Err(self.duplicate("ego_pose", what, got));
            }
        }
        let channels = chosen.iter().map(|channel| channel.map(|c| channels[c as usize].clone()));
        Ok(egos.into_iter().zip(channels).collect())
    }

    /// Channel names, most wanted first, and the key-frame sample_data of the wanted scenes.
    fn read_key_frame_data(&self, samples: &Samples) -> Result<(Vec<String>, Vec<KeyFrameData>)> {
        let sensors = self.names("sensor")?;
        let rank = |channel: &str| match channel {
            "LIDAR_TOP" => 0,
            "CAM_FRONT" => 1,
            _ => 2,
        };
        let order = |a: &String, b: &String| (rank(a), a).cmp(&(rank(b), b));
        let mut channels: Vec<String> = sensors.values().cloned().collect();
        channels.sort_by(order);
        channels.dedup();
        let calibrated =
            self.read("calibrated_sensor", |CalibratedSensorRow { token, sensor_token: of }| {
                let channel = sensors.get(&of).ok_or_else(|| {
                    self.dangling(("calibrated_sensor", "sensor_token"), token, of, "sensor")
                })?;
                let place = channels.binary_search_by(|c| order(c, channel));
                Ok(Some((token, place.unwrap_or_default() as u32)))
            })?;
        let calibrated = self.index("calibrated_sensor", calibrated)?;
        const TABLE: &str = "sample_data";
        let rows = self.read(TABLE, |row: SampleDataRow| {
            if !row.is_key_frame {
                return Ok(None);
            }
            let (token, of, sensor) = (row.token, row.sample_token, row.calibrated_sensor_token);
            let found = samples.by_token.get(&of);
            let sample = *found.ok_or_else(|| self.dangling((TABLE, "sample_token"), token, of, "sample"))?;
            if samples.list[sample].slot.is_none() {
                return Ok(None);
            }
            let channel = *calibrated.get(&sensor).ok_or_else(|| {
                self.dangling((TABLE, "calibrated_sensor_token"), token, sensor, "calibrated_sensor")
            })?;
            Ok(Some(KeyFrameData { sample: sample as u32, channel, ego_pose: row.ego_pose_token }))
        })?;
        Ok((channels, rows))
    }
}

/// A key frame.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// Position of its scene among the wanted ones; `None` for other scenes.
    slot: Option<usize>,
    timestamp_us: i64,
    token: Token,
    /// Index in its scene.
    frame: usize,
}

/// All key frames, in the order of scene and time.
struct Samples {
    list: Vec<Sample>,
    /// Places in the list.
    by_token: Index<usize>,
}

struct KeyFrameData {
    sample: u32,
    channel: u32,
    ego_pose: Token,
}

struct Annotation {
    slot: usize,
    instance: Token,
    key: Key,
    token: Token,
    size_m: [f64; 3],
}

/// Places of the annotations of each scene and instance in time order, instances by first appearance (then by place in
/// the file).
fn group(rows: &[Annotation]) -> Vec<Vec<u32>> {
    // official tables list an instance in one run, in time order
    let same = |a: &Annotation, b: &Annotation| (a.slot, a.instance) == (b.slot, b.instance);
    let mut first = 0;
    let mut runs: Vec<(usize, Token, Range<u32>)> = Vec::new();
    for run in rows.chunk_by(same) {
        let end = first + run.len() as u32;
        runs.push((run[0].slot, run[0].instance, first..end));
        first = end;
    }
    runs.par_sort_unstable_by_key(|(slot, instance, places)| (*slot, *instance, places.start));
    let key = |place: &u32| (rows[*place as usize].key.frame, *place);
    let mut groups: Vec<Vec<u32>> = runs
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .map(|runs| {
            let mut places: Vec<u32> = runs.iter().flat_map(|(_, _, places)| places.clone()).collect();
            if !places.is_sorted_by_key(key) {
                places.sort_unstable_by_key(key);
            }
            places
        })
        .collect();
    groups.sort_unstable_by_key(|places| (rows[places[0] as usize].slot, key(&places[0])));
    groups
}

/// Median of one side of the boxes of a group.
fn median(rows: &[Annotation], group: &[u32], side: usize) -> f64 {
    let mut sides: Vec<f64> = group.iter().map(|i| rows[*i as usize].size_m[side]).collect();
    sides.sort_unstable_by(f64::total_cmp);
    0.5 * (sides[(sides.len() - 1) / 2] + sides[sides.len() / 2])
}

/// For each scene the channel that covers the most key frames; among equals the most wanted.
fn choose_channels(rows: &[KeyFrameData], samples: &Samples, num_scenes: usize) -> Vec<Option<u32>> {
    let slot = |row: &KeyFrameData| samples.list[row.sample as usize].slot;
    let mut found: Vec<(usize, u32)> = rows.iter().filter_map(|r| Some((slot(r)?, r.channel))).collect();
    found.par_sort_unstable();
    let mut chosen = vec![None; num_scenes];
    let mut most = vec![0; num_scenes];
    for run in found.chunk_by(|a, b| a == b) {
        let (slot, channel) = run[0];
        if run.len() > most[slot] {
            (most[slot], chosen[slot]) = (run.len(), Some(channel));
        }
    }
    chosen
}

/// Position and yaw of the point `ahead_m` along the x axis of a pose in three dimensions, checked. Yaw is the direction of
/// the rotated x axis, as the devkit's `quaternion_yaw`.
fn ground_pose(
    path: &Path,
    token: Token,
    sample: &Sample,
    timestamp_us: i64,
    (translation, rotation): ([f64; 3], [f64; 4]),
    ahead_m: f64,
) -> Result<Key> {
    let fail = |field, got: &[f64], expected| {
        Err(NuscenesError::value(path, token, field, format!("{got:?}"), expected))
    };
    let [x_m, y_m, _] = translation;
    if !(x_m.abs() < MAX_COORDINATE_M && y_m.abs() < MAX_COORDINATE_M) {
        return fail("translation", &translation, "finite metres within 1000 km");
    }
    let [w, x, y, z] = rotation;
    let norm_sq = w * w + x * x + y * y + z * z;
    if !(1e-12..1e12).contains(&norm_sq) {
        return fail("rotation", &rotation, "a quaternion w, x, y, z that is not zero");
    }
    let axis = [w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z)];
    let [x_m, y_m] = [x_m + ahead_m * (axis[0] / norm_sq), y_m + ahead_m * (axis[1] / norm_sq)];
    Ok(Key { frame: sample.frame, timestamp_us, x_m, y_m, yaw_rad: axis[1].atan2(axis[0]) })
}
