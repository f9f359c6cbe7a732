//! Contacts between agents.
//!
//! A contact is an overlap of two boxes of one level, touching included. Candidates are pairs whose circles touch.

use super::fault::{is_at_fault, is_slower};
use super::limits::STOPPED_MPS;
use crate::geom::{OrientedBox, Real};
use crate::named::named;
use crate::scene::AgentKind;
use crate::simd_dispatch::simd_dispatch;
use crate::state::{AgentStates, Footprint};

/// From this many agents on, whose contacts are asked for, all pairs are looked for.
const JOINT_FROM_AGENTS: usize = 4;
/// Agents tested at once.
const LANES: usize = 8;

named! {
    /// Side of an agent's own box that another agent hits.
    #[derive(Hash)]
    pub enum ContactKind {
        /// The front edge.
        Front = "front",
        /// The rear edge.
        Rear = "rear",
        /// One of the long edges.
        Side = "side",
    }
}

/// A contact as one of its two agents sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Index of the other agent.
    pub partner: u32,
    /// Side of this agent's box with the longest piece inside the partner's box. Where no edge of this box reaches
    /// into the partner (it holds the partner whole), the side that the partner's centre is nearest to.
    pub kind: ContactKind,
    /// Speed at which the two approach along the direction of least overlap, metres per second; negative when they
    /// part.
    pub closing_speed_mps: Real,
    /// Whether this agent is to blame by nuPlan's `no_ego_at_fault_collisions`.
    pub at_fault: bool,
}

impl Contact {
    /// The contact of two touching agents as the first one sees it; whether that one `straddles` lanes is asked where it
    /// matters.
    pub fn between(
        states: &AgentStates,
        footprints: &[Footprint],
        agent_idx: usize,
        partner_idx: usize,
        straddles: impl FnOnce() -> bool,
    ) -> Self {
        let (i, j) = (agent_idx, partner_idx);
        let own = states.oriented_box(i, &footprints[i]);
        let other = states.oriented_box(j, &footprints[j]);
        let stands = [i, j].map(|a| is_slower(states.velocity(a), STOPPED_MPS));
        let closing = (states.velocity(i) - states.velocity(j)).dot(&own.contact_normal(&other));
        Self {
            partner: partner_idx as u32,
            kind: contact_kind(&own, &other, own.edge_lengths_inside(&other)),
            closing_speed_mps: closing,
            at_fault: is_at_fault(&own, &other, stands, straddles),
        }
    }
}

/// Finds the contacts of one world, step after step. Scratch buffers are kept: no allocation after warm-up.
#[derive(Debug, Clone, Default)]
pub struct Collisions {
    pairs: Vec<(u32, u32)>,
    /// Active agents: index, centre and radius, padded by [`LANES`] entries at infinity.
    agent: Vec<u32>,
    x: Vec<Real>,
    y: Vec<Real>,
    radius: Vec<Real>,
    /// 1 for circles that touch one of them.
    near: Vec<u8>,
}

impl Collisions {
    /// Empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Finds all touching pairs of active agents; pairs of two static agents are left out.
    ///
    /// `footprints` and `kinds` are indexed like `states`; agents beyond the shortest of the three are not looked at.
    pub fn find(&mut self, states: &AgentStates, footprints: &[Footprint], kinds: &[AgentKind]) {
        self.pairs.clear();
        self.gather(states, footprints, kinds);
        let num_active = self.agent.len();
        for row in 0..num_active {
            let (first, blocks) = (row + 1, (num_active - row - 1).div_ceil(LANES));
            let columns = first..first + blocks * LANES;
            let circle = [self.x[row], self.y[row], self.radius[row]];
            let near = &mut self.near[..blocks * LANES];
            let circles = [&self.x, &self.y, &self.radius].map(|column| &column[columns.clone()]);
            find_near(circle, &circles, near);
            for (block, near) in near.as_chunks::<LANES>().0.iter().enumerate() {
                let mut left = u64::from_le_bytes(*near);
                while left != 0 {
                    let column = first + block * LANES + left.trailing_zeros() as usize / 8;
                    let (a, b) = (self.agent[row], self.agent[column]);
                    push_if_in_contact(&mut self.pairs, states, footprints, kinds, a, b);
                    left &= left - 1;
                }
            }
        }
    }

