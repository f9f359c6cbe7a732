//! What an adversary policy sees of a world: a row for the ego and for each candidate, and matrices between them.

use crate::causal::graph::{CausalGraph, GraphThresholds};
use crate::causal::measures::{AgentFrame, Ttc, normalised_ttc};
use crate::error::{Result, SimError};
use crate::geom::{Pose2, Real, Vector2, math};
use crate::state::{AgentStates, Footprint};
use crate::world::VecWorld;
use serde::Serialize;

/// Distances are 1 at the same place and 0 from here on, metres.
const DISTANCE_M: Real = 50.0;
/// Scaled features are cut off at plus and minus this.
pub const CANDIDATE_BOUND: Real = 5.0;

/// A feature of a row.
#[derive(Clone, Copy, Serialize)]
pub struct CandidateFeature {
    /// Name.
    pub name: &'static str,
    /// Unit; empty for numbers without one.
    pub unit: &'static str,
    /// The feature is divided by this.
    pub scale: Real,
    /// What it is.
    pub doc: &'static str,
    #[serde(skip)]
    of: fn(&Row<'_>) -> Real,
}

/// What features are made from.
struct Row<'a> {
    /// Pose and velocity in the frame of the ego, velocity relative to its own.
    at: Vector2,
    cos_sin: (Real, Real),
    velocity: Vector2,
    state: &'a State,
    footprint: Footprint,
    ttc_s: Real,
    was_adversary: bool,
}

/// State of an agent in the scene frame; zero where it is not there.
#[derive(Clone, Copy)]
struct State {
    pose: Pose2,
    velocity: Vector2,
    speed_mps: Real,
    acceleration_mps2: Real,
}

impl State {
    fn of(states: &AgentStates, a: usize) -> Self {
        if !states.active[a] {
            let pose = Pose2::new(0.0, 0.0, 0.0);
            return Self { pose, velocity: Vector2::new(0.0, 0.0), speed_mps: 0.0, acceleration_mps2: 0.0 };
        }
        Self {
            pose: states.pose(a),
            velocity: states.velocity(a),
            speed_mps: states.speed_mps[a],
            acceleration_mps2: states.acceleration_mps2[a],
        }
    }
}

macro_rules! features {
    ($($name:literal, $unit:literal, $scale:literal, $doc:literal, $of:expr;)+) => {
        /// Features of a row, in order.
        pub const CANDIDATE_FEATURES: &[CandidateFeature] =
            &[$(CandidateFeature { name: $name, unit: $unit, scale: $scale, doc: $doc, of: $of }),+];
    };
}

features! {
    "x", "m", 50.0, "ahead of the ego", |r| r.at.x;
    "y", "m", 50.0, "to the left of the ego", |r| r.at.y;
    "cos_heading", "", 1.0, "cosine of the heading relative to the ego's", |r| r.cos_sin.0;
    "sin_heading", "", 1.0, "sine of it", |r| r.cos_sin.1;
    "velocity_x", "m/s", 15.0, "relative to the ego, in its frame", |r| r.velocity.x;
    "velocity_y", "m/s", 15.0, "relative to the ego, in its frame", |r| r.velocity.y;
    "speed", "m/s", 15.0, "along the agent's own heading", |r| r.state.speed_mps;
    "acceleration", "m/s2", 5.0, "change of speed over the last step", |r| r.state.acceleration_mps2;
    "length", "m", 10.0, "length", |r| 2.0 * r.footprint.half_length_m;
    "width", "m", 5.0, "width", |r| 2.0 * r.footprint.half_width_m;
    "ttc", "", 1.0, "time to contact with the ego: 1 now, 0 in 20 s or never", |r| normalised_ttc(r.ttc_s);
    "was_adversary", "", 1.0, "1 if it was one in the decision before", |r| f32::from(r.was_adversary);
    "present", "", 1.0, "1; rows without an agent are zero", |_| 1.0;
}

/// Rows and matrices of the ego and the candidates, R + 1 = n in all, the ego first. Zero where there is no agent.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateRows {
    /// Features [n, F] over their scales, cut off at [`CANDIDATE_BOUND`].
    pub agents: Vec<Real>,
    /// Times to contact [n, n]: 1 now, 0 in 20 s or never.
    pub ttc: Vec<Real>,
    /// Distances of the centres [n, n]: 1 at the same place, 0 for 50 m or more.
    pub distance: Vec<Real>,
    /// Decision causal graph [n, n].
    pub graph: Vec<Real>,
    /// Attention of the latest plan [n, n], 0 to 1; zero where there is none.
    pub attention: Vec<Real>,
}

