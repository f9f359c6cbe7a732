//! From the logged facts of one scene to a [`Scene`].

use crate::budget::Budget;
use crate::category::kind_of_category;
use crate::crop::crop;
use crate::error::Result;
use crate::map_file::{Bounds, GlobalMap};
use crate::options::{BuildOptions, KEY_FRAME_INTERVAL_S, KeyFrameTiming};
use crate::report::{Road, SceneReport};
use crate::resample::{ANNOTATION_SMOOTHING_S3, Resampled, Steps, resample};
use crate::tables::{Key, LoggedScene, LoggedTrack, SceneEntry};
use ccdiff_sim::geom::{Point2, Real, Vector2};
use ccdiff_sim::scene::{Agent, AgentKind, EGO_ID, Scene, Tracks};
use std::sync::Arc;

/// Category of the ego, which has none in the tables.
const EGO_CATEGORY: &str = "vehicle.ego";
/// Length, width, height of the recording car, metres (reference.md#agents).
const EGO_SIZE_M: [Real; 3] = [4.084, 1.730, 1.562];
/// Key frames further from their nominal distance than this are noted, seconds.
const JITTER_NOTED_S: f64 = 0.15;

/// Builds a scene and says what was left out; no scene where no agent is left. Points of its map are of a budget.
pub(crate) fn build_scene(
    entry: &SceneEntry,
    logged: &LoggedScene,
    map: Option<&GlobalMap>,
    source: &str,
    options: &BuildOptions,
    points: &Budget,
) -> Result<(Option<Scene>, SceneReport)> {
    let mut report = SceneReport {
        name: entry.name.clone(),
        key_frames: logged.timestamps_us.len(),
        ego_channel: logged.ego_channel.clone(),
        ..SceneReport::default()
    };
    note_timing(logged, &mut report);
    if logged.tracks.is_empty() {
        report.notes.push("nobody but the ego: no annotations".into());
    }
    let clock = Clock::of(logged, options);
    let (agents, tracks) = collect(logged, &clock, options, &mut report);
    let states = || tracks.iter().flat_map(|t| &t.states);
    if agents.is_empty() {
        return Ok((None, report));
    }
    let origin = match tracks.first().filter(|_| agents[0].id == EGO_ID).and_then(|t| t.states.first()) {
        Some(ego) => ego.position_m,
        None => {
            let count = states().count().max(1) as f64;
            [0, 1].map(|axis| states().map(|s| s.position_m[axis]).sum::<f64>() / count)
        }
    }
    .map(f64::round);
    let num_steps = clock.steps.count;
    let scene_map = map.map(|map| {
        let rect = Bounds::of(states().map(|s| &s.position_m)).grown(options.map_margin_m);
        crop(map, origin, &rect, points)
    });
    let scene_map = scene_map.unwrap_or_default();
    report.road = if scene_map.drivable_area.is_empty() { Road::None } else { Road::Given };
    let scene = Scene {
        name: entry.name.clone(),
        token: entry.token.clone(),
        location: entry.location.clone(),
        source: source.to_owned(),
        origin,
        dt_s: options.dt_s as Real,
        num_steps,
        agents,
        tracks: lay_out(&tracks, origin, num_steps),
        map: Arc::new(scene_map),
    };
    Ok((Some(report.mend(scene.validated()?)), report))
}

/// States of all agents at all steps of a scene, and the logged ones that they are made of.
pub(crate) fn num_states(logged: &LoggedScene, options: &BuildOptions) -> [usize; 2] {
    let tracks = logged.tracks.iter().filter(|track| wanted_kind(track, options).is_ok());
    let (agents, keys) =
        tracks.fold((1, logged.ego.len()), |(agents, keys), track| (agents + 1, keys + track.keys.len()));
    [agents * Clock::of(logged, options).steps.count, keys]
}

/// When key frames of a scene are, and its steps.
struct Clock {
    timing: KeyFrameTiming,
    start_us: i64,
    steps: Steps,
}

impl Clock {
    fn of(logged: &LoggedScene, options: &BuildOptions) -> Self {
        let [start_us, last_us] =
            [logged.timestamps_us.first(), logged.timestamps_us.last()].map(|us| us.copied().unwrap_or(0));
        let duration_us = match options.timing {
            KeyFrameTiming::Recorded => last_us - start_us,
            KeyFrameTiming::Nominal => nominal_us(logged.timestamps_us.len().saturating_sub(1)),
        };
        let steps = Steps::until(duration_us, options.dt_s * 1e6);
        Self { timing: options.timing, start_us, steps }
    }

