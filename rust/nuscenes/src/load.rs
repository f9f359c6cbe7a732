//! A load from beginning to end: choose scenes, take them from the cache, build the others.

use crate::budget::Budget;
use crate::build::{build_scene, num_states};
use crate::cache::{Cache, Hash, stamp};
use crate::error::{NuscenesError, Result};
use crate::map_file::{GlobalMap, MOST_POINTS, map_path, read_map};
use crate::options::{LoadOptions, Selection};
use crate::report::{LoadReport, SceneReport};
use crate::tables::{LoggedScene, SceneEntry, TABLES, Tables};
use ccdiff_sim::scene::Scene;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// About what the allocations of one scene take. glibc grows the heap of a thread page by page, each time with a system
/// call that holds up the other threads' page faults: one piece of this size, given back at once, grows it in one.
const SCENE_BYTES: usize = 96 << 10;
/// States of agents that a load may have, and more for each logged one: at 10 Hz those of nuScenes have 11 for each.
const MOST_STATES: usize = 4_000_000;
const STATES_PER_KEY: f64 = 200.0;
/// More points that the maps of all scenes may have for each key frame, where they reach 60 m beyond the tracks.
const POINTS_PER_FRAME: f64 = 2_000.0;

/// Scenes and what the load has to say about them.
#[derive(Debug, Clone)]
pub struct Loaded {
    /// The scenes, in the order of the selection.
    pub scenes: Vec<Arc<Scene>>,
    /// What was kept, what was not, and why.
    pub report: LoadReport,
}

/// Loads scenes of `<dataroot>/<version>/*.json` and `<dataroot>/maps/expansion/*.json`.
///
/// # Errors
/// Every way in which the data set, the selection or the options can be wrong: see [`NuscenesError`].
pub fn load(dataroot: &Path, version: &str, options: &LoadOptions) -> Result<Loaded> {
    options.build.check()?;
    let started = Instant::now();
    let mut load = Load {
        dataroot,
        source: format!("nuscenes {version}"),
        tables: Tables { folder: dataroot.join(version) },
        cache: Cache::new(options.cache_directory.as_deref()),
        options,
        report: LoadReport {
            dataroot: dataroot.display().to_string(),
            version: version.to_owned(),
            ..LoadReport::default()
        },
    };
    if !dataroot.is_dir() {
        return Err(NuscenesError::Missing { what: "data set".into(), path: dataroot.to_owned() });
    }
    if !load.tables.folder.is_dir() {
        let what = format!("version of the data set ({})", versions(dataroot));
        return Err(NuscenesError::Missing { what, path: load.tables.folder });
    }
    let scenes = load.run()?;
    let (hits, built) = (load.report.cache.hits, load.report.cache.built);
    load.report.cache = crate::report::CacheReport { hits, built, ..load.cache.report() };
    load.report.seconds = started.elapsed().as_secs_f64();
    Ok(Loaded { scenes, report: load.report })
}

/// Words about the versions that a data root has.
fn versions(dataroot: &Path) -> String {
    let is_version = |path: &Path| path.join("scene.json").is_file();
    if is_version(dataroot) {
        return "the data root is the folder above its tables".into();
    }
    let entries = std::fs::read_dir(dataroot).into_iter().flatten().flatten();
    let folders = entries.filter(|entry| is_version(&entry.path()));
    let mut names: Vec<_> = folders.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    if names.is_empty() { "there is none".into() } else { format!("there are {}", names.join(", ")) }
}

type Built = (Option<Scene>, SceneReport);
type Maps = BTreeMap<String, (Option<GlobalMap>, Vec<String>)>;

struct Load<'a> {
    dataroot: &'a Path,
    source: String,
    tables: Tables,
    cache: Cache,
    options: &'a LoadOptions,
    report: LoadReport,
}

