//! Pairwise measures of agents: time to contact (TTC) and distance, as matrices [M, M].
//!
//! Two times to contact: [`Ttc::Oriented`] sweeps oriented boxes at constant velocity and is right for every
//! heading and side; [`Ttc::Released`] repeats the arithmetic of the authors' release (reference.md#pairwise-features), quirks
//! included, for parity with its rankings. Entries of absent agents hold "no contact" (20 s) or an infinite distance.

use crate::error::{Result, check_length};
use crate::geom::{OrientedBox, Pose2, Real, Vector2, math};

/// Times to contact are capped here, seconds (reference.md#pairwise-features).
pub const TTC_CAP_S: Real = 20.0;
/// Distances beyond this are 0 in the normalised form, metres (reference.md#pairwise-features).
pub const DISTANCE_CAP_M: Real = 20.0;

/// Which time to contact.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Ttc {
    /// First contact of the oriented boxes, each moving on at its velocity. Symmetric.
    #[default]
    Oriented,
    /// The released recipe: axis-aligned extents and unsigned offsets in the frame of the row's agent.
    /// Directional, and right only for pairs in front of and to the left of the row's agent.
    Released,
}

/// Agents at one step: arrays of length M in one frame.
#[derive(Debug, Clone, Copy)]
pub struct AgentFrame<'a> {
    /// Centres, metres.
    pub x_m: &'a [Real],
    /// Centres, metres.
    pub y_m: &'a [Real],
    /// Headings, radians.
    pub heading_rad: &'a [Real],
    /// Speeds along the heading, negative when reversing, m/s.
    pub speed_mps: &'a [Real],
    /// Lengths, metres.
    pub length_m: &'a [Real],
    /// Widths, metres.
    pub width_m: &'a [Real],
    /// Who is there.
    pub valid: &'a [bool],
    /// Pairs [M, M] on different levels, between which there is neither contact nor distance; empty: none.
    pub apart: &'a [bool],
}