    /// Time of a key frame after the first of its scene.
    fn time_us(&self, key: &Key) -> i64 {
        match self.timing {
            KeyFrameTiming::Recorded => key.timestamp_us - self.start_us,
            KeyFrameTiming::Nominal => nominal_us(key.frame),
        }
    }
}

fn nominal_us(frame: usize) -> i64 {
    (frame as f64 * KEY_FRAME_INTERVAL_S * 1e6) as i64
}

fn note_timing(logged: &LoggedScene, report: &mut SceneReport) {
    let intervals = logged.timestamps_us.windows(2).map(|w| (w[1] as f64 - w[0] as f64) * 1e-6);
    let off = intervals.filter(|s| (s - KEY_FRAME_INTERVAL_S).abs() > JITTER_NOTED_S).count();
    if off > 0 {
        report
            .notes
            .push(format!("{off} key-frame intervals differ from 0.5 s by more than {JITTER_NOTED_S} s"));
    }
}

/// The agents to keep with their resampled tracks, ego first.
fn collect(
    logged: &LoggedScene,
    clock: &Clock,
    options: &BuildOptions,
    report: &mut SceneReport,
) -> (Vec<Agent>, Vec<Resampled>) {
    let (mut agents, mut tracks) = (Vec::new(), Vec::new());
    let mut keep = |agent: Agent, keys: &[Key], smoothing_s3, report: &mut SceneReport| {
        let times_us: Vec<i64> = keys.iter().map(|key| clock.time_us(key)).collect();
        let track = resample(keys, &times_us, clock.steps, options.interpolation, smoothing_s3);
        report.filled_gaps += track.filled_gaps;
        *report.tracks.entry(agent.category.clone()).or_default() += 1;
        agents.push(agent);
        tracks.push(track);
    };
    if !logged.ego.is_empty() {
        let [length_m, width_m, height_m] = EGO_SIZE_M;
        let (id, category) = (EGO_ID.to_owned(), EGO_CATEGORY.to_owned());
        let ego = Agent { id, kind: AgentKind::Vehicle, category, length_m, width_m, height_m };
        keep(ego, &logged.ego, 0.0, report);
    }
    for track in &logged.tracks {
        match wanted_kind(track, options) {
            Ok(kind) => {
                let [width, length, height] = track.size_m.map(|v| v as Real);
                let (id, category) = (track.instance.clone(), track.category.clone());
                let agent = Agent { id, kind, category, length_m: length, width_m: width, height_m: height };
                report.annotations += track.keys.len();
                keep(agent, &track.keys, ANNOTATION_SMOOTHING_S3, report);
            }
            Err(reason) => report.drop_track(&track.category, reason),
        }
    }
    (agents, tracks)
}

/// The kind of a track that is to be kept, or why it is not.
fn wanted_kind(track: &LoggedTrack, options: &BuildOptions) -> std::result::Result<AgentKind, &'static str> {
    let kind = kind_of_category(&track.category).ok_or("unknown category")?;
    if options.kinds.as_ref().is_some_and(|kinds| !kinds.contains(&kind)) {
        return Err("kind not asked for");
    }
    if track.keys.len() < 2 {
        return Err("fewer than 2 annotations");
    }
    Ok(kind)
}

/// Row-major [A, T] arrays in the scene frame.
fn lay_out(tracks: &[Resampled], origin: [f64; 2], num_steps: usize) -> Tracks {
    let entries = tracks.len() * num_steps;
    let mut out = Tracks {
        position: vec![Point2::origin(); entries],
        heading_rad: vec![0.0; entries],
        velocity: vec![Vector2::zeros(); entries],
        valid: vec![false; entries],
        elevation_m: Vec::new(),
    };
    for (agent_idx, track) in tracks.iter().enumerate() {
        for (step, state) in (track.first_step..).zip(&track.states) {
            let next = track.absences.partition_point(|away| away.end <= step);
            if track.absences.get(next).is_some_and(|away| away.contains(&step)) {
                continue;
            }
            let at = agent_idx * num_steps + step;
            let [x, y] = state.position_m;
            out.position[at] = Point2::new((x - origin[0]) as Real, (y - origin[1]) as Real);
            out.heading_rad[at] = state.heading_rad as Real;
            out.velocity[at] = Vector2::new(state.velocity_mps[0] as Real, state.velocity_mps[1] as Real);
            out.valid[at] = true;
        }
    }
    out
}
