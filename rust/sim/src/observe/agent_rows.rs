//! Rows of other agents.

use super::column::{ObservationColumn, clip};
use super::columns::{AGENTS, Entry};
use super::frame::{F32x8, Frame, Group, LANES, fill_agents};
use super::nearest_agents::NearestAgents;
use super::source::{OfAgent, Pairs, Target};
use super::view::View;
use crate::geom::{Point2, Projection, Real};
use crate::scene::AgentKind;
use crate::state::{AgentStates, Footprint};

/// Indices of the first numbers of an agent: place, direction, velocity, speed.
const PLACE: usize = 0;
const DIRECTION: usize = 2;
const VELOCITY: usize = 4;
const SPEED: usize = 7;

/// Chosen columns that are written at once; those of pairs are left out.
#[derive(Debug, Clone)]
struct Columns {
    entries: Vec<&'static Entry<OfAgent>>,
    /// Those that change with the states.
    moving: Group,
    /// For each agent the columns that stay what they are in a scene, zeros elsewhere.
    fixed: Vec<F32x8>,
}

/// A chosen column of pairs, and its place in the row.
#[derive(Debug, Clone)]
struct PairColumn {
    at: usize,
    column: &'static ObservationColumn,
    factor: Real,
    fill: fn(&Pairs<'_>, Target<'_>),
}

/// Writes the nearest agents.
#[derive(Debug, Clone)]
pub(super) struct AgentRows {
    num_rows: usize,
    width: usize,
    /// How far along the route agents are looked for, metres, where columns about the route are chosen.
    route_reach_m: Option<Real>,
    groups: Vec<Columns>,
    /// The numbers of all agents that change with the states, see [`PLACE`].
    agents: Vec<F32x8>,
    pairs: Vec<PairColumn>,
    nearest: NearestAgents,
    /// Places of the nearest agents, and these along the route.
    places: Vec<Point2>,
    on_route: Vec<Projection>,
}

impl AgentRows {
    pub(super) fn new(chosen: &[usize], num_rows: usize, radius_m: Real) -> Self {
        let entries: Vec<&'static Entry<OfAgent>> = chosen.iter().map(|c| &AGENTS[*c]).collect();
        let pair = |(at, entry): (usize, &&'static Entry<OfAgent>)| match entry.source {
            OfAgent::Pair(fill) | OfAgent::OnRoute(fill) => {
                let column = &entry.column;
                Some(PairColumn { at, column, factor: 1.0 / column.scale, fill })
            }
            _ => None,
        };
        let mut groups: Vec<Columns> = chosen.chunks(LANES).map(Columns::new).collect();
        // columns of pairs are filled one by one
        while groups.pop_if(|last| last.is_of_pairs()).is_some() {}
        let on_route = entries.iter().any(|e| matches!(e.source, OfAgent::OnRoute(_)));
        Self {
            num_rows,
            width: chosen.len(),
            route_reach_m: on_route.then_some(radius_m),
            groups,
            agents: Vec::new(),
            pairs: entries.iter().enumerate().filter_map(pair).collect(),
            nearest: NearestAgents::new(num_rows, radius_m),
            places: Vec::new(),
            on_route: Vec::new(),
        }
    }

    /// Takes the numbers that stay what they are in a scene.
    pub(super) fn enter(&mut self, footprints: &[Footprint], kinds: &[AgentKind]) {
        self.groups.iter_mut().for_each(|columns| columns.enter(footprints, kinds));
    }

    /// Takes what the rows of all observers have in common from the states.
    pub(super) fn prepare(&mut self, states: &AgentStates) {
        let places = states.x.iter().zip(&states.y);
        let directions = states.cos.iter().zip(&states.sin);
        let velocities = states.velocity_x_mps.iter().zip(&states.velocity_y_mps);
        let motions = velocities.zip(&states.speed_mps);
        self.nearest.prepare(states);
        self.agents.clear();
        self.agents.extend(places.zip(directions.zip(motions)).map(
            |((x, y), ((cos, sin), ((vx, vy), speed)))| F32x8([*x, *y, *cos, *sin, *vx, *vy, 0.0, *speed]),
        ));
    }