impl AgentFrame<'_> {
    /// The same, of arrays of one length.
    ///
    /// # Errors
    /// [`crate::SimError::Length`] where an array's length differs from `x_m`'s.
    pub fn checked(self) -> Result<Self> {
        self.check(self.x_m.len(), self.x_m.len())?;
        Ok(self)
    }

    fn check(&self, num_agents: usize, num_states: usize) -> Result<()> {
        let pairs = if self.apart.is_empty() { 0 } else { num_agents * num_agents };
        for (what, got, expected) in [
            ("y of the agents", self.y_m.len(), num_states),
            ("heading of the agents", self.heading_rad.len(), num_states),
            ("speed of the agents", self.speed_mps.len(), num_states),
            ("validity of the agents", self.valid.len(), num_states),
            ("length of the agents", self.length_m.len(), num_agents),
            ("width of the agents", self.width_m.len(), num_agents),
            ("levels of the agents", self.apart.len(), pairs),
        ] {
            check_length(what, got, expected)?;
        }
        Ok(())
    }

    /// Writes what holds of pairs on different levels into a matrix [M, M].
    fn part_levels(&self, none: Real, out: &mut [Real]) {
        out.iter_mut().zip(self.apart).filter(|(_, apart)| **apart).for_each(|(v, _)| *v = none);
    }

    /// Number of agents M.
    pub fn num_agents(&self) -> usize {
        self.x_m.len()
    }

    /// Whether an agent is there.
    pub fn is_valid(&self, agent_idx: usize) -> bool {
        self.valid.get(agent_idx).copied().unwrap_or(false)
    }

    fn box_and_velocity(&self, i: usize) -> (OrientedBox, Vector2) {
        let pose = Pose2::new(self.x_m[i], self.y_m[i], self.heading_rad[i]);
        let oriented_box = OrientedBox {
            centre: pose.position,
            cos: pose.cos,
            sin: pose.sin,
            half_length_m: 0.5 * self.length_m[i],
            half_width_m: 0.5 * self.width_m[i],
        };
        (oriented_box, pose.rotate(Vector2::new(self.speed_mps[i], 0.0)))
    }

    /// Writes the times to contact of all pairs, seconds in [0, 20], into `out` [M, M].
    ///
    /// `frame_heading_rad` [M] turns the released recipe's axes: the heading of each row's agent at the step the
    /// features belong to, which for a history is its last step, not the step of this frame.
    ///
    /// # Errors
    /// [`crate::SimError::Length`] where `frame_heading_rad` or `out` do not fit M.
    pub fn ttc_s(&self, ttc: Ttc, frame_heading_rad: &[Real], out: &mut [Real]) -> Result<()> {
        let num_agents = self.num_agents();
        check_length("frame headings", frame_heading_rad.len(), num_agents)?;
        check_length("TTC matrix", out.len(), num_agents * num_agents)?;
        match ttc {
            Ttc::Oriented => self.ttc_oriented_s(out),
            Ttc::Released => self.ttc_released_s(frame_heading_rad, out),
        }
        Ok(())
    }

    fn ttc_oriented_s(&self, out: &mut [Real]) {
        let num_agents = self.num_agents();
        out.fill(TTC_CAP_S);
        let moving: Vec<(OrientedBox, Vector2)> = (0..num_agents).map(|i| self.box_and_velocity(i)).collect();
        for i in (0..num_agents).filter(|&i| self.valid[i]) {
            out[i * num_agents + i] = 0.0;
            for j in (i + 1..num_agents).filter(|&j| self.valid[j]) {
                let ((one, one_velocity), (other, other_velocity)) = (&moving[i], &moving[j]);
                let t_s = one
                    .time_to_contact(*one_velocity, other, *other_velocity, TTC_CAP_S)
                    .unwrap_or(TTC_CAP_S);
                out[i * num_agents + j] = t_s;
                out[j * num_agents + i] = t_s;
            }
        }
        self.part_levels(TTC_CAP_S, out);
    }

    fn ttc_released_s(&self, frame_heading_rad: &[Real], out: &mut [Real]) {
        let num_agents = self.num_agents();
        out.fill(TTC_CAP_S);
        for i in (0..num_agents).filter(|&i| self.valid[i]) {
            let (frame_sin, frame_cos) = math::sin_cos(frame_heading_rad[i]);
            let local_velocity = |a: usize| {
                let (sin, cos) = math::sin_cos(self.heading_rad[a] - frame_heading_rad[i]);
                let speed_mps = self.speed_mps[a].abs();
                (speed_mps * cos, speed_mps * sin)
            };
            let (own_vx, own_vy) = local_velocity(i);
            for j in (0..num_agents).filter(|&j| self.valid[j]) {
                let (dx, dy) = (self.x_m[j] - self.x_m[i], self.y_m[j] - self.y_m[i]);
                let (vx, vy) = local_velocity(j);
                let gap_x =
                    (frame_cos * dx + frame_sin * dy).abs() - 0.5 * (self.length_m[i] + self.length_m[j]);
                let gap_y =
                    (frame_cos * dy - frame_sin * dx).abs() - 0.5 * (self.width_m[i] + self.width_m[j]);
                let t_s = axis_time_s(gap_x, own_vx - vx).max(axis_time_s(gap_y, own_vy - vy));
                out[i * num_agents + j] = t_s.clamp(0.0, TTC_CAP_S);
            }
        }
        self.part_levels(TTC_CAP_S, out);
    }

    /// Writes the distances of the centres, metres, into `out` [M, M]; infinite where an agent is absent.
    ///
    /// # Errors
    /// [`crate::SimError::Length`] where `out` does not hold M * M entries.
    pub fn distance_m(&self, out: &mut [Real]) -> Result<()> {
        let num_agents = self.num_agents();
        check_length("pair matrix", out.len(), num_agents * num_agents)?;
        for i in 0..num_agents {
            for j in 0..num_agents {
                let both = self.valid[i] && self.valid[j];
                let apart_m = || math::hypot(self.x_m[i] - self.x_m[j], self.y_m[i] - self.y_m[j]);
                out[i * num_agents + j] = if both { apart_m() } else { Real::INFINITY };
            }
        }
        self.part_levels(Real::INFINITY, out);
        Ok(())
    }
}

