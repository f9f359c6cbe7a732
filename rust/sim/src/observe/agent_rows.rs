//! Rows of other agents.

use super::column::{ObservationColumn, clip};
use super::columns::{AGENTS, Entry};
use super::frame::{F32x8, Frame, Group, LANES, MOST_GROUPS, Part, fill_rows, spread};
use super::nearest_agents::NearestAgents;
use super::source::{OfAgent, Pairs, Target};
use super::view::View;
use crate::geom::{Point2, Projection, Real};
use crate::scene::AgentKind;
use crate::state::{AgentStates, Footprint};

/// Places of the vectors of an agent among the numbers of an origin.
const PLACE: usize = 0;
const DIRECTION: usize = 2;
const VELOCITY: usize = 4;
/// A number that is zero, and the place of the speed.
const ZERO: usize = 6;
const SPEED: usize = 7;
/// So many observers are many.
const MANY: usize = 4;

// all columns, and all six components once more
const _: () = assert!(AGENTS.len() + 6 <= MOST_GROUPS * (LANES - 1));

/// Which lanes of a group change with the states, by a mask, and where their numbers are among those of an agent.
#[derive(Debug, Clone)]
struct Moving {
    places: [i32; LANES],
    mask: [u32; LANES],
}

/// A chosen column of pairs, and its place in the row.
#[derive(Debug, Clone)]
struct PairColumn {
    at: usize,
    column: &'static ObservationColumn,
    factor: Real,
    fill: fn(&Pairs<'_>, Target<'_>),
}

