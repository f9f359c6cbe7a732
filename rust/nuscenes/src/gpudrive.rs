//! Waymo scenes in GPUDrive's JSON (Kazemkhani et al., "GPUDrive", 2024): one file a scene, 10 Hz, no drivable area.
//!
//! Positions are centres of boxes, also in height; points of roads lie on the ground. Where no road passes over another the
//! heights are left out. Where a state is not valid its numbers are -10000. Road edges are open lines with the road to their left: the drivable area
//! is made from them, and lanes follow each other where one ends and another begins.

use crate::cache::{Cache, Hash, stamp};
use crate::codec::{decode_scene, encode_scene};
use crate::error::{NuscenesError, Result};
use crate::file;
use crate::load::Loaded;
use crate::report::{CacheReport, LoadReport, Road, SceneReport};
use crate::resample::unwrapped;
use crate::stream::parse;
use ccdiff_sim::geom::{Point2, Polygon, Real, Vector2};
use ccdiff_sim::scene::{
    Agent, AgentKind, EGO_ID, Elevations, HIGHEST_M, Lane, Light, LightState, Map, PartElevations, RoadParts,
    Scene, Tracks, cut_by_level, level_bounds, link_lanes, range_of, road_area, road_areas,
};
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Largest file; the field's have 1.5 MB.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// What stands where a state is not valid.
const NOT_VALID: f64 = -10_000.0;
/// Seconds between steps.
const DT_S: Real = 0.1;
/// Coordinates beyond this are on no map of a city, metres.
const MAX_COORDINATE_M: f64 = 1e6;
/// Points of centre lines are about this far apart, metres.
const LANE_SPACING_M: f64 = 1.0;
/// Most metres of lanes in a scene.
const MAX_LANES_M: f64 = 1e6;
const LONGEST_NAME: usize = 200;

#[derive(Deserialize)]
struct File {
    name: Option<String>,
    scenario_id: Option<String>,
    objects: Vec<Object>,
    roads: Vec<MapElement>,
    #[serde(default)]
    tl_states: BTreeMap<String, TrafficLight>,
    metadata: Metadata,
}

#[derive(Deserialize)]
struct Metadata {
    sdc_track_index: i64,
}

#[derive(Deserialize)]
struct Object {
    id: i64,
    #[serde(rename = "type")]
    kind: String,
    length: f64,
    width: f64,
    #[serde(default)]
    height: f64,
    position: Vec<Point>,
    heading: Vec<f64>,
    velocity: Vec<Point>,
    valid: Vec<bool>,
}

/// States of the light of a lane, at the steps where it is seen, and its stop point.
#[derive(Deserialize)]
struct TrafficLight {
    state: Vec<String>,
    x: Vec<f64>,
    y: Vec<f64>,
    time_index: Vec<usize>,
}

#[derive(Deserialize)]
struct MapElement {
    #[serde(default)]
    id: i64,
    #[serde(rename = "type")]
    kind: String,
    #[serde(default)]
    map_element_id: i64,
    geometry: Vec<Point>,
}

#[derive(Deserialize, Clone, Copy)]
struct Point {
    x: f64,
    y: f64,
    #[serde(default)]
    z: Option<f64>,
}

impl Point {
    /// Whether its height is one on Earth, or not told.
    fn is_high(&self) -> bool {
        self.z.is_none_or(|z| z.abs() <= f64::from(HIGHEST_M))
    }
}

/// Loads scenes, one from each file, in parallel.
///
/// # Errors
/// [`NuscenesError`] names the first file at fault, and the place in it.
pub fn load_gpudrive(paths: &[PathBuf], cache_directory: Option<&Path>) -> Result<Loaded> {
    let started = Instant::now();
    let cache = Cache::new(cache_directory);
    let load = |path: &PathBuf| {
        let key = cache.is_on().then(|| Hash::of(&("gpudrive", stamp(path, "scene")?))).transpose()?;
        let known = key.and_then(|key| cache.get::<(Vec<u8>, SceneReport)>("scene", key));
        if let Some((scene, report)) =
            known.and_then(|(bytes, report)| Some((decode_scene(&bytes).ok()?, report)))
        {
            return Ok((Arc::new(scene), report, true));
        }
        let (scene, report) = read_scene(path)?;
        if let Some(key) = key {
            cache.put("scene", key, &(encode_scene(&scene)?, &report));
        }
        Ok((Arc::new(scene), report, false))
    };
    let loaded: Vec<_> = paths.par_iter().map(load).collect::<Result<_>>()?;
    let hits = loaded.iter().filter(|(_, _, hit)| *hit).count();
    let mut report = LoadReport { version: "gpudrive".into(), ..LoadReport::default() };
    report.cache = CacheReport { hits, built: paths.len() - hits, ..cache.report() };
    report.seconds = started.elapsed().as_secs_f64();
    let mut scenes = Vec::with_capacity(loaded.len());
    for (scene, of_scene, _) in loaded {
        scenes.push(scene);
        report.scenes.push(of_scene);
    }
    Ok(Loaded { scenes, report })
}

