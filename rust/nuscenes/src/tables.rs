//! The rows of the official tables, and the join of them to the logged facts of each scene.

use crate::error::{NuscenesError, Result};
use crate::stream::read_table;
use crate::token::Token;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
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
    pub(crate) nbr_samples: Option<usize>,
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
    /// Width, length, height of the first annotation, metres, as the table orders them.
    pub(crate) size_m: [f64; 3],
    pub(crate) keys: Vec<Key>,
}

/// What the tables say about one scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct LoggedScene {
    /// Times of the key frames, strictly increasing.
    pub(crate) timestamps_us: Vec<i64>,
    /// Ego poses of the key frames that have one, in time order.
    pub(crate) ego: Vec<Key>,
    /// Channel they are of.
    pub(crate) ego_channel: Option<String>,
    /// Instances by first appearance.
    pub(crate) tracks: Vec<LoggedTrack>,
}

/// Finds the value of a token in a sorted list.
fn find<T>(list: &[(Token, T)], token: Token) -> Option<&T> {
    list.binary_search_by_key(&token, |(t, _)| *t).ok().map(|i| &list[i].1)
}

impl Tables {
    pub(crate) fn path(&self, table: &str) -> PathBuf {
        self.folder.join(format!("{table}.json"))
    }

    fn read<Row, Kept, F>(&self, table: &str, keep: F) -> Result<Vec<Kept>>
    where
        Row: for<'a> Deserialize<'a>,
        Kept: Send,
        F: Fn(&Path, Row) -> Result<Option<Kept>> + Sync,
    {
        let path = self.path(table);
        read_table(&path, &format!("table {table}"), |row| keep(&path, row))
    }

    /// Reads a whole small table as a sorted list by token.
    fn read_by_token<Row, T, F>(&self, table: &str, split: F) -> Result<Vec<(Token, T)>>
    where
        Row: for<'a> Deserialize<'a>,
        T: Send,
        F: Fn(Row) -> (Token, T) + Sync,
    {
        let rows = self.read(table, |_, row| Ok(Some(split(row))))?;
        self.sorted(table, rows)
    }

    fn sorted<T: Send>(&self, table: &str, mut rows: Vec<(Token, T)>) -> Result<Vec<(Token, T)>> {
        rows.par_sort_unstable_by_key(|(token, _)| *token);
        match rows.windows(2).find(|w| w[0].0 == w[1].0) {
            Some(pair) => Err(self.duplicate(table, "token", pair[0].0.to_string())),
            None => Ok(rows),
        }
    }

    fn duplicate(&self, table: &str, what: &'static str, got: String) -> NuscenesError {
        NuscenesError::Duplicate { path: self.path(table), what, got }
    }