#[derive(Debug, Clone)]
pub(super) struct AgentRows {
    num_rows: usize,
    width: usize,
    /// How far along the route agents are looked for, metres, where columns about the route are chosen.
    route_reach_m: Option<Real>,
    groups: Vec<Group>,
    entries: Vec<&'static Entry<OfAgent>>,
    moving: Vec<Moving>,
    /// Factor and bounds of the column of the speed.
    speed: [Real; 3],
    /// Whether there are many observers: the numbers of all agents are then made at once.
    many: bool,
    all: Vec<u32>,
    /// Vectors and speeds of all agents, see [`PLACE`].
    agents: Vec<F32x8>,
    /// The numbers of all agents [A, groups]; those that stay what they are in a scene are written when it is entered.
    numbers: Vec<F32x8>,
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
        let part = |entry: &&'static Entry<OfAgent>| {
            let part = match entry.source {
                OfAgent::Place(axis) => Part::Component(PLACE, axis),
                OfAgent::Direction(axis) => Part::Component(DIRECTION, axis),
                OfAgent::Velocity(axis) => Part::Component(VELOCITY, axis),
                OfAgent::Speed | OfAgent::Fixed(_) | OfAgent::Pair(_) | OfAgent::OnRoute(_) => Part::Constant,
            };
            (part, &entry.column)
        };
        let mut groups = Group::of_row(&entries.iter().map(part).collect::<Vec<_>>());
        let is_of_pairs = |e: &&Entry<OfAgent>| matches!(e.source, OfAgent::Pair(_) | OfAgent::OnRoute(_));
        // columns of pairs are filled one by one
        let mut num_written = entries.len();
        while let Some(last) =
            groups.pop_if(|last| entries[num_written - last.num_columns..num_written].iter().all(is_of_pairs))
        {
            num_written -= last.num_columns;
        }
        let mut moving: Vec<_> = groups.iter().map(Moving::new).collect();
        let mut speed = [0.0; 3];
        for (g, lane, entry) in lanes(&groups, &entries) {
            if matches!(entry.source, OfAgent::Speed) {
                (moving[g].places[lane], moving[g].mask[lane]) = (SPEED as i32, u32::MAX);
                speed = [1.0 / entry.column.scale, entry.column.low, entry.column.high];
            }
        }
        let on_route = entries.iter().any(|e| matches!(e.source, OfAgent::OnRoute(_)));
        Self {
            num_rows,
            width: chosen.len(),
            route_reach_m: on_route.then_some(radius_m),
            groups,
            moving,
            speed,
            many: false,
            all: Vec::new(),
            agents: Vec::new(),
            numbers: Vec::new(),
            pairs: entries.iter().enumerate().filter_map(pair).collect(),
            entries,
            nearest: NearestAgents::new(num_rows, radius_m),
            places: Vec::new(),
            on_route: Vec::new(),
        }
    }

    /// Takes the numbers that stay what they are in a scene.
    pub(super) fn enter(&mut self, footprints: &[Footprint], kinds: &[AgentKind]) {
        self.nearest.enter(footprints.len());
        self.all.clear();
        self.all.extend(0..footprints.len() as u32);
        self.numbers.clear();
        self.numbers.resize(footprints.len() * self.groups.len(), F32x8::default());
        for (g, lane, entry) in lanes(&self.groups, &self.entries) {
            let (ObservationColumn { scale, low, high, .. }, OfAgent::Fixed(number)) =
                (&entry.column, entry.source)
            else {
                continue;
            };
            let agents = self.numbers.chunks_exact_mut(self.groups.len());
            for (numbers, (footprint, kind)) in agents.zip(footprints.iter().zip(kinds)) {
                numbers[g].0[lane] = clip(number(footprint, *kind) * (1.0 / scale), *low, *high);
            }
        }
    }

    /// Takes what the rows of all observers have in common from the states.
    pub(super) fn prepare(&mut self, states: &AgentStates, num_observers: usize) {
        self.many = num_observers >= MANY;
        let places = states.x.iter().zip(&states.y);
        let directions = states.cos.iter().zip(&states.sin);
        let velocities = states.velocity_x_mps.iter().zip(&states.velocity_y_mps);
        let motions = velocities.zip(&states.speed_mps);
        let [factor, low, high] = self.speed;
        self.agents.clear();
        self.agents.extend(places.zip(directions.zip(motions)).map(
            |((x, y), ((cos, sin), ((vx, vy), speed)))| {
                F32x8([*x, *y, *cos, *sin, *vx, *vy, 0.0, clip(speed * factor, low, high)])
            },
        ));
        if self.many {
            spread_all(&self.moving, &self.agents, &self.all, &mut self.numbers);
        }
    }

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
        let velocity = view.states.velocity(view.agent_idx);
        let origin = F32x8([frame.x, frame.y, 0.0, 0.0, velocity.x, velocity.y, 0.0, 0.0]);
        if !self.many {
            spread_all(&self.moving, &self.agents, near, &mut self.numbers);
        }
        fill_rows(&self.groups, frame, &origin, &self.numbers, near, width, rows);
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

/// Makes the numbers of some agents that change with the states.
fn spread_all(moving: &[Moving], agents: &[F32x8], which: &[u32], numbers: &mut [F32x8]) {
    for (g, Moving { places, mask }) in moving.iter().enumerate().filter(|(_, m)| m.mask != [0; LANES]) {
        spread(places, mask, agents, which, g, moving.len(), numbers);
    }
}

impl Moving {
    /// The components of vectors.
    fn new(group: &Group) -> Self {
        let mut moving = Self { places: [ZERO as i32; LANES], mask: [0; LANES] };
        for (lane, part) in group.parts.iter().enumerate() {
            if let Part::Component(vector, axis) = *part {
                moving.places[lane] = axis.own_and_other([vector, vector + 1]).0 as i32;
                moving.mask[lane] = u32::MAX;
            }
        }
        moving
    }
}

/// The group and the lane of each column that is written with others.
fn lanes<'a>(
    groups: &'a [Group],
    entries: &'a [&'static Entry<OfAgent>],
) -> impl Iterator<Item = (usize, usize, &'static Entry<OfAgent>)> + 'a {
    let lanes =
        groups.iter().enumerate().flat_map(|(g, group)| (0..group.num_columns).map(move |lane| (g, lane)));
    lanes.zip(entries).map(|((g, lane), entry)| (g, lane, *entry))
}