/// Time to contact along one axis as the release computes it: 20 s when the gap opens, 0 inside the gap.
fn axis_time_s(gap_m: Real, closing_mps: Real) -> Real {
    if gap_m <= 0.0 {
        return 0.0;
    }
    let t_s = gap_m / closing_mps;
    if t_s >= 0.0 { t_s } else { TTC_CAP_S }
}

/// 1 for contact now, 0 for contact in 20 s or later.
pub fn normalised_ttc(ttc_s: Real) -> Real {
    (TTC_CAP_S - ttc_s.clamp(0.0, TTC_CAP_S)) / TTC_CAP_S
}

/// 1 at distance 0, 0 at 20 m or beyond.
pub fn normalised_distance(distance_m: Real) -> Real {
    (DISTANCE_CAP_M - distance_m.clamp(0.0, DISTANCE_CAP_M)) / DISTANCE_CAP_M
}

/// Agents over T steps, oldest first: arrays [T, M], sizes [M], units as in [`AgentFrame`].
#[derive(Debug, Clone, Copy)]
pub struct AgentHistory<'a>(AgentFrame<'a>);

impl<'a> AgentHistory<'a> {
    /// A view of T * M states and M sizes.
    ///
    /// # Errors
    /// [`crate::SimError::Length`] where the arrays do not agree on T and M.
    pub fn new(all: AgentFrame<'a>) -> Result<Self> {
        let (num_agents, total) = (all.length_m.len(), all.x_m.len());
        check_length("x of the history", if num_agents == 0 { total } else { total % num_agents }, 0)?;
        all.check(num_agents, total)?;
        Ok(Self(all))
    }

    /// Number of agents M.
    pub fn num_agents(&self) -> usize {
        self.0.length_m.len()
    }

    /// Number of steps T.
    pub fn num_steps(&self) -> usize {
        self.0.x_m.len().checked_div(self.num_agents()).unwrap_or(0)
    }

    /// The frames, oldest first.
    pub fn frames(&self) -> impl Iterator<Item = AgentFrame<'a>> + '_ {
        let (all, num_agents) = (self.0, self.num_agents());
        (0..self.num_steps()).map(move |t| {
            let row = t * num_agents..(t + 1) * num_agents;
            AgentFrame {
                x_m: &all.x_m[row.clone()],
                y_m: &all.y_m[row.clone()],
                heading_rad: &all.heading_rad[row.clone()],
                speed_mps: &all.speed_mps[row.clone()],
                length_m: all.length_m,
                width_m: all.width_m,
                valid: &all.valid[row],
                apart: all.apart,
            }
        })
    }

    /// Times to contact [T, M, M], seconds. The released recipe sees every step in the axes of the last one.
    pub fn ttc_s(&self, ttc: Ttc) -> Vec<Real> {
        let pairs = self.num_agents() * self.num_agents();
        let mut out = vec![TTC_CAP_S; self.num_steps() * pairs];
        if pairs > 0 {
            let last_heading_rad = &self.0.heading_rad[self.0.heading_rad.len() - self.num_agents()..];
            for (frame, matrix) in self.frames().zip(out.chunks_exact_mut(pairs)) {
                match ttc {
                    Ttc::Oriented => frame.ttc_oriented_s(matrix),
                    Ttc::Released => frame.ttc_released_s(last_heading_rad, matrix),
                }
            }
        }
        out
    }

    /// Distances of the centres [T, M, M], metres.
    ///
    /// # Errors
    /// None for a view that [`AgentHistory::new`] accepted.
    pub fn distance_m(&self) -> Result<Vec<Real>> {
        let pairs = self.num_agents() * self.num_agents();
        let mut out = vec![Real::INFINITY; self.num_steps() * pairs];
        if pairs > 0 {
            for (frame, matrix) in self.frames().zip(out.chunks_exact_mut(pairs)) {
                frame.distance_m(matrix)?;
            }
        }
        Ok(out)
    }
}
