//! Repairs of a recorded log before it is played: short gaps are filled, boxes annotated backwards are turned, velocities
//! that contradict the positions are made from these.

use super::{AgentKind, Scene, Tracks};
use crate::geom::{Real, Vector2, math};
use std::f32::consts::PI;

/// Longest time from the last state before a gap to the first after it, seconds: two seconds of steps, or three key frames
/// of nuScenes.
pub const LONGEST_GAP_S: Real = 2.15;
/// A track that is faster than this at a gap, or goes through it faster, is no track to go on with, m/s.
const FASTEST_MPS: Real = 100.0;

/// A box that turns farther than this in a step is annotated the other way round from there on, radians.
const FLIP_RAD: Real = 0.75 * PI;
/// Directions are compared this often, seconds.
const LOOK_S: Real = 0.5;
/// Slower motion says nothing about where a vehicle's front is, m/s.
const SLOWEST_MPS: Real = 1.0;
/// Faster than vehicles reverse, m/s.
const FAST_MPS: Real = 3.0;
/// Cosine between the velocity and the heading from which on a vehicle goes ahead, and below minus which backwards.
const ALONG: Real = 0.8;
/// A box is turned, or noted, where it runs at least this far against its heading, or across it, metres,
const LEAST_ODD_M: Real = 10.0;
/// for this share of its way,
const LEAST_ODD_SHARE: Real = 0.8;
/// and fast for as long as this, seconds. Of 4,707 vehicles of nuScenes none that reverses does so as fast.
const LEAST_FAST_S: Real = 1.0;

/// Velocities that differ from the change of place by more than the first for as long as the second contradict it: m/s, s.
const CONTRADICTING_MPS: Real = 2.0;
const CONTRADICTING_S: Real = 1.0;

/// Vehicles wider than this and wider than long are noted, metres.
const WIDEST_M: Real = 2.6;

/// What was done to a scene, or could not be.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Mended {
    /// Gaps inside tracks that were filled.
    pub filled_gaps: usize,
    /// Gaps that are too long: the agent is away meanwhile.
    pub absences: usize,
    /// Agents whose heading was turned by half a turn.
    pub turned: Vec<usize>,
    /// In words, without the gaps.
    pub notes: Vec<String>,
}

impl Scene {
    /// Fills gaps of up to two seconds and turns boxes that were annotated backwards, all along or in a part of a track;
    /// velocities that contradict the positions for a second become the change of place, all along the track.
    pub fn mend(&mut self) -> Mended {
        let mut mended = Mended::default();
        for agent in 0..self.agents.len() {
            mended.notes.extend(self.undo_flips(agent));
            mended.notes.extend(self.mend_velocities(agent));
            self.fill_gaps(agent, &mut mended);
            let [back, across] = self.runs_oddly(agent);
            if back {
                self.turn(agent);
                mended.turned.push(agent);
            }
            mended.notes.extend(across.then(|| {
                format!("{} runs across its heading: degrees, or axes turned?", self.agents[agent].id)
            }));
            mended.notes.extend(self.odd_size(agent));
        }
        let turned = mended.turned.iter().map(|agent| &self.agents[*agent].id);
        mended.notes.extend(turned.map(|id| format!("{id} runs against its heading, which was turned by π")));
        mended
    }

    /// Turns the parts of a track in which its box is the other way round: those of fewer steps in all.
    fn undo_flips(&mut self, agent: usize) -> Option<String> {
        if self.agents[agent].kind == AgentKind::Pedestrian {
            return None;
        }
        let steps = self.at(agent, 0)..self.at(agent + 1, 0);
        let (mut flipped, mut is_flipped) = (vec![false; steps.len()], false);
        let flips = |at: usize, tracks: &Tracks| {
            let turn_rad = math::wrap_angle(tracks.heading_rad[at] - tracks.heading_rad[at - 1]);
            tracks.valid[at - 1] && tracks.valid[at] && turn_rad.abs() > FLIP_RAD
        };
        for at in steps.clone().skip(1) {
            is_flipped ^= flips(at, &self.tracks);
            flipped[at - steps.start] = is_flipped;
        }
        let there = |at: &usize| self.tracks.valid[*at];
        let turned: Vec<usize> = steps.clone().filter(|at| flipped[at - steps.start]).filter(there).collect();
        if turned.is_empty() {
            return None;
        }
        let most = 2 * turned.len() > steps.clone().filter(there).count();
        let odd: Vec<usize> =
            steps.clone().filter(there).filter(|at| flipped[at - steps.start] != most).collect();
        for at in &odd {
            let heading_rad = &mut self.tracks.heading_rad[*at];
            *heading_rad = math::wrap_angle(*heading_rad + PI);
        }
        Some(format!(
            "{} is the other way round for {} steps, which were turned by π",
            self.agents[agent].id,
            odd.len()
        ))
    }

    fn mend_velocities(&mut self, agent: usize) -> Option<String> {
        let steps = self.at(agent, 0)..self.at(agent + 1, 0);
        let tracks = &self.tracks;
        let change = |at: usize| {
            let near = |k: usize| steps.contains(&k) && tracks.valid[k];
            let from = if near(at.wrapping_sub(1)) { at - 1 } else { at };
            let to = if near(at + 1) { at + 1 } else { at };
            let time_s = (to - from) as Real * self.dt_s;
            let change = (tracks.position[to] - tracks.position[from]) / time_s;
            (tracks.valid[at] && to > from && change.norm() <= FASTEST_MPS).then_some(change)
        };
        let mut contradicting = 0;
        let contradicts = |at: usize| {
            let is_off = |change: Vector2| (tracks.velocity[at] - change).norm() > CONTRADICTING_MPS;
            contradicting = if change(at).is_some_and(is_off) { contradicting + 1 } else { 0 };
            contradicting as Real * self.dt_s >= CONTRADICTING_S
        };
        if !steps.clone().any(contradicts) {
            return None;
        }
        let changes: Vec<_> = steps.clone().map(change).collect();
        for (at, change) in steps.zip(changes) {
            self.tracks.velocity[at] = change.unwrap_or(self.tracks.velocity[at]);
        }
        let id = &self.agents[agent].id;
        Some(format!("the velocities of {id} contradict its positions and were replaced by their change"))
    }

