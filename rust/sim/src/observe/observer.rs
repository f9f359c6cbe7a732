//! Writing observation rows.

use super::agent_rows::AgentRows;
use super::column::clip;
use super::columns::{EGO, Entry, ROUTE};
use super::frame::Frame;
use super::layout::Layout;
use super::map_rows::MapRows;
use super::map_segments::MapSegments;
use super::source::{Ego, OfEgo};
use super::view::View;
use crate::geom::Real;
use crate::scene::AgentKind;
use crate::state::{AgentStates, Footprint};

/// Writes rows of one layout; holds the memory that it works in.
#[derive(Debug, Clone)]
pub struct Observer {
    layout: Layout,
    /// Numbers about the observing agent, and their factors.
    ego: Vec<(&'static Entry<OfEgo>, Real)>,
    agents: AgentRows,
    map: MapRows,
}

impl Observer {
    /// Observer of worlds with this layout.
    pub fn new(layout: Layout) -> Self {
        let ([ego, agents, map], c) = (&layout.chosen, &layout.config);
        Self {
            ego: ego.iter().map(|c| (&EGO[*c], 1.0 / EGO[*c].column.scale)).collect(),
            agents: AgentRows::new(agents, c.num_neighbors, c.radius_m),
            map: MapRows::new(map, c.num_map_segments),
            layout,
        }
    }

    /// Takes what stays what it is in a scene; to be called before [`Observer::prepare`] in each scene.
    pub fn enter(&mut self, footprints: &[Footprint], kinds: &[AgentKind], segments: &MapSegments) {
        self.agents.enter(footprints, kinds);
        self.map.enter(segments);
    }

    /// Takes what all rows of a step have in common from the states; to be called before [`Observer::write`] whenever
    /// they have changed. `num_observers` is about how many rows follow: it decides how, not what.
    pub fn prepare(&mut self, states: &AgentStates, num_observers: usize) {
        self.agents.prepare(states, num_observers);
    }

    /// Adds noise to the numbers with a unit of a row, within their bounds; rows of zeros stay.
    pub(crate) fn disturb(&self, row: &mut [Real], mut noise: impl FnMut() -> Real) {
        for entry in self.layout.entries.iter().filter(|entry| !entry.columns.is_empty()) {
            let end = entry.offset + entry.shape.iter().product::<usize>();
            let rows = row.get_mut(entry.offset..end).unwrap_or_default();
            let there = |numbers: &&mut [Real]| numbers.iter().any(|v| *v != 0.0);
            for numbers in rows.chunks_exact_mut(entry.columns.len()).filter(there) {
                for (v, c) in numbers.iter_mut().zip(&entry.columns).filter(|(_, c)| !c.unit.is_empty()) {
                    *v = clip(*v + noise(), c.low, c.high);
                }
            }
        }
    }

    /// Writes the row of one agent: `layout.size` floats.
    pub fn write(&mut self, view: &View<'_>, out: &mut [Real]) {
        let frame = Frame::new(&view.states.pose(view.agent_idx));
        let c = &self.layout.config;
        // a group without rows or columns has no mask either
        let mask = |size: usize, rows: usize| if c.masks && size > 0 { rows } else { 0 };
        let (num_points, num_neighbors, num_segments) =
            (c.num_route_points, c.num_neighbors, c.num_map_segments);
        let (agents_size, map_size) = (self.agents.size(), self.map.size());
        let (out, rest) = out.split_at_mut(self.ego.len());
        let ego = Ego::new(view);
        for (to, (entry, factor)) in out.iter_mut().zip(&self.ego) {
            *to = clip((entry.source)(&ego) * factor, entry.column.low, entry.column.high);
        }
        let (out, rest) = rest.split_at_mut(num_points * ROUTE.len());
        let (route_mask, rest) = rest.split_at_mut(mask(num_points, num_points));
        write_route(view, &frame, c.route_spacing_m, out, route_mask);
        let (out, rest) = rest.split_at_mut(agents_size);
        let (agents_mask, rest) = rest.split_at_mut(mask(agents_size, num_neighbors));
        self.agents.write(view, &frame, out, agents_mask);
        let (out, rest) = rest.split_at_mut(map_size);
        if !view.states.heights.is_empty() {
            self.map.enter(view.segments);
        }
        self.map.write(view.segments, &frame, out, &mut rest[..mask(map_size, num_segments)]);
    }
}

/// Factors of the columns of a point on the route.
const FACTOR: [Real; 4] = [
    1.0 / ROUTE[0].column.scale,
    1.0 / ROUTE[1].column.scale,
    1.0 / ROUTE[2].column.scale,
    1.0 / ROUTE[3].column.scale,
];

/// Fills [P, 4] and the mask [P] (or nothing, where there is no mask).
fn write_route(view: &View<'_>, frame: &Frame, spacing_m: Real, out: &mut [Real], mask: &mut [Real]) {
    let length = view.route.length_m();
    let (rows, _) = out.as_chunks_mut::<{ ROUTE.len() }>();
    for (p, row) in rows.iter_mut().enumerate() {
        let s = view.route_s_m + (p + 1) as Real * spacing_m;
        let there = s <= length;
        *row = if there {
            let at = view.route.at(s);
            frame.rotate([at.position.x - frame.x, at.position.y - frame.y, at.cos, at.sin], FACTOR)
        } else {
            [0.0; ROUTE.len()]
        };
        if let Some(m) = mask.get_mut(p) {
            *m = if there { 1.0 } else { 0.0 };
        }
    }
}