fn read_scene(path: &Path) -> Result<(Scene, SceneReport)> {
    let bytes = file::read(path, MAX_FILE_BYTES).map_err(|e| NuscenesError::from_io(path, "scene", e))?;
    let file = parse(&bytes, path, 0)?;
    drop(bytes);
    Reader { path, file }.scene()
}

struct Reader<'a> {
    path: &'a Path,
    file: File,
}

impl Reader<'_> {
    fn fault<T>(
        &self,
        place: String,
        field: &'static str,
        got: impl ToString,
        expected: &'static str,
    ) -> Result<T> {
        Err(NuscenesError::value(self.path, place, field, got.to_string(), expected))
    }

    fn scene(&self) -> Result<(Scene, SceneReport)> {
        let [name, token] = self.names()?;
        let index = self.file.metadata.sdc_track_index;
        let Some(ego) = usize::try_from(index).ok().filter(|i| *i < self.file.objects.len()) else {
            return self.fault("metadata".into(), "sdc_track_index", index, "the index of an object");
        };
        let num_steps = self.file.objects[ego].valid.len();
        let mut report = SceneReport {
            name: name.clone(),
            key_frames: num_steps,
            ego_channel: Some("sdc".into()),
            ..SceneReport::default()
        };
        let kept = self.kept(ego, num_steps, &mut report)?;
        let first = self.file.objects[ego].valid.iter().position(|valid| *valid).unwrap_or(0);
        let start = self.file.objects[ego].position[first];
        let origin = [start.x.round(), start.y.round()];
        let (agents, mut tracks) = self.agents(&kept, ego, num_steps, origin);
        let bounds = self.levels(&kept, &mut tracks, origin, &mut report);
        for agent in &agents {
            *report.tracks.entry(agent.category.clone()).or_default() += 1;
        }
        report.annotations = tracks.valid.iter().filter(|valid| **valid).count();
        let seeds = vehicles(&agents, &tracks);
        let map = self.map(origin, &seeds, &bounds, num_steps, &mut report)?;
        let scene = Scene {
            token,
            name,
            location: "waymo".into(),
            source: "gpudrive".into(),
            origin,
            dt_s: DT_S,
            num_steps,
            agents,
            tracks,
            map: Arc::new(map),
        };
        Ok((report.mend(scene.validated()?), report))
    }

    /// Printable names: of the file, which tells scenes apart without reading them, and of the scenario.
    fn names(&self) -> Result<[String; 2]> {
        let stem = self.path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let scenario =
            [&self.file.scenario_id, &self.file.name].into_iter().flatten().find(|n| !n.is_empty());
        let scenario = scenario.cloned().unwrap_or_else(|| stem.clone());
        for (field, name) in [("file", &stem), ("scenario_id", &scenario)] {
            if name.len() > LONGEST_NAME || name.chars().any(char::is_control) {
                let got: String = name.escape_debug().take(80).collect();
                return self.fault("scene".into(), field, got, "a printable name of at most 200 bytes");
            }
        }
        Ok([stem, scenario])
    }

    /// Indices of the objects that become agents, the ego first.
    fn kept(&self, ego: usize, num_steps: usize, report: &mut SceneReport) -> Result<Vec<usize>> {
        let mut ids = BTreeSet::new();
        let (mut kept, objects) = (vec![ego], &self.file.objects);
        for (i, object) in objects.iter().enumerate() {
            if !ids.insert(object.id) {
                return Err(NuscenesError::duplicate(self.path, "id of an object", object.id));
            }
            self.check_states(i, object, num_steps)?;
            let steps = object.valid.iter().filter(|valid| **valid).count();
            let reason = match kind_of(&object.kind) {
                _ if steps < 2 => Some("fewer than 2 steps"),
                None => Some("unknown type"),
                Some(_) => None,
            };
            match reason {
                Some(reason) if i == ego => {
                    let expected = "a vehicle, pedestrian or cyclist that is there for two steps";
                    return self.fault(format!("objects[{i}]"), "sdc_track_index", reason, expected);
                }
                Some(reason) => report.drop_track(&object.kind, reason),
                None if i != ego => kept.push(i),
                None => {}
            }
            if reason.is_none() && !(object.length > 0.0 && object.width > 0.0 && object.height >= 0.0) {
                let got = format!("{} x {} x {}", object.length, object.width, object.height);
                return self.fault(
                    format!("objects[{i}]"),
                    "size",
                    got,
                    "a positive length and width in metres",
                );
            }
        }
        Ok(kept)
    }

    fn check_states(&self, i: usize, object: &Object, num_steps: usize) -> Result<()> {
        for (field, len) in [
            ("position", object.position.len()),
            ("heading", object.heading.len()),
            ("velocity", object.velocity.len()),
            ("valid", object.valid.len()),
        ] {
            if len != num_steps {
                let expected = "as many entries as the ego's valid has";
                return self.fault(format!("objects[{i}]"), field, format!("{len} entries long"), expected);
            }
        }
        for step in (0..num_steps).filter(|step| object.valid[*step]) {
            let (position, velocity) = (object.position[step], object.velocity[step]);
            if !position.is_high() {
                let (got, expected) = (position.z.unwrap_or_default(), "a height within 9 km");
                return self.fault(format!("objects[{i}].position[{step}]"), "z", got, expected);
            }
            for (list, field, value) in [
                ("position", "x", position.x),
                ("position", "y", position.y),
                ("velocity", "x", velocity.x),
                ("velocity", "y", velocity.y),
                ("heading", "value", object.heading[step]),
            ] {
                if value == NOT_VALID || value.abs() > MAX_COORDINATE_M {
                    let expected = "a number within 1000 km, and not -10000 where valid";
                    return self.fault(format!("objects[{i}].{list}[{step}]"), field, value, expected);
                }
            }
        }
        Ok(())
    }

    fn agents(&self, kept: &[usize], ego: usize, num_steps: usize, origin: [f64; 2]) -> (Vec<Agent>, Tracks) {
        let entries = kept.len() * num_steps;
        let mut tracks = Tracks {
            position: vec![Point2::origin(); entries],
            heading_rad: vec![0.0; entries],
            velocity: vec![Vector2::zeros(); entries],
            valid: Vec::with_capacity(entries),
            elevation_m: Vec::new(),
        };
        let mut agents = Vec::with_capacity(kept.len());
        for (row, i) in kept.iter().enumerate() {
            let object = &self.file.objects[*i];
            agents.push(Agent {
                id: if *i == ego { EGO_ID.to_owned() } else { object.id.to_string() },
                kind: kind_of(&object.kind).unwrap_or(AgentKind::Vehicle),
                category: object.kind.clone(),
                length_m: object.length as Real,
                width_m: object.width as Real,
                height_m: object.height as Real,
            });
            tracks.valid.extend_from_slice(&object.valid);
            let mut before: Option<f64> = None;
            for step in (0..num_steps).filter(|step| object.valid[*step]) {
                let (at, position, velocity) =
                    (row * num_steps + step, object.position[step], object.velocity[step]);
                let heading = before.map_or(object.heading[step], |b| unwrapped(b, object.heading[step]));
                before = Some(heading);
                tracks.position[at] = relative(position, origin);
                tracks.heading_rad[at] = heading as Real;
                tracks.velocity[at] = Vector2::new(velocity.x as Real, velocity.y as Real);
            }
        }
        (agents, tracks)
    }

    /// Elevations between the levels of the scene, none where it is flat; fills in the elevations of the tracks otherwise.
    fn levels(
        &self,
        kept: &[usize],
        tracks: &mut Tracks,
        origin: [f64; 2],
        report: &mut SceneReport,
    ) -> Vec<Real> {
        let objects = kept.iter().map(|i| &self.file.objects[*i]);
        let states = objects.flat_map(|o| o.position.iter().zip(&o.valid).map(move |(p, ok)| (o, p, *ok)));
        // the ground is half a body below the middle of a box
        let ground = |(o, p, _): (&Object, &Point, bool)| p.z.map_or(0.0, |z| (z - 0.5 * o.height) as Real);
        let roads = self.file.roads.iter().flat_map(|road| &road.geometry);
        let shown = states.clone().filter(|(_, _, ok)| *ok).map(|(_, p, _)| p);
        let unknown = shown.chain(roads).filter(|p| p.z.is_none()).count();
        if unknown > 0 {
            report.notes.push(format!("{unknown} places without a height: the scene is taken as flat"));
            return Vec::new();
        }
        let lines: Vec<_> = self.file.roads.iter().map(|road| line_of(&road.geometry, origin)).collect();
        let lines = lines.iter().map(|(line, heights)| (line.as_slice(), heights.as_slice()));
        let of_tracks = states.clone().zip(&tracks.position).filter(|((.., ok), _)| *ok);
        let of_tracks = of_tracks.map(|(state, position)| (*position, ground(state)));
        let bounds = level_bounds(lines, of_tracks);
        if !bounds.is_empty() {
            let heights = states.map(|state| if state.2 { ground(state) } else { 0.0 });
            tracks.elevation_m = heights.collect();
            report.notes.push(
                "levels of roads: agents more than 2.5 m higher or lower are out of reach; networks see the roads of \
                 all levels"
                    .into(),
            );
        }
        bounds
    }

    fn map(
        &self,
        origin: [f64; 2],
        seeds: &[(Point2, Real)],
        bounds: &[Real],
        num_steps: usize,
        report: &mut SceneReport,
    ) -> Result<Map> {
        let mut map = Map::default();
        let (mut edges, mut edge_heights, mut surface_heights, mut lanes_m) =
            (Vec::new(), Vec::new(), Vec::new(), 0.0);
        let mut unused = BTreeMap::<String, usize>::new();
        for (i, road) in self.file.roads.iter().enumerate() {
            let far =
                |p: &&Point| p.x.abs() > MAX_COORDINATE_M || p.y.abs() > MAX_COORDINATE_M || !p.is_high();
            if let Some(point) = road.geometry.iter().find(far) {
                let got = format!("{}, {}, {:?}", point.x, point.y, point.z);
                let expected = "points within 1000 km, and 9 km in height";
                return self.fault(format!("roads[{i}]"), "geometry", got, expected);
            }
            let (line, heights) = line_of(&road.geometry, origin);
            let is_line = line.len() >= 2;
            let is_area = line.len() >= 3;
            match (road.kind.as_str(), road.map_element_id) {
                ("lane", 0..=2) if is_line => {
                    lanes_m += line.windows(2).map(|w| f64::from((w[1] - w[0]).norm())).sum::<f64>();
                    if lanes_m > MAX_LANES_M {
                        let expected = "1000 km of lanes at most";
                        return self.fault(format!("roads[{i}]"), "geometry", "more", expected);
                    }
                    let (centreline, elevation_m) = resampled(&line, &heights).into_iter().unzip();
                    map.lanes.push(Lane {
                        id: road.id.to_string(),
                        centreline,
                        elevation_m: if bounds.is_empty() { Vec::new() } else { elevation_m },
                        ..Lane::default()
                    });
                }
                ("road_line", element) if is_line => {
                    // yellow lines part the directions of traffic
                    let (lines, ranges) = match element {
                        9..=13 => (&mut map.road_dividers, &mut map.elevation_m.road_dividers),
                        _ => (&mut map.lane_dividers, &mut map.elevation_m.lane_dividers),
                    };
                    for (piece, range) in cut_by_level(&line, &heights, bounds) {
                        lines.push(piece);
                        ranges.push(range);
                    }
                }
                ("road_edge", _) if is_line => {
                    edges.push(line);
                    edge_heights.push(heights);
                }
                ("crosswalk", _) if is_area => {
                    map.ped_crossings.push(area(line));
                    map.elevation_m.ped_crossings.push(range_of(&heights));
                }
                ("driveway", _) if is_area => {
                    map.drivable_area.push(area(line));
                    surface_heights.push(range_of(&heights));
                }
                (kind, _) => *unused.entry(kind.chars().take(40).collect()).or_default() += 1,
            }
        }
        for (kind, count) in unused {
            report.notes.push(format!("{count} roads of type {kind:?} have no layer here"));
        }
        link_lanes(&mut map.lanes);
        self.lights(&mut map, origin, num_steps, report)?;
        let surfaces = std::mem::take(&mut map.drivable_area);
        let (seeds, seed_heights): (Vec<Point2>, Vec<Real>) = seeds.iter().copied().unzip();
        let parts = RoadParts { edges: &edges, lanes: &map.lanes, surfaces: &surfaces, seeds: &seeds };
        if bounds.is_empty() {
            map.elevation_m = Elevations::default();
            map.drivable_area = road_area(parts);
        } else {
            let heights =
                PartElevations { edges: &edge_heights, surfaces: &surface_heights, seeds: &seed_heights };
            (map.drivable_area, map.elevation_m.drivable_area) = road_areas(parts, heights, bounds);
        }
        report.road = if map.drivable_area.is_empty() { Road::None } else { Road::Edges };
        Ok(map)
    }

    /// The lights of the lanes that the map has.
    fn lights(
        &self,
        map: &mut Map,
        origin: [f64; 2],
        num_steps: usize,
        report: &mut SceneReport,
    ) -> Result<()> {
        for (id, light) in &self.file.tl_states {
            let place = || format!("tl_states[{id:.40?}]");
            let steps = &light.time_index;
            if [light.state.len(), light.x.len(), light.y.len()].iter().any(|len| *len != steps.len()) {
                return self.fault(place(), "state", light.state.len(), "as many entries as time_index has");
            }
            let Some(lane) = map.lanes.iter().position(|lane| lane.id == *id).filter(|_| !steps.is_empty())
            else {
                report.notes.push(format!("a light of lane {id:.40}, which is not there"));
                continue;
            };
            let mut states = vec![LightState::Unknown; num_steps];
            for (step, name) in steps.iter().zip(&light.state) {
                match states.get_mut(*step) {
                    Some(state) => *state = light_state(name),
                    None => return self.fault(place(), "time_index", step, "a step of the log"),
                }
            }
            let at = Point2::new((light.x[0] - origin[0]) as Real, (light.y[0] - origin[1]) as Real);
            let stop_line = map.stop_line(lane, at);
            map.lights.push(Light { lane: lane as u32, stop_line, states });
        }
        Ok(())
    }
}