impl VecWorld {
    /// What an adversary policy sees: the agents of `rows` behind the first slot's, up to `num_rows` of them; `before` are the
    /// adversaries of the decision before.
    ///
    /// # Errors
    /// As [`VecWorld::status`], and [`SimError::Unknown`] for an agent that does not exist, and for a world whose first slot
    /// is empty; [`SimError::Length`] for too many rows.
    pub fn candidates(
        &self,
        world_idx: usize,
        rows: &[usize],
        before: &[usize],
        num_rows: usize,
    ) -> Result<CandidateRows> {
        let status = self.status(world_idx)?;
        let world = self.world(world_idx)?;
        let num_agents = status.states.len();
        let unknown = |got: String, expected: String| Err(SimError::Unknown { what: "agent", got, expected });
        let Some(ego) = self.slot_agents(world_idx)?.first().copied().flatten() else {
            return unknown("none in the first slot".into(), "an ego".into());
        };
        if let Some(agent) = rows.iter().find(|a| **a >= num_agents) {
            return unknown(agent.to_string(), format!("an index below {num_agents}"));
        }
        if rows.len() > num_rows {
            return Err(SimError::Length { what: "rows", got: rows.len(), expected: num_rows });
        }
        let chosen: Vec<usize> = std::iter::once(ego).chain(rows.iter().copied()).collect();
        let (k, n) = (chosen.len(), num_rows + 1);
        let seen: Vec<State> = chosen.iter().map(|a| State::of(status.states, *a)).collect();
        let footprints: Vec<Footprint> = chosen.iter().map(|a| world.scene.footprints[*a]).collect();
        let (ttc_s, distance_m) = pairs(&seen, &footprints, &status.states.apart(&chosen))?;
        let graph = CausalGraph::from_measures(k, &ttc_s, &distance_m, GraphThresholds::default())?;

        let mut agents = vec![0.0; n * CANDIDATE_FEATURES.len()];
        for (i, out) in agents.chunks_exact_mut(CANDIDATE_FEATURES.len()).take(k).enumerate() {
            let row = Row {
                at: turned(&seen[0].pose, seen[i].pose.position - seen[0].pose.position),
                cos_sin: {
                    let (sin, cos) = math::sin_cos(seen[i].pose.heading_rad - seen[0].pose.heading_rad);
                    (cos, sin)
                },
                velocity: turned(&seen[0].pose, seen[i].velocity - seen[0].velocity),
                state: &seen[i],
                footprint: footprints[i],
                ttc_s: ttc_s[i],
                was_adversary: before.contains(&chosen[i]),
            };
            for (value, feature) in out.iter_mut().zip(CANDIDATE_FEATURES) {
                *value = ((feature.of)(&row) / feature.scale).clamp(-CANDIDATE_BOUND, CANDIDATE_BOUND);
            }
        }
        let matrix = |value: &dyn Fn(usize, usize) -> Real| {
            let entry = |at: usize| match (at / n, at % n) {
                (i, j) if i < k && j < k => value(i, j),
                _ => 0.0,
            };
            (0..n * n).map(entry).collect::<Vec<Real>>()
        };
        Ok(CandidateRows {
            ttc: matrix(&|i, j| normalised_ttc(ttc_s[i * k + j])),
            distance: matrix(&|i, j| 1.0 - distance_m[i * k + j].min(DISTANCE_M) / DISTANCE_M),
            graph: matrix(&|i, j| f32::from(graph.contains(i, j))),
            attention: {
                let attention = self.attention(world_idx, &chosen);
                matrix(&|i, j| attention.get(i * k + j).copied().unwrap_or(0.0))
            },
            agents,
        })
    }

    /// Attention [K, K] between agents in the latest plan of the first policy that plans, 0 to 1; empty without one.
    fn attention(&self, world_idx: usize, agents: &[usize]) -> Vec<Real> {
        let Ok(Some(plan)) = self.explain(world_idx, None) else { return Vec::new() };
        if plan.attention.is_empty() {
            return Vec::new();
        }
        let place: Vec<Option<usize>> =
            agents.iter().map(|a| plan.agents.iter().position(|b| a == b)).collect();
        let entry = &|i: Option<usize>, j: Option<usize>| match (i, j) {
            (Some(i), Some(j)) => plan.attention[i * plan.agents.len() + j].clamp(0.0, 1.0),
            _ => 0.0,
        };
        place.iter().flat_map(|i| place.iter().map(move |j| entry(*i, *j))).collect()
    }
}

/// A vector of the scene in the frame of a pose.
fn turned(pose: &Pose2, v: Vector2) -> Vector2 {
    Vector2::new(v.x * pose.cos + v.y * pose.sin, v.y * pose.cos - v.x * pose.sin)
}

/// Times to contact and distances of all pairs [K, K].
fn pairs(seen: &[State], footprints: &[Footprint], apart: &[bool]) -> Result<(Vec<Real>, Vec<Real>)> {
    let of = |value: &dyn Fn(&State) -> Real| seen.iter().map(value).collect::<Vec<Real>>();
    let size = |value: &dyn Fn(&Footprint) -> Real| footprints.iter().map(value).collect::<Vec<Real>>();
    let heading = of(&|s| s.pose.heading_rad);
    let frame = AgentFrame {
        x_m: &of(&|s| s.pose.position.x),
        y_m: &of(&|s| s.pose.position.y),
        heading_rad: &heading,
        speed_mps: &of(&|s| s.speed_mps),
        length_m: &size(&|b| 2.0 * b.half_length_m),
        width_m: &size(&|b| 2.0 * b.half_width_m),
        valid: &vec![true; seen.len()],
        apart,
    };
    let frame = frame.checked()?;
    let mut ttc_s = vec![0.0; seen.len() * seen.len()];
    let mut distance_m = ttc_s.clone();
    frame.ttc_s(Ttc::Oriented, &heading, &mut ttc_s)?;
    frame.distance_m(&mut distance_m)?;
    Ok((ttc_s, distance_m))
}