impl Load<'_> {
    fn run(&mut self) -> Result<Vec<Arc<Scene>>> {
        let tables_hash = self.cache.is_on().then(|| self.stamp_tables()).transpose()?;
        let entries = self.entries(tables_hash)?;
        let wanted = self.select(&entries)?;
        let keys = tables_hash.map(|hash| self.scene_keys(hash, &entries, &wanted)).transpose()?;

        let mut built = self.cached(keys.as_deref(), wanted.len());
        self.report.cache.hits = built.iter().flatten().count();

        let lost: Vec<usize> = (0..wanted.len()).filter(|i| built[*i].is_none()).collect();
        if !lost.is_empty() {
            let indices: Vec<usize> = lost.iter().map(|i| wanted[*i]).collect();
            let (logged, maps) = rayon::join(
                || {
                    self.tables.read_logged(
                        &entries,
                        &indices,
                        self.options.build.ego_reference.to_centre_m(),
                    )
                },
                || self.read_maps(indices.iter().map(|i| &entries[*i])),
            );
            let (logged, maps) = (logged?, maps?);
            let points = self.budget(&logged)?;
            let build = |(logged, (slot, scene_idx)): (_, (&usize, &usize))| {
                let entry = &entries[*scene_idx];
                drop(std::hint::black_box(Vec::<u8>::with_capacity(SCENE_BYTES)));
                let map = maps.get(&entry.location).and_then(|(map, _)| map.as_ref());
                let built = build_scene(entry, logged, map, &self.source, &self.options.build, &points)?;
                if !points.covers(0) {
                    let path = self.dataroot.join("maps").join("expansion");
                    let what = "the scenes to load have too many points of maps for so few key frames".into();
                    return Err(NuscenesError::Data { path, what });
                }
                if let Some(keys) = &keys {
                    self.cache.put("scene", keys[*slot], &built);
                }
                Ok((*slot, built))
            };
            let fresh: Vec<(usize, Built)> =
                logged.par_iter().zip(lost.par_iter().zip(&indices)).map(build).collect::<Result<_>>()?;
            for (slot, scene) in fresh {
                built[slot] = Some(scene);
            }
            self.report.cache.built = lost.len();
            let (used, notes): (Vec<_>, Vec<_>) = maps.into_values().unzip();
            self.report.map_notes = notes.concat();
            // tens of thousands of small vectors: given back while the caller goes on
            rayon::spawn(move || drop((logged, used)));
        }
        self.note_missing_maps(wanted.iter().map(|i| &entries[*i]));
        self.finish(built.into_iter().flatten())
    }

    /// Points that the maps of scenes may have; refuses tables of few records and very many states.
    fn budget(&self, logged: &[LoggedScene]) -> Result<Budget> {
        let options = &self.options.build;
        let each = logged.iter().map(|scene| num_states(scene, options));
        let [states, keys] = each.fold([0, 0], |[a, b], [c, d]| [a + c, b + d]);
        let most = MOST_STATES + (keys as f64 * STATES_PER_KEY * (0.1 / options.dt_s).max(1.0)) as usize;
        if states > most {
            let what =
                format!("{states} states of agents, made of {keys} logged ones, expected at most {most}");
            return Err(NuscenesError::Data { path: self.tables.path("sample_annotation"), what });
        }
        let frames: usize = logged.iter().map(|scene| scene.timestamps_us.len()).sum();
        let reach = (options.map_margin_m / 60.0).max(1.0);
        Ok(Budget::new(MOST_POINTS + (frames as f64 * POINTS_PER_FRAME * reach * reach) as usize))
    }

    fn finish(&mut self, built: impl Iterator<Item = Built>) -> Result<Vec<Arc<Scene>>> {
        let mut scenes = Vec::new();
        for (scene, report) in built {
            match scene {
                Some(scene) => {
                    scenes.push(Arc::new(scene));
                    self.report.scenes.push(report);
                }
                None => self.report.empty.push(report.name),
            }
        }
        if scenes.is_empty() {
            let (missing, empty) = (&self.report.missing, &self.report.empty);
            let what =
                format!("no scene to load, not in the data set: {missing:?}, without agents: {empty:?}");
            return Err(NuscenesError::Data { path: self.tables.folder.clone(), what });
        }
        Ok(scenes)
    }

    fn stamp_tables(&self) -> Result<Hash> {
        let stamp = |table: &&str| stamp(&self.tables.path(table), &format!("table {table}"));
        Hash::of(&(TABLES.iter().map(stamp).collect::<Result<Vec<_>>>()?, &self.source))
    }

    /// The scene table; from the cache where the tables are known.
    fn entries(&self, tables_hash: Option<Hash>) -> Result<Vec<SceneEntry>> {
        if let Some(entries) = tables_hash.and_then(|hash| self.cache.get("index", hash)) {
            return Ok(entries);
        }
        let entries = self.tables.read_scenes()?;
        for entry in &entries {
            check_location(&self.tables.path("log"), entry)?;
        }
        if let Some(hash) = tables_hash {
            self.cache.put("index", hash, &entries);
        }
        Ok(entries)
    }

    fn select(&mut self, entries: &[SceneEntry]) -> Result<Vec<usize>> {
        let find = |wanted: &String| entries.iter().position(|e| e.name == *wanted || e.token == *wanted);
        match &self.options.selection {
            Selection::All => Ok((0..entries.len()).collect()),
            Selection::AnyOf(names) => {
                let mut wanted: Vec<usize> = names.iter().filter_map(find).collect();
                wanted.sort_unstable();
                wanted.dedup();
                self.report.missing = names.iter().filter(|n| find(n).is_none()).cloned().collect();
                Ok(wanted)
            }
            Selection::Exactly(names) => {
                let mut wanted = Vec::with_capacity(names.len());
                for name in names {
                    let index = find(name).ok_or_else(|| {
                        let (known, folder) = (entries.len(), self.tables.folder.display());
                        let message = format!("scene {name:?} is not among the {known} scenes of {folder}");
                        NuscenesError::Unknown(message)
                    })?;
                    if !wanted.contains(&index) {
                        wanted.push(index);
                    }
                }
                Ok(wanted)
            }
        }
    }

    fn scene_keys(&self, tables: Hash, entries: &[SceneEntry], wanted: &[usize]) -> Result<Vec<Hash>> {
        let mut maps: BTreeMap<&str, Option<Hash>> = BTreeMap::new();
        let key = |index: &usize| {
            let entry = &entries[*index];
            if !maps.contains_key(entry.location.as_str()) {
                let path = map_path(self.dataroot, &entry.location);
                let hash = match stamp(&path, "map expansion") {
                    Err(NuscenesError::Missing { .. }) => None,
                    other => Some(other?),
                };
                maps.insert(&entry.location, hash);
            }
            Hash::of(&(tables, maps.get(entry.location.as_str()), &entry.token, &self.options.build))
        };
        wanted.iter().map(key).collect()
    }

    fn cached(&self, keys: Option<&[Hash]>, count: usize) -> Vec<Option<Built>> {
        let Some(keys) = keys else { return vec![None; count] };
        let read = |key: &Hash| {
            let (scene, report): Built = self.cache.get("scene", *key)?;
            // the checksum has held: this fails only for a file of another build of the same version
            Some((scene.map(Scene::validated).transpose().ok()?, report))
        };
        keys.par_iter().map(read).collect()
    }

    /// Maps of the locations, read once each; `None` where there is no file.
    fn read_maps<'e>(&self, entries: impl Iterator<Item = &'e SceneEntry>) -> Result<Maps> {
        let locations: Vec<&str> = locations(entries).into_iter().collect();
        let points = Budget::new(MOST_POINTS);
        let read = |location: &&str| {
            let map = match read_map(&map_path(self.dataroot, location), location, &points) {
                Err(NuscenesError::Missing { .. }) => (None, Vec::new()),
                other => other.map(|(map, notes)| (Some(map), notes))?,
            };
            Ok(((*location).to_owned(), map))
        };
        locations.par_iter().map(read).collect::<Result<Vec<_>>>().map(|maps| maps.into_iter().collect())
    }

    fn note_missing_maps<'e>(&mut self, entries: impl Iterator<Item = &'e SceneEntry>) {
        let missing = locations(entries).into_iter().filter(|l| !map_path(self.dataroot, l).is_file());
        self.report.missing_maps = missing.map(str::to_owned).collect();
    }
}

/// Locations of scenes, each once.
fn locations<'e>(entries: impl Iterator<Item = &'e SceneEntry>) -> BTreeSet<&'e str> {
    entries.map(|e| e.location.as_str()).collect()
}

/// A location becomes part of a path.
fn check_location(log_table: &Path, entry: &SceneEntry) -> Result<()> {
    let sound = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b' ' | b'.');
    if entry.location.bytes().all(sound) && !entry.location.contains("..") {
        return Ok(());
    }
    let (token, got) = (format!("log of scene {}", entry.name), format!("{:?}", entry.location));
    let expected = "a name of letters, digits and hyphens";
    Err(NuscenesError::value(log_table, token, "location", got, expected))
}
