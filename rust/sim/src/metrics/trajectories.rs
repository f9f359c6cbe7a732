//! One recorded scene, its contacts, ways off the road and surrogate safety measures.

use crate::causal::measures::TTC_CAP_S;
use crate::error::{Result, SimError, check_length};
use crate::events::{Collisions, Contact, ContactKind, OffRoad, off_road};
use crate::geom::{Pose2, Real, Region, Vector2};
use crate::scene::{AgentKind, Map};
use crate::state::{AgentStates, Footprint, Height};
use std::collections::BTreeMap;

/// Slopes are told of steps of this length at least, metres, and are at most so steep.
const LEAST_WAY_M: Real = 0.2;
const STEEPEST: Real = 0.3;
/// Roads of levels are made for elevations this far apart, metres.
const SLOT_M: Real = 0.5;

/// States of A agents over T steps.
#[derive(Debug, Clone)]
pub struct Trajectories {
    pub(super) dt_s: Real,
    footprints: Vec<Footprint>,
    /// [T].
    pub(super) states: Vec<AgentStates>,
}

impl Trajectories {
    /// The states of x, y (metres) and heading (radians), each row-major [A, T]; where `valid` [A, T] is false they mean
    /// nothing. `elevation_m` [A, T] is that of the ground below the agents, which parts levels; empty in a flat scene. A footprints.
    ///
    /// Velocities are taken from the step before, or to the step after where the agent was absent before; they are zero
    /// where both are missing.
    ///
    /// # Errors
    /// [`SimError::Length`] where the arrays do not agree, [`SimError::Config`] for a time step that is not positive
    /// or a valid state that is not finite.
    pub fn new(
        dt_s: Real,
        columns: [&[Real]; 3],
        elevation_m: &[Real],
        valid: &[bool],
        footprints: Vec<Footprint>,
    ) -> Result<Self> {
        let [x_m, y_m, heading_rad] = columns;
        let num_steps = valid.len().checked_div(footprints.len()).unwrap_or(0);
        let entries = num_steps * footprints.len();
        let elevations = if elevation_m.is_empty() { entries } else { elevation_m.len() };
        for (what, got) in [
            ("validity", valid.len()),
            ("x", x_m.len()),
            ("y", y_m.len()),
            ("heading", heading_rad.len()),
            ("elevations", elevations),
        ] {
            check_length(what, got, entries)?;
        }
        if !(dt_s.is_finite() && dt_s > 0.0) {
            return Err(SimError::config("dt_s", dt_s, "a positive number of seconds"));
        }
        let numbers = |k: usize| columns.iter().chain([&elevation_m]).filter_map(move |column| column.get(k));
        if let Some(k) = (0..entries).find(|k| valid[*k] && !numbers(*k).all(|x| x.is_finite())) {
            let got =
                format!("a state that is not finite at agent {}, step {}", k / num_steps, k % num_steps);
            return Err(SimError::config("motion", got, "finite states wherever an agent is valid"));
        }
        let heights = if elevation_m.is_empty() { 0 } else { footprints.len() };
        let mut states = vec![AgentStates::new(footprints.len()); num_steps];
        for (k, _) in valid.iter().enumerate().filter(|(_, valid)| **valid) {
            let (agent, t) = (k / num_steps, k % num_steps);
            let was_there = t > 0 && valid[k - 1];
            let is_there_next = t + 1 < num_steps && valid[k + 1];
            let change = |column: &[Real]| match (was_there, is_there_next) {
                (true, _) => column[k] - column[k - 1],
                (false, true) => column[k + 1] - column[k],
                (false, false) => 0.0,
            };
            let pose = Pose2::new(x_m[k], y_m[k], heading_rad[k]);
            let velocity = Vector2::new(change(x_m), change(y_m)) / dt_s;
            let now = &mut states[t];
            now.active[agent] = true;
            now.set_pose(agent, pose, velocity);
            now.heights.resize(heights, Height::default());
            if let Some(height) = now.heights.get_mut(agent) {
                let way = velocity * dt_s;
                let ahead_m = way.x * pose.cos + way.y * pose.sin;
                let grade = if ahead_m.abs() < LEAST_WAY_M { 0.0 } else { change(elevation_m) / ahead_m };
                let grade = grade.clamp(-STEEPEST, STEEPEST);
                *height = Height { elevation_m: elevation_m[k], grade };
            }
        }
        Ok(Self { dt_s, footprints, states })
    }

    /// Number of agents A.
    pub fn num_agents(&self) -> usize {
        self.footprints.len()
    }

    /// Number of steps T.
    pub fn num_steps(&self) -> usize {
        self.states.len()
    }