    /// Floats of all rows.
    pub(super) fn size(&self) -> usize {
        self.num_rows * self.width
    }

    /// Fills [K, F] and the mask [K] (or nothing, where there is no mask).
    pub(super) fn write(&mut self, view: &View<'_>, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        if out.is_empty() {
            return;
        }
        let (width, near) = (self.width, self.nearest.find(view.states, view.agent_idx));
        let (rows, absent) = out.split_at_mut(near.len() * width);
        let [x, y, _, _, vx, vy, ..] = self.agents[view.agent_idx].0;
        let origin = F32x8([x, y, 0.0, 0.0, vx, vy, 0.0, 0.0]);
        for (pass, columns) in self.groups.chunks(2).enumerate().rev() {
            let first = pass * 2 * LANES;
            let (room, agents) = (width - first, &self.agents);
            let Some(rows) = rows.get_mut(first..) else { break };
            match columns {
                [a, b] if b.moving.moves() => {
                    let (groups, added) = ([&a.moving, &b.moving], [&*a.fixed, &*b.fixed]);
                    fill_agents::<2, 2>(&groups, frame, &origin, &added, agents, near, width, room, rows);
                }
                [a, b] => {
                    let (groups, added) = ([&a.moving, &b.moving], [&*a.fixed, &*b.fixed]);
                    fill_agents::<2, 1>(&groups, frame, &origin, &added, agents, near, width, room, rows);
                }
                [a] => fill_agents::<1, 1>(
                    &[&a.moving],
                    frame,
                    &origin,
                    &[&a.fixed],
                    agents,
                    near,
                    width,
                    room,
                    rows,
                ),
                _ => {}
            }
        }
        if let Some(reach_m) = self.route_reach_m {
            self.places.clear();
            self.places.extend(near.iter().map(|other| view.states.position(*other as usize)));
            view.route.project_sparsely(&self.places, view.route_s_m, reach_m, &mut self.on_route);
        }
        let pairs = Pairs { view, agents: near, on_route: &self.on_route };
        for PairColumn { at, column, factor, fill } in &self.pairs {
            let (low, high) = (column.low, column.high);
            fill(&pairs, Target { rows: &mut *rows, width, at: *at, factor: *factor, low, high });
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..near.len()].fill(1.0);
            mask[near.len()..].fill(0.0);
        }
    }
}

impl Columns {
    fn new(chosen: &[usize]) -> Self {
        let entries: Vec<_> = chosen.iter().map(|c| &AGENTS[*c]).collect();
        let mut moving = Group::new();
        for (lane, entry) in entries.iter().enumerate() {
            match entry.source {
                OfAgent::Place(axis) => moving.set_vector(lane, PLACE, axis, &entry.column),
                OfAgent::Direction(axis) => moving.set_vector(lane, DIRECTION, axis, &entry.column),
                OfAgent::Velocity(axis) => moving.set_vector(lane, VELOCITY, axis, &entry.column),
                OfAgent::Speed => moving.set_number(lane, SPEED, &entry.column),
                OfAgent::Fixed(_) | OfAgent::Pair(_) | OfAgent::OnRoute(_) => {}
            }
        }
        Self { entries, moving, fixed: Vec::new() }
    }

    /// Whether all columns are those of pairs.
    fn is_of_pairs(&self) -> bool {
        self.entries.iter().all(|e| matches!(e.source, OfAgent::Pair(_) | OfAgent::OnRoute(_)))
    }

    fn enter(&mut self, footprints: &[Footprint], kinds: &[AgentKind]) {
        self.fixed.clear();
        self.fixed.resize(footprints.len(), F32x8::default());
        for (lane, entry) in self.entries.iter().enumerate() {
            let (ObservationColumn { scale, low, high, .. }, OfAgent::Fixed(number)) =
                (&entry.column, entry.source)
            else {
                continue;
            };
            for (fixed, (footprint, kind)) in self.fixed.iter_mut().zip(footprints.iter().zip(kinds)) {
                fixed.0[lane] = clip(number(footprint, *kind) * (1.0 / scale), *low, *high);
            }
        }
    }
}