    fn fill_gaps(&mut self, agent: usize, mended: &mut Mended) {
        let (start, end) = (self.at(agent, 0), self.at(agent + 1, 0));
        let next = |scene: &Self, from: usize, wanted: bool| {
            scene.tracks.valid[from..end].iter().position(|valid| *valid == wanted).map(|i| from + i)
        };
        let mut at = next(self, start, true);
        while let Some(gap) = at.and_then(|at| next(self, at, false)) {
            at = next(self, gap, true);
            match at {
                Some(after) if self.fill(gap - 1, after) => mended.filled_gaps += 1,
                Some(_) => mended.absences += 1,
                None => {}
            }
        }
    }

    /// Fills the entries between two of a track by the cubic with the velocities of both ends, headings evenly.
    fn fill(&mut self, before: usize, after: usize) -> bool {
        let tracks = &mut self.tracks;
        let time_s = (after - before) as Real * self.dt_s;
        let (start, end) = (tracks.position[before], tracks.position[after]);
        let (first, last) = (tracks.velocity[before], tracks.velocity[after]);
        let mean = (end - start) / time_s;
        if time_s > LONGEST_GAP_S || [first, last, mean].iter().any(|v| v.norm() > FASTEST_MPS) {
            return false;
        }
        let heading_rad = tracks.heading_rad[before];
        let turn_rad = math::wrap_angle(tracks.heading_rad[after] - heading_rad);
        // how far the ends' velocities miss the way between them
        let missed = mean - (first + last) * 0.5;
        for at in before + 1..after {
            let u = (at - before) as Real / (after - before) as Real;
            let way = first * (u - 0.5 * u * u) + last * (0.5 * u * u) + missed * (u * u * (3.0 - 2.0 * u));
            tracks.position[at] = start + way * time_s;
            tracks.velocity[at] = first + (last - first) * u + missed * (6.0 * u * (1.0 - u));
            tracks.heading_rad[at] = heading_rad + turn_rad * u;
            if !tracks.elevation_m.is_empty() {
                let (low, high) = (tracks.elevation_m[before], tracks.elevation_m[after]);
                tracks.elevation_m[at] = low + (high - low) * u;
            }
            tracks.valid[at] = true;
        }
        true
    }

    /// Whether most of a vehicle's way runs against its heading, farther and faster than vehicles reverse, and whether across it.
    fn runs_oddly(&self, agent: usize) -> [bool; 2] {
        if matches!(self.agents[agent].kind, AgentKind::Pedestrian | AgentKind::Static) {
            return [false; 2];
        }
        let (mut ahead_m, mut back, mut across) = (0.0, [0.0; 2], [0.0; 2]);
        let stride = (LOOK_S / self.dt_s).round().max(1.0);
        let look_s = stride * self.dt_s;
        for at in (self.at(agent, 0)..self.at(agent + 1, 0)).step_by(stride as usize) {
            let velocity = self.tracks.velocity[at];
            let speed_mps = velocity.norm();
            if !(self.tracks.valid[at] && (SLOWEST_MPS..FASTEST_MPS).contains(&speed_mps)) {
                continue;
            }
            let (sin, cos) = math::sin_cos(self.tracks.heading_rad[at]);
            let along = velocity.dot(&Vector2::new(cos, sin)) / speed_mps;
            let way_m = speed_mps * look_s;
            if along > ALONG {
                ahead_m += way_m;
                continue;
            }
            let [odd_m, fast_s] = if along < -ALONG { &mut back } else { &mut across };
            *odd_m += way_m;
            *fast_s += if speed_mps > FAST_MPS { look_s } else { 0.0 };
        }
        let is_odd = |[odd_m, fast_s]: [Real; 2], other_m: Real| {
            odd_m >= LEAST_ODD_M && odd_m >= LEAST_ODD_SHARE * (odd_m + other_m) && fast_s >= LEAST_FAST_S
        };
        [is_odd(back, ahead_m), is_odd(across, ahead_m + back[0])]
    }

    fn turn(&mut self, agent: usize) {
        let steps = self.at(agent, 0)..self.at(agent + 1, 0);
        let first = steps.clone().find(|at| self.tracks.valid[*at]);
        let turn_rad = if first.is_some_and(|at| self.tracks.heading_rad[at] > 0.0) { -PI } else { PI };
        for at in steps.filter(|at| self.tracks.valid[*at]).collect::<Vec<_>>() {
            self.tracks.heading_rad[at] += turn_rad;
        }
    }

    fn odd_size(&self, agent: usize) -> Option<String> {
        let found = &self.agents[agent];
        let odd = found.kind == AgentKind::Vehicle && found.width_m > found.length_m.max(WIDEST_M);
        odd.then(|| {
            format!(
                "{} is {:.2} m wide and {:.2} m long: sides swapped?",
                found.id, found.width_m, found.length_m
            )
        })
    }
}
