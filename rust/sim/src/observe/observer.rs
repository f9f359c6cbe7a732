//! Writing observation rows.

use super::agent_rows::AgentRows;
use super::frame::{Frame, clip};
use super::layout::{EGO, Layout, ROUTE};
use super::map_rows::MapRows;
use super::view::View;
use crate::events::leader;
use crate::geom::{Real, math};
use crate::state::{AgentStates, Body};

/// Index of `leader_gap` among the columns of the ego; `leader_closing` is next.
const LEADER_GAP: usize = 17;

const ROUTE_FACTOR: [Real; 4] =
    [1.0 / ROUTE[0].scale, 1.0 / ROUTE[1].scale, 1.0 / ROUTE[2].scale, 1.0 / ROUTE[3].scale];

/// Writes rows of one layout; holds the memory that it works in.
#[derive(Debug, Clone)]
pub struct Observer {
    layout: Layout,
    wants_leader: bool,
    agents: AgentRows,
    map: MapRows,
}

impl Observer {
    /// Observer of worlds with this layout.
    pub fn new(layout: Layout) -> Self {
        let wants_leader = layout.chosen[0].iter().any(|c| *c >= LEADER_GAP);
        Self { agents: AgentRows::new(&layout), map: MapRows::new(&layout), wants_leader, layout }
    }

    /// Takes what all rows of a step have in common from the states; to be called before [`Observer::write`] whenever
    /// they have changed.
    pub fn prepare(&mut self, states: &AgentStates, bodies: &[Body]) {
        self.agents.prepare(states, bodies);
    }

    /// Writes the row of one agent: `layout.size` floats.
    pub fn write(&mut self, view: &View<'_>, out: &mut [Real]) {
        let ego = view.states.pose(view.agent_idx);
        let frame = Frame::new(&ego);
        let c = &self.layout.config;
        // a group without rows or columns has no mask either
        let mask = |size: usize, rows: usize| if c.masks && size > 0 { rows } else { 0 };
        let (num_points, num_agents, num_pieces) = (c.num_route_points, c.num_agents, c.num_map_pieces);
        let (agents_size, map_size) = (self.agents.size(), self.map.size());
        let (out, rest) = out.split_at_mut(self.layout.chosen[0].len());
        self.write_ego(view, out);
        let (out, rest) = rest.split_at_mut(num_points * ROUTE.len());
        let (route_mask, rest) = rest.split_at_mut(mask(num_points, num_points));
        self.write_route(view, &frame, out, route_mask);
        let (out, rest) = rest.split_at_mut(agents_size);
        let (agents_mask, rest) = rest.split_at_mut(mask(agents_size, num_agents));
        self.agents.write(view, &frame, out, agents_mask);
        let (out, rest) = rest.split_at_mut(map_size);
        self.map.write(view.pieces, &frame, out, &mut rest[..mask(map_size, num_pieces)]);
    }

    fn write_ego(&self, view: &View<'_>, out: &mut [Real]) {
        let (states, a, facts) = (view.states, view.agent_idx, &view.facts);
        let flag = |b: bool| if b { 1.0 } else { 0.0 };
        let (sin, cos) = math::sin_cos(facts.heading_error_rad);
        let ahead = if self.wants_leader {
            leader(states, view.bodies, view.route, view.route_s_m, a, view.anticipation_s)
        } else {
            None
        };
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
            ahead.map_or(Real::MAX, |l| l.gap_m),
            ahead.map_or(0.0, |l| states.speed_mps[a] - l.speed_mps),
        ];
        for (to, column) in out.iter_mut().zip(&self.layout.chosen[0]) {
            let c = &EGO[*column];
            *to = clip(full[*column] * (1.0 / c.scale), c.low, c.high);
        }
    }

    fn write_route(&self, view: &View<'_>, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        let spacing = self.layout.config.route_spacing_m;
        let length = view.route.length_m();
        for (p, row) in out.chunks_exact_mut(ROUTE.len()).enumerate() {
            let s = view.route_s_m + (p + 1) as Real * spacing;
            let there = s <= length;
            if there {
                let at = view.route.at(s);
                let (dx, dy) = (at.position.x - frame.x, at.position.y - frame.y);
                row.copy_from_slice(&frame.turn([dx, dy, at.cos, at.sin], ROUTE_FACTOR));
            } else {
                row.fill(0.0);
            }
            if let Some(m) = mask.get_mut(p) {
                *m = if there { 1.0 } else { 0.0 };
            }
        }
    }
}