    /// The touching pairs of [`Self::find`] that hold one of some active agents; others may be among them.
    pub fn pairs_of(
        &mut self,
        states: &AgentStates,
        footprints: &[Footprint],
        kinds: &[AgentKind],
        agents: &[u32],
    ) -> &[(u32, u32)] {
        if agents.len() >= JOINT_FROM_AGENTS {
            self.find(states, footprints, kinds);
            return &self.pairs;
        }
        self.pairs.clear();
        for &a in agents {
            let (centre, radius_m) = (states.position(a as usize), footprints[a as usize].radius_m);
            for b in 0..states.len().min(footprints.len()).min(kinds.len()) {
                let reach = radius_m + footprints[b].radius_m;
                let near = (states.position(b) - centre).norm_squared() <= reach * reach;
                if states.active[b] && near && b as u32 != a {
                    let (i, j) = (a.min(b as u32), a.max(b as u32));
                    push_if_in_contact(&mut self.pairs, states, footprints, kinds, i, j);
                }
            }
        }
        self.pairs.sort_unstable();
        self.pairs.dedup();
        &self.pairs
    }

    /// Touching pairs (i, j), i < j, ascending.
    pub fn pairs(&self) -> &[(u32, u32)] {
        &self.pairs
    }

    /// Copies the active agents together.
    fn gather(&mut self, states: &AgentStates, footprints: &[Footprint], kinds: &[AgentKind]) {
        self.agent.clear();
        self.x.clear();
        self.y.clear();
        self.radius.clear();
        let num_agents = states.len().min(footprints.len()).min(kinds.len());
        for agent in 0..num_agents {
            if states.active[agent] {
                self.agent.push(agent as u32);
                self.x.push(states.x[agent]);
                self.y.push(states.y[agent]);
                self.radius.push(footprints[agent].radius_m);
            }
        }
        let padded = self.agent.len() + LANES;
        self.x.resize(padded, Real::INFINITY);
        self.y.resize(padded, Real::INFINITY);
        self.radius.resize(padded, 0.0);
        self.near.resize(padded, 0);
    }
}

simd_dispatch! {
    /// Which circles (x, y, radius) touch another one.
    fn find_near(circle: [Real; 3], circles: &[&[Real]; 3], near: &mut [u8]) {
        let n = near.len();
        let [xs, ys, radii] = circles.map(|column| &column[..n]);
        for i in 0..n {
            let (dx, dy, reach) = (xs[i] - circle[0], ys[i] - circle[1], radii[i] + circle[2]);
            near[i] = u8::from(dx * dx + dy * dy <= reach * reach);
        }
    }
}

#[inline]
fn push_if_in_contact(
    pairs: &mut Vec<(u32, u32)>,
    states: &AgentStates,
    footprints: &[Footprint],
    kinds: &[AgentKind],
    a: u32,
    b: u32,
) {
    let (i, j) = (a as usize, b as usize);
    if kinds[i] == AgentKind::Static && kinds[j] == AgentKind::Static {
        return;
    }
    if states.oriented_box(i, &footprints[i]).overlaps(&states.oriented_box(j, &footprints[j]))
        && states.same_level(i, j)
        && !states.hitched(i, j)
    {
        pairs.push((a, b));
    }
}

/// Side with the longest piece in the other box; front wins over rear and rear over the sides on a tie.
fn contact_kind(
    own: &OrientedBox,
    other: &OrientedBox,
    [front, left, rear, right]: [Real; 4],
) -> ContactKind {
    let mut inside = [front, rear, left.max(right)];
    if inside.iter().all(|length_m| *length_m <= 0.0) {
        let offset = other.centre - own.centre;
        let along = (own.cos * offset.x + own.sin * offset.y) / own.half_length_m;
        let across = (own.cos * offset.y - own.sin * offset.x) / own.half_width_m;
        inside = [along, -along, across.abs()];
    }
    let [front, rear, side] = inside;
    if front >= rear && front >= side {
        ContactKind::Front
    } else if rear >= side {
        ContactKind::Rear
    } else {
        ContactKind::Side
    }
}