/// The state of a light by Waymo's name for it; arrows and flashing ones are told as the lane sees them.
fn light_state(name: &str) -> LightState {
    match name.to_ascii_lowercase().trim_start_matches("lane_state_").trim_start_matches("arrow_") {
        "stop" | "flashing_stop" => LightState::Red,
        "caution" | "flashing_caution" => LightState::Yellow,
        "go" => LightState::Green,
        _ => LightState::Unknown,
    }
}

fn kind_of(name: &str) -> Option<AgentKind> {
    match name {
        "vehicle" => Some(AgentKind::Vehicle),
        "pedestrian" => Some(AgentKind::Pedestrian),
        "cyclist" => Some(AgentKind::Cyclist),
        _ => None,
    }
}

fn relative(point: Point, origin: [f64; 2]) -> Point2 {
    Point2::new((point.x - origin[0]) as Real, (point.y - origin[1]) as Real)
}

/// Where vehicles were, and how high where that is known.
fn vehicles(agents: &[Agent], tracks: &Tracks) -> Vec<(Point2, Real)> {
    let num_steps = tracks.valid.len() / agents.len();
    let of_vehicle = |i: &usize| tracks.valid[*i] && agents[*i / num_steps].kind == AgentKind::Vehicle;
    let height = |i: usize| tracks.elevation_m.get(i).copied().unwrap_or(0.0);
    (0..tracks.valid.len()).filter(of_vehicle).map(|i| (tracks.position[i], height(i))).collect()
}

