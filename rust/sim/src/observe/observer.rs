//! Writing observation rows.

use crate::events::time_to_contact;
use crate::geom::{Polyline, Pose2, Real, math};
use crate::observe::layout::{AGENT, EGO, Layout, MAP, TTC_SCALE_S};
use crate::observe::map_pieces::MapPieces;
use crate::scene::AgentKind;
use crate::state::{AgentStates, Body};

/// What the world knows about the observing agent beside its state.
#[derive(Debug, Clone, Copy)]
pub struct EgoFacts {
    /// First two columns of the last normalised action.
    pub last_action: [Real; 2],
    /// Speed limit, m/s.
    pub speed_limit_mps: Real,
    /// Distance to the nearest lane centre, metres, where a lane is near.
    pub lane_distance_m: Option<Real>,
    /// Signed distance from the route, left positive, metres.
    pub lateral_m: Real,
    /// Heading against the route, radians.
    pub heading_error_rad: Real,
    /// A corner is off the road.
    pub off_road: bool,
    /// Touches another agent.
    pub collided: bool,
    /// Distance along the route to the goal, metres.
    pub route_remaining_m: Real,
    /// Share of the episode that is left.
    pub time_remaining: Real,
}

/// Everything an observation is made from.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// States of all agents.
    pub states: &'a AgentStates,
    /// Their bodies.
    pub bodies: &'a [Body],
    /// Their kinds.
    pub kinds: &'a [AgentKind],
    /// The map.
    pub pieces: &'a MapPieces,
    /// Route of the observing agent.
    pub route: &'a Polyline,
    /// Its position along the route, metres.
    pub route_s_m: Real,
    /// The observing agent.
    pub agent_idx: usize,
    /// Facts about it.
    pub facts: EgoFacts,
}

/// Writes rows of one layout; holds the memory that it works in.
#[derive(Debug, Clone)]
pub struct Observer {
    layout: Layout,
    /// (squared distance, agent) of agents in sight, sortable as numbers.
    near: Vec<u64>,
    /// Map rows before their columns are chosen, structure of arrays.
    map: [Vec<Real>; 4],
    wants_ttc: bool,
}

/// Index of `ttc` among the agent columns.
const TTC_COLUMN: usize = 10;
/// Index of the first kind among the agent columns, and among the map columns.
const AGENT_KINDS: usize = 11;
const MAP_KINDS: usize = 5;

impl Observer {
    /// Observer for scenes of up to `max_agents` agents.
    pub fn new(layout: Layout, max_agents: usize) -> Self {
        let n = layout.config.num_map_pieces;
        let wants_ttc = layout.chosen[1].contains(&TTC_COLUMN);
        Self {
            near: Vec::with_capacity(max_agents),
            map: std::array::from_fn(|_| vec![0.0; n]),
            wants_ttc,
            layout,
        }
    }

    /// Writes the row of one agent: `layout.size` floats.
    pub fn write(&mut self, view: &View<'_>, out: &mut [Real]) {
        let ego = view.states.pose(view.agent_idx);
        let c = &self.layout.config;
        let masks = usize::from(c.masks);
        let (ego_len, rest) = (self.layout.chosen[0].len(), out);
        let (out, rest) = rest.split_at_mut(ego_len);
        self.write_ego(view, out);
        let (out, rest) = rest.split_at_mut(c.num_route_points * 4);
        let (mask, rest) = rest.split_at_mut(c.num_route_points * masks);
        self.write_route(view, &ego, out, mask);
        let (k, agent_width) = (c.num_agents, self.layout.chosen[1].len());
        // a group without columns has no mask either
        let (out, rest) = rest.split_at_mut(k * agent_width);
        let (mask, rest) = rest.split_at_mut(if agent_width == 0 { 0 } else { k * masks });
        let (n, map_width) = (c.num_map_pieces, self.layout.chosen[2].len());
        self.write_agents(view, &ego, out, mask);
        let (out, mask) = rest.split_at_mut(n * map_width);
        self.write_map(view, &ego, out, mask);
    }