    /// All contacts: step and the two agents, the smaller index first, in this order; the speed of each of the two towards the
    /// other along the direction in which they overlap least, m/s; and the side on which every agent is hit at its first contact.
    ///
    /// # Reference
    /// reference.md#collisions.
    #[expect(clippy::type_complexity, reason = "two lists, told above")]
    pub fn contacts(&self) -> (Vec<([u32; 3], [Real; 2])>, Vec<Option<ContactKind>>) {
        let kinds = vec![AgentKind::Vehicle; self.num_agents()];
        let mut found = Collisions::new();
        let (mut contacts, mut first_kind) = (Vec::new(), vec![None; self.num_agents()]);
        for (step_idx, states) in self.states.iter().enumerate() {
            found.find(states, &self.footprints, &kinds);
            for &(a, b) in found.pairs() {
                for (agent, partner) in [(a as usize, b as usize), (b as usize, a as usize)] {
                    let kind = || Contact::between(states, &self.footprints, agent, partner, || false).kind;
                    first_kind[agent].get_or_insert_with(kind);
                }
                let (one, other) = (a.min(b) as usize, a.max(b) as usize);
                let body = |agent: usize| states.oriented_box(agent, &self.footprints[agent]);
                let normal = body(one).contact_normal(&body(other));
                let approach_mps = [states.velocity(one).dot(&normal), -states.velocity(other).dot(&normal)];
                contacts.push(([step_idx as u32, one as u32, other as u32], approach_mps));
            }
        }
        contacts.sort_unstable_by_key(|(row, _)| *row);
        (contacts, first_kind)
    }

    /// Agents off the drivable area of a map: flags [A, T], false where the agent is absent. `None` where the area has no
    /// polygon of three finite points. Agents with an elevation are on the road of their own level, where the map has levels.
    ///
    /// Differs from the release: polygons of the map in place of pixels of a raster that is clamped at its border.
    pub fn off_road(&self, map: &Map) -> Option<Vec<OffRoad>> {
        let mut roads = BTreeMap::from([(None, Some(Region::new(&map.drivable_area)?))]);
        let has_levels = map.elevation_m.drivable_area.len() == map.drivable_area.len();
        let slot = |elevation_m: Real| (elevation_m / SLOT_M).floor() as i64;
        let num_steps = self.num_steps();
        let mut flags = vec![OffRoad::default(); self.num_agents() * num_steps];
        for (step_idx, states) in self.states.iter().enumerate() {
            for agent in (0..self.num_agents()).filter(|a| states.active[*a]) {
                let level = states.elevation_m(agent).filter(|_| has_levels).map(slot);
                let road = roads.entry(level).or_insert_with(|| {
                    let elevation_m = (level.unwrap_or_default() as Real + 0.5) * SLOT_M;
                    Region::new(&map.on_level(elevation_m).drivable_area)
                });
                flags[agent * num_steps + step_idx] = match road {
                    Some(road) => off_road(states, agent, &self.footprints[agent], road),
                    None => OffRoad { corner: true, centroid: true },
                };
            }
        }
        Some(flags)
    }

    /// Least time to contact of every agent with any other over all steps, seconds, capped at 20.
    ///
    /// Boxes move on at the velocity of their last step. 0 from the first contact on; 20 for agents without any contact.
    pub fn min_ttc_s(&self) -> Vec<Real> {
        let mut least = vec![TTC_CAP_S; self.num_agents()];
        for states in &self.states {
            let moving: Vec<_> = (0..self.num_agents())
                .filter(|a| states.active[*a])
                .map(|a| (a, states.oriented_box(a, &self.footprints[a]), states.velocity(a)))
                .collect();
            for (k, (a, box_a, velocity_a)) in moving.iter().enumerate() {
                for (b, box_b, velocity_b) in moving[..k].iter().filter(|(b, ..)| states.same_level(*a, *b)) {
                    // contact later than both know of already is of no interest
                    let horizon_s = least[*a].max(least[*b]);
                    if let Some(t_s) = box_a.time_to_contact(*velocity_a, box_b, *velocity_b, horizon_s) {
                        least[*a] = least[*a].min(t_s);
                        least[*b] = least[*b].min(t_s);
                    }
                }
            }
        }
        least
    }

    /// Whether every agent drives faster than a limit for at least `at_least_s` without a break.
    ///
    /// The scene over-speed rate (SOR) is the share of scenes in which a controlled agent does.
    ///
    /// Differs from the paper: it names the rate without a definition; this one is of reference.md#over-speed-rate.
    pub fn over_speed(&self, limit_mps: Real, at_least_s: Real) -> Vec<bool> {
        let needed = (at_least_s / self.dt_s).round().max(1.0) as usize;
        let of_agent = |agent: usize| {
            let is_fast =
                |states: &AgentStates| states.active[agent] && states.velocity(agent).norm() > limit_mps;
            self.states
                .chunk_by(|a, b| is_fast(a) && is_fast(b))
                .any(|run| run.len() >= needed && is_fast(&run[0]))
        };
        (0..self.num_agents()).map(of_agent).collect()
    }
}