/// A ring without the repeated first point at its end.
fn area(mut ring: Vec<Point2>) -> Polygon {
    if ring.first() == ring.last() {
        ring.pop();
    }
    Polygon::from_exterior(ring)
}

/// The points of a line without those that repeat the one before, and their heights, 0 where these are not known.
fn line_of(points: &[Point], origin: [f64; 2]) -> (Vec<Point2>, Vec<Real>) {
    let mut line: Vec<(Point2, Real)> =
        points.iter().map(|p| (relative(*p, origin), p.z.unwrap_or_default() as Real)).collect();
    line.dedup_by_key(|(point, _)| *point);
    line.into_iter().unzip()
}

/// A line with points about a metre apart, and their heights.
fn resampled(line: &[Point2], heights: &[Real]) -> Vec<(Point2, Real)> {
    let length_m: f64 = line.windows(2).map(|w| f64::from((w[1] - w[0]).norm())).sum();
    let count = (length_m / LANE_SPACING_M).ceil().max(1.0) as usize;
    let mut out = Vec::with_capacity(count + 1);
    let (mut i, mut passed_m) = (0, 0.0);
    for k in 0..count {
        let along_m = length_m * k as f64 / count as f64;
        let mut step_m = f64::from((line[i + 1] - line[i]).norm());
        while i + 2 < line.len() && passed_m + step_m <= along_m {
            passed_m += step_m;
            i += 1;
            step_m = f64::from((line[i + 1] - line[i]).norm());
        }
        let share = ((along_m - passed_m) / step_m).clamp(0.0, 1.0) as Real;
        let height = heights[i] + (heights[i + 1] - heights[i]) * share;
        out.push((line[i] + (line[i + 1] - line[i]) * share, height));
    }
    out.push((line[line.len() - 1], heights[line.len() - 1]));
    out
}