    fn write_ego(&self, view: &View<'_>, out: &mut [Real]) {
        let (states, a, facts) = (view.states, view.agent_idx, &view.facts);
        let flag = |b: bool| if b { 1.0 } else { 0.0 };
        let (sin, cos) = math::sin_cos(facts.heading_error_rad);
        let full: [Real; EGO.len()] = [
            states.speed_mps[a],
            states.acceleration_mps2[a],
            states.yaw_rate_radps[a],
            2.0 * view.bodies[a].half_length_m,
            2.0 * view.bodies[a].half_width_m,
            facts.last_action[0],
            facts.last_action[1],
            facts.speed_limit_mps,
            facts.lateral_m,
            sin,
            cos,
            flag(facts.lane_distance_m.is_some()),
            facts.lane_distance_m.unwrap_or(0.0),
            flag(facts.off_road),
            flag(facts.collided),
            facts.route_remaining_m,
            facts.time_remaining,
        ];
        for (to, column) in out.iter_mut().zip(&self.layout.chosen[0]) {
            let c = &EGO[*column];
            *to = (full[*column] * (1.0 / c.scale)).clamp(c.low, c.high);
        }
    }

    fn write_route(&self, view: &View<'_>, ego: &Pose2, out: &mut [Real], mask: &mut [Real]) {
        let spacing = self.layout.config.route_spacing_m;
        let length = view.route.length_m();
        for (p, row) in out.chunks_exact_mut(4).enumerate() {
            let s = view.route_s_m + (p + 1) as Real * spacing;
            let there = s <= length;
            if there {
                let at = view.route.at(s);
                let local = ego.rotate_inverse(at.position - ego.position);
                row[0] = clip(local.x * (1.0 / 60.0));
                row[1] = clip(local.y * (1.0 / 60.0));
                row[2] = clip(at.cos * ego.cos + at.sin * ego.sin);
                row[3] = clip(at.sin * ego.cos - at.cos * ego.sin);
            } else {
                row.fill(0.0);
            }
            if let Some(m) = mask.get_mut(p) {
                *m = if there { 1.0 } else { 0.0 };
            }
        }
    }

    fn write_agents(&mut self, view: &View<'_>, ego: &Pose2, out: &mut [Real], mask: &mut [Real]) {
        let chosen = &self.layout.chosen[1];
        let (k, width) = (self.layout.config.num_agents, chosen.len());
        if k == 0 || width == 0 {
            return;
        }
        let (states, a) = (view.states, view.agent_idx);
        let (x, y) = (ego.position.x, ego.position.y);
        let reach = self.layout.config.radius_m * self.layout.config.radius_m;
        self.near.clear();
        for j in 0..states.len() {
            let (dx, dy) = (states.x[j] - x, states.y[j] - y);
            let d2 = dx * dx + dy * dy;
            if states.active[j] && d2 <= reach && j != a {
                // distances are not negative, so their bits sort as they do
                self.near.push(u64::from(d2.to_bits()) << 32 | j as u64);
            }
        }
        if self.near.len() > k {
            self.near.select_nth_unstable(k);
            self.near.truncate(k);
        }
        self.near.sort_unstable();
        let (vx, vy) = (states.velocity_x_mps[a], states.velocity_y_mps[a]);
        let rows = out.chunks_exact_mut(width);
        for (key, row) in self.near.iter().zip(rows) {
            let j = (key & 0xffff_ffff) as usize;
            let (dx, dy) = (states.x[j] - x, states.y[j] - y);
            let (dvx, dvy) = (states.velocity_x_mps[j] - vx, states.velocity_y_mps[j] - vy);
            let body = &view.bodies[j];
            let mut full = [0.0; AGENT.len()];
            full[0] = clip((ego.cos * dx + ego.sin * dy) * (1.0 / 60.0));
            full[1] = clip((ego.cos * dy - ego.sin * dx) * (1.0 / 60.0));
            full[2] = clip(states.cos[j] * ego.cos + states.sin[j] * ego.sin);
            full[3] = clip(states.sin[j] * ego.cos - states.cos[j] * ego.sin);
            full[4] = clip((ego.cos * dvx + ego.sin * dvy) * (1.0 / 20.0));
            full[5] = clip((ego.cos * dvy - ego.sin * dvx) * (1.0 / 20.0));
            full[6] = clip(states.speed_mps[j] * (1.0 / 20.0));
            full[7] = (body.half_length_m * (2.0 / 10.0)).min(1.0);
            full[8] = (body.half_width_m * (2.0 / 4.0)).min(1.0);
            full[9] = (Real::from_bits((key >> 32) as u32).sqrt() * (1.0 / 60.0)).min(1.0);
            full[AGENT_KINDS + view.kinds[j] as usize] = 1.0;
            if self.wants_ttc {
                let ttc = time_to_contact(states, view.bodies, a, j, TTC_SCALE_S);
                full[TTC_COLUMN] = ttc.map_or(1.0, |t| (t * (1.0 / TTC_SCALE_S)).min(1.0));
            }
            for (to, column) in row.iter_mut().zip(chosen) {
                *to = full[*column];
            }
        }
        let n = self.near.len();
        out[n * width..].fill(0.0);
        if !mask.is_empty() {
            mask[..n].fill(1.0);
            mask[n..].fill(0.0);
        }
    }