    fn dangling(
        &self,
        (from, field): (&str, &'static str),
        token: impl ToString,
        got: Token,
        table: &'static str,
    ) -> NuscenesError {
        let (token, got) = (token.to_string(), got.to_string());
        NuscenesError::Dangling { path: self.path(from), token, field, got, table }
    }

    /// The scene table, in its order, with the location of each scene.
    pub(crate) fn read_scenes(&self) -> Result<Vec<SceneEntry>> {
        #[derive(Deserialize)]
        struct LogRow {
            token: Token,
            location: String,
        }
        #[derive(Deserialize)]
        struct SceneRow {
            token: String,
            name: String,
            log_token: Token,
            nbr_samples: Option<usize>,
        }
        let locations = self.read_by_token("log", |row: LogRow| (row.token, row.location))?;
        let scenes = self.read("scene", |_, row: SceneRow| {
            let location = find(&locations, row.log_token)
                .ok_or_else(|| self.dangling(("scene", "log_token"), &row.token, row.log_token, "log"))?;
            Ok(Some(SceneEntry {
                name: row.name,
                token: row.token,
                location: location.clone(),
                nbr_samples: row.nbr_samples,
            }))
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

    /// What the tables say about the scenes at these indices of `scenes`, in the order of `wanted`.
    pub(crate) fn read_logged(&self, scenes: &[SceneEntry], wanted: &[usize]) -> Result<Vec<LoggedScene>> {
        let samples = self.read_samples(scenes, wanted)?;
        let mut logged = vec![LoggedScene::default(); wanted.len()];
        for sample in &samples.list {
            if let Some(slot) = sample.slot {
                logged[slot].timestamps_us.push(sample.timestamp_us);
            }
        }
        self.add_tracks(&samples, &mut logged)?;
        self.add_ego(&samples, &mut logged)?;
        Ok(logged)
    }

    fn read_samples(&self, scenes: &[SceneEntry], wanted: &[usize]) -> Result<Samples> {
        #[derive(Deserialize)]
        struct SampleRow {
            token: Token,
            timestamp: i64,
            scene_token: Token,
        }
        let mut slots: Vec<(Token, Option<usize>)> = scenes
            .iter()
            .enumerate()
            .map(|(i, s)| (Token::from_text(&s.token), wanted.iter().position(|w| *w == i)))
            .collect();
        slots.sort_unstable();
        let mut list = self.read("sample", |_, row: SampleRow| {
            let slot = *find(&slots, row.scene_token).ok_or_else(|| {
                self.dangling(("sample", "scene_token"), row.token, row.scene_token, "scene")
            })?;
            Ok(Some(Sample { slot, timestamp_us: row.timestamp, token: row.token, frame: 0 }))
        })?;
        list.par_sort_by_key(|s| (s.slot, s.timestamp_us));
        for i in 1..list.len() {
            let (before, sample) = (list[i - 1], &mut list[i]);
            if sample.slot == before.slot && sample.slot.is_some() {
                sample.frame = before.frame + 1;
                if sample.timestamp_us <= before.timestamp_us {
                    let got = sample.timestamp_us.to_string();
                    return Err(self.duplicate("sample", "timestamp in one scene", got));
                }
            }
        }
        let tokens = list.iter().enumerate().map(|(i, s)| (s.token, i as u32)).collect();
        Ok(Samples { by_token: self.sorted("sample", tokens)?, list })
    }

    fn add_tracks(&self, samples: &Samples, logged: &mut [LoggedScene]) -> Result<()> {
        #[derive(Deserialize)]
        struct AnnotationRow {
            token: Token,
            sample_token: Token,
            instance_token: Token,
            translation: [f64; 3],
            size: [f64; 3],
            rotation: [f64; 4],
        }
        const TABLE: &str = "sample_annotation";
        let rows = self.read(TABLE, |path, row: AnnotationRow| {
            let sample = samples.find(row.sample_token).ok_or_else(|| {
                self.dangling((TABLE, "sample_token"), row.token, row.sample_token, "sample")
            })?;
            let Some(slot) = sample.slot else { return Ok(None) };
            let key =
                ground_pose(path, row.token, sample, sample.timestamp_us, row.translation, row.rotation)?;
            Ok(Some(Annotation {
                slot,
                instance: row.instance_token,
                key,
                token: row.token,
                size_m: row.size,
            }))
        })?;
        let tokens: Vec<(Token, ())> = rows.iter().map(|a| (a.token, ())).collect();
        self.sorted(TABLE, tokens)?;
        let instances = self.read_instances(&rows)?;
        for track in group(rows) {
            logged[track.0].tracks.push(self.track(&track.1, &instances)?);
        }
        Ok(())
    }

    /// Id and category of the instances that are annotated, sorted by token.
    fn read_instances(&self, rows: &[Annotation]) -> Result<Vec<(Token, (String, String))>> {
        #[derive(Deserialize)]
        struct CategoryRow {
            token: Token,
            name: String,
        }
        #[derive(Deserialize)]
        struct InstanceRow {
            token: String,
            category_token: Token,
        }
        let categories = self.read_by_token("category", |row: CategoryRow| (row.token, row.name))?;
        let mut used: Vec<Token> = rows.iter().map(|a| a.instance).collect();
        used.par_sort_unstable();
        used.dedup();
        let rows = self.read("instance", |_, row: InstanceRow| {
            let token = Token::from_text(&row.token);
            if used.binary_search(&token).is_err() {
                return Ok(None);
            }
            let category = find(&categories, row.category_token).ok_or_else(|| {
                self.dangling(("instance", "category_token"), &row.token, row.category_token, "category")
            })?;
            Ok(Some((token, (row.token, category.clone()))))
        })?;
        self.sorted("instance", rows)
    }

    fn track(&self, rows: &[Annotation], instances: &[(Token, (String, String))]) -> Result<LoggedTrack> {
        const TABLE: &str = "sample_annotation";
        let first = &rows[0];
        let (instance, category) = find(instances, first.instance).cloned().ok_or_else(|| {
            self.dangling((TABLE, "instance_token"), first.token, first.instance, "instance")
        })?;
        let [width, length, height] = first.size_m;
        if !(width > 0.0 && length > 0.0 && height >= 0.0 && width.max(length).max(height) < 1e4) {
            return Err(NuscenesError::Value {
                path: self.path(TABLE),
                token: first.token.to_string(),
                field: "size",
                got: format!("{:?}", first.size_m),
                expected: "a positive width and length in metres",
            });
        }
        if let Some(pair) = rows.windows(2).find(|w| w[0].key.frame == w[1].key.frame) {
            let got = format!("{} in frame {}", instance, pair[0].key.frame);
            return Err(self.duplicate(TABLE, "annotation of instance", got));
        }
        let keys = rows.iter().map(|a| a.key).collect();
        Ok(LoggedTrack { instance, category, size_m: first.size_m, keys })
    }

    fn add_ego(&self, samples: &Samples, logged: &mut [LoggedScene]) -> Result<()> {
        #[derive(Deserialize)]
        struct PoseRow {
            token: Token,
            timestamp: i64,
            translation: [f64; 3],
            rotation: [f64; 4],
        }
        let (channels, rows) = self.read_key_frame_data(samples)?;
        let chosen = choose_channels(&rows, samples, channels.len(), logged.len());
        let mut wanted: Vec<(Token, u32)> = rows
            .iter()
            .filter(|r| samples.list[r.sample as usize].slot.and_then(|s| chosen[s]) == Some(r.channel))
            .map(|r| (r.ego_pose, r.sample))
            .collect();
        wanted.par_sort_unstable();
        wanted.dedup_by_key(|(token, _)| *token);
        let poses = self.read("ego_pose", |path, row: PoseRow| {
            let Some(sample_idx) = find(&wanted, row.token) else { return Ok(None) };
            let sample = &samples.list[*sample_idx as usize];
            let key = ground_pose(path, row.token, sample, row.timestamp, row.translation, row.rotation)?;
            Ok(Some((row.token, (sample.slot, key))))
        })?;
        let poses = self.sorted("ego_pose", poses)?;
        if let Some((lost, sample)) = wanted.iter().find(|(token, _)| find(&poses, *token).is_none()) {
            let of = samples.list[*sample as usize].token;
            return Err(self.dangling(
                ("sample_data", "ego_pose_token"),
                format!("of sample {of}"),
                *lost,
                "ego_pose",
            ));
        }
        for (_, (slot, key)) in poses {
            if let Some(slot) = slot {
                logged[slot].ego.push(key);
            }
        }
        for (scene, channel) in logged.iter_mut().zip(&chosen) {
            scene.ego.sort_by_key(|k| k.frame);
            scene.ego_channel = channel.map(|c| channels[c as usize].clone());
            if let Some(pair) = scene.ego.windows(2).find(|w| w[0].timestamp_us >= w[1].timestamp_us) {
                return Err(self.duplicate(
                    "ego_pose",
                    "key frame or its time, in one scene,",
                    pair[1].timestamp_us.to_string(),
                ));
            }
        }
        Ok(())
    }

    /// Channel names, most wanted first, and the key-frame sample_data of the wanted scenes.
    fn read_key_frame_data(&self, samples: &Samples) -> Result<(Vec<String>, Vec<KeyFrameData>)> {
        #[derive(Deserialize)]
        struct SensorRow {
            token: Token,
            channel: String,
        }
        #[derive(Deserialize)]
        struct CalibratedRow {
            token: Token,
            sensor_token: Token,
        }
        #[derive(Deserialize)]
        struct DataRow {
            token: Token,
            sample_token: Token,
            ego_pose_token: Token,
            calibrated_sensor_token: Token,
            is_key_frame: bool,
        }
        let sensors = self.read_by_token("sensor", |row: SensorRow| (row.token, row.channel))?;
        let rank = |channel: &str| match channel {
            "LIDAR_TOP" => 0,
            "CAM_FRONT" => 1,
            _ => 2,
        };
        let mut channels: Vec<String> = sensors.iter().map(|(_, channel)| channel.clone()).collect();
        channels.sort_by(|a, b| (rank(a), a).cmp(&(rank(b), b)));
        channels.dedup();
        let calibrated = self.read("calibrated_sensor", |_, row: CalibratedRow| {
            let channel = find(&sensors, row.sensor_token).ok_or_else(|| {
                self.dangling(("calibrated_sensor", "sensor_token"), row.token, row.sensor_token, "sensor")
            })?;
            Ok(Some((row.token, channels.iter().position(|c| c == channel).unwrap_or(0) as u16)))
        })?;
        let calibrated = self.sorted("calibrated_sensor", calibrated)?;
        const TABLE: &str = "sample_data";
        let rows = self.read(TABLE, |_, row: DataRow| {
            if !row.is_key_frame {
                return Ok(None);
            }
            let sample = samples.by_token(row.sample_token).ok_or_else(|| {
                self.dangling((TABLE, "sample_token"), row.token, row.sample_token, "sample")
            })?;
            if samples.list[sample as usize].slot.is_none() {
                return Ok(None);
            }
            let channel = *find(&calibrated, row.calibrated_sensor_token).ok_or_else(|| {
                let (from, got) = ((TABLE, "calibrated_sensor_token"), row.calibrated_sensor_token);
                self.dangling(from, row.token, got, "calibrated_sensor")
            })?;
            Ok(Some(KeyFrameData { sample, channel, ego_pose: row.ego_pose_token }))
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
    by_token: Vec<(Token, u32)>,
}

impl Samples {
    fn by_token(&self, token: Token) -> Option<u32> {
        find(&self.by_token, token).copied()
    }

    fn find(&self, token: Token) -> Option<&Sample> {
        self.list.get(self.by_token(token)? as usize)
    }
}

struct KeyFrameData {
    sample: u32,
    channel: u16,
    ego_pose: Token,
}

struct Annotation {
    slot: usize,
    instance: Token,
    key: Key,
    token: Token,
    size_m: [f64; 3],
}

/// Groups annotations by scene and instance, instances by first appearance (then by place in the file).
fn group(rows: Vec<Annotation>) -> Vec<(usize, Vec<Annotation>)> {
    let mut ordered: Vec<(usize, Annotation)> = rows.into_iter().enumerate().collect();
    ordered.par_sort_by_key(|(_, a)| (a.slot, a.instance, a.key.frame));
    let mut groups: Vec<(usize, usize, Vec<Annotation>)> = Vec::new();
    for (place, annotation) in ordered {
        match groups.last_mut() {
            Some((_, slot, rows)) if *slot == annotation.slot && rows[0].instance == annotation.instance => {
                rows.push(annotation);
            }
            _ => groups.push((place, annotation.slot, vec![annotation])),
        }
    }
    groups.sort_by_key(|(place, slot, rows)| (*slot, rows[0].key.frame, *place));
    groups.into_iter().map(|(_, slot, rows)| (slot, rows)).collect()
}

/// For each scene the channel that covers the most key frames; among equals the most wanted.
fn choose_channels(
    rows: &[KeyFrameData],
    samples: &Samples,
    num_channels: usize,
    num_scenes: usize,
) -> Vec<Option<u16>> {
    let mut counts = vec![0_u32; num_scenes * num_channels];
    for row in rows {
        if let Some(slot) = samples.list[row.sample as usize].slot {
            counts[slot * num_channels + row.channel as usize] += 1;
        }
    }
    let best = |counts: &[u32]| {
        let most = counts.iter().copied().max().filter(|m| *m > 0)?;
        counts.iter().position(|c| *c == most).map(|c| c as u16)
    };
    (0..num_scenes).map(|s| best(&counts[s * num_channels..(s + 1) * num_channels])).collect()
}

/// Position and yaw of a pose in three dimensions, checked. Yaw is the direction of the rotated x axis, as the
/// devkit's `quaternion_yaw`.
fn ground_pose(
    path: &Path,
    token: Token,
    sample: &Sample,
    timestamp_us: i64,
    translation: [f64; 3],
    rotation: [f64; 4],
) -> Result<Key> {
    let fail = |field, got: &[f64], expected| {
        let (path, token, got) = (path.to_owned(), token.to_string(), format!("{got:?}"));
        Err(NuscenesError::Value { path, token, field, got, expected })
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
    let yaw_rad = (2.0 * (x * y + w * z)).atan2(w * w + x * x - y * y - z * z);
    Ok(Key { frame: sample.frame, timestamp_us, x_m, y_m, yaw_rad })
}