    /// Rotates all pieces first, in straight loops over arrays, and spreads the chosen columns then.
    fn write_map(&mut self, view: &View<'_>, ego: &Pose2, out: &mut [Real], mask: &mut [Real]) {
        let chosen = &self.layout.chosen[2];
        let (rows, width) = (self.layout.config.num_map_pieces, chosen.len());
        if rows == 0 || width == 0 {
            return;
        }
        let pieces = view.pieces;
        let nearest = pieces.nearest(ego.position);
        let n = nearest.len().min(rows);
        let nearest = &nearest[..n];
        let [x, y, cos, sin] = &mut self.map;
        for (i, k) in nearest.iter().enumerate() {
            let k = *k as usize;
            x[i] = pieces.x[k];
            y[i] = pieces.y[k];
            cos[i] = pieces.cos[k];
            sin[i] = pieces.sin[k];
        }
        for (px, py) in x[..n].iter_mut().zip(&mut y[..n]) {
            let (dx, dy) = (*px - ego.position.x, *py - ego.position.y);
            *px = clip((ego.cos * dx + ego.sin * dy) * (1.0 / 60.0));
            *py = clip((ego.cos * dy - ego.sin * dx) * (1.0 / 60.0));
        }
        for (c, s) in cos[..n].iter_mut().zip(&mut sin[..n]) {
            let (pc, ps) = (*c, *s);
            *c = clip(pc * ego.cos + ps * ego.sin);
            *s = clip(ps * ego.cos - pc * ego.sin);
        }
        for (to, column) in chosen.iter().enumerate() {
            let spread = out[to..].iter_mut().step_by(width);
            match column {
                0..4 => spread.zip(&self.map[*column][..n]).for_each(|(o, v)| *o = *v),
                4 => spread.zip(nearest).for_each(|(o, k)| {
                    *o = (pieces.half_length_m[*k as usize] * (1.0 / MAP[4].scale)).min(1.0)
                }),
                kind => spread.zip(nearest).for_each(|(o, k)| {
                    *o = if pieces.kind[*k as usize] as usize + MAP_KINDS == *kind { 1.0 } else { 0.0 };
                }),
            }
        }
        out[n * width..].fill(0.0);
        if !mask.is_empty() {
            mask[..n].fill(1.0);
            mask[n..].fill(0.0);
        }
    }
}

#[inline]
fn clip(v: Real) -> Real {
    v.clamp(-1.0, 1.0)
}
