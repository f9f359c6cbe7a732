//! Rows of other agents.

use super::frame::{Eight, Frame, Lanes, Unturned, clip, put_rows};
use super::layout::{AGENT, Layout, TTC_SCALE_S};
use super::nearest_agents::NearestAgents;
use super::view::View;
use crate::events::time_to_contact;
use crate::geom::Real;
use crate::state::{AgentStates, Body};
use crate::wide::wide;

/// Index of `ttc` among the columns.
const TTC: usize = 10;
/// Index of the first kind among the columns.
const KINDS: usize = 11;
/// Index of `route_position`, the first of the three columns about the observer's route.
const ROUTE_POSITION: usize = 16;
const PLACE_FACTOR: [Real; 4] =
    [1.0 / AGENT[0].scale, 1.0 / AGENT[1].scale, 1.0 / AGENT[2].scale, 1.0 / AGENT[3].scale];
const VELOCITY_FACTOR: Real = 1.0 / AGENT[4].scale;
const SPEED_FACTOR: Real = 1.0 / AGENT[6].scale;
const LENGTH_FACTOR: Real = 2.0 / AGENT[7].scale;
const WIDTH_FACTOR: Real = 2.0 / AGENT[8].scale;
const DISTANCE_FACTOR: Real = 1.0 / AGENT[9].scale;
const ROUTE_FACTOR: [Real; 3] = [1.0 / AGENT[16].scale, 1.0 / AGENT[17].scale, 1.0 / AGENT[18].scale];

/// Columns of the comparison with other simulators: place, direction, speed, size.
const COMPARISON: [usize; 7] = [0, 1, 2, 3, 6, 7, 8];

const COMPARISON_FACTOR: [Real; 8] = [
    PLACE_FACTOR[0],
    PLACE_FACTOR[1],
    PLACE_FACTOR[2],
    PLACE_FACTOR[3],
    SPEED_FACTOR,
    LENGTH_FACTOR,
    WIDTH_FACTOR,
    0.0,
];

const NOTHING: Eight = Eight([0.0; 8]);

/// What the chosen columns need beside places, velocities and sizes.
#[derive(Debug, Clone, Copy)]
struct Wants {
    ttc: bool,
    /// How far along the route agents are looked for, metres, where columns about the route are chosen.
    route_reach_m: Option<Real>,
}

/// Writes the nearest agents.
#[derive(Debug, Clone)]
pub(super) struct AgentRows {
    chosen: Vec<usize>,
    num_rows: usize,
    wants: Wants,
    nearest: NearestAgents,
    /// Rows of all agents before they are turned; only for the columns of the comparison.
    rows: Vec<Unturned>,
}

impl AgentRows {
    pub(super) fn new(layout: &Layout) -> Self {
        let chosen = layout.chosen[1].clone();
        let config = &layout.config;
        Self {
            num_rows: config.num_agents,
            wants: Wants {
                ttc: chosen.contains(&TTC),
                route_reach_m: chosen.iter().any(|c| *c >= ROUTE_POSITION).then_some(config.radius_m),
            },
            nearest: NearestAgents::new(config.num_agents, config.radius_m),
            rows: Vec::new(),
            chosen,
        }
    }

    /// Takes what the rows of all observers have in common from the states.
    pub(super) fn prepare(&mut self, states: &AgentStates, bodies: &[Body]) {
        self.rows.clear();
        if self.num_rows > 0 && self.chosen == COMPARISON {
            self.rows.extend(bodies.iter().enumerate().map(|(j, body)| {
                Eight([
                    states.x[j],
                    states.y[j],
                    states.cos[j],
                    states.sin[j],
                    states.speed_mps[j],
                    body.half_length_m,
                    body.half_width_m,
                    0.0,
                ])
            }));
        }
    }

    /// Floats of all rows.
    pub(super) fn size(&self) -> usize {
        self.num_rows * self.chosen.len()
    }

    /// Fills [K, F] and the mask [K] (or nothing, where there is no mask).
    pub(super) fn write(&mut self, view: &View<'_>, frame: &Frame, out: &mut [Real], mask: &mut [Real]) {
        if out.is_empty() {
            return;
        }
        let keys = self.nearest.find(view.states, view.agent_idx);
        let width = self.chosen.len();
        let (rows, absent) = out.split_at_mut(keys.len() * width);
        if self.chosen == COMPARISON {
            fill_comparison(&self.rows, keys, &frame.lanes(COMPARISON_FACTOR), rows);
        } else {
            for (row, key) in rows.chunks_exact_mut(width).zip(keys) {
                let full = full_row(self.wants, view, frame, *key);
                for (to, column) in row.iter_mut().zip(&self.chosen) {
                    *to = full[*column];
                }
            }
        }
        absent.fill(0.0);
        if !mask.is_empty() {
            mask[..keys.len()].fill(1.0);
            mask[keys.len()..].fill(0.0);
        }
    }
}

wide! {
    fn fill_comparison(all: &[Unturned], keys: &[u64], lanes: &Lanes, rows: &mut [Real])
    with turn [Fn(&Lanes, (&Unturned, &Eight)) -> [Real; 8]] = Lanes::turn, Lanes::turn_avx2 {
        put_rows::<_, { COMPARISON.len() }, 8, 29>(rows, keys, |key| {
            turn(lanes, (&all[(key & 0xffff_ffff) as usize], &NOTHING))
        });
    }
}

#[inline(always)]
fn place(view: &View<'_>, frame: &Frame, j: usize) -> [Real; 4] {
    let s = view.states;
    frame.turn([s.x[j] - frame.x, s.y[j] - frame.y, s.cos[j], s.sin[j]], PLACE_FACTOR)
}

#[inline(always)]
fn speed_and_size(view: &View<'_>, j: usize) -> [Real; 3] {
    let body = &view.bodies[j];
    [
        clip(view.states.speed_mps[j] * SPEED_FACTOR, -1.0, 1.0),
        clip(body.half_length_m * LENGTH_FACTOR, 0.0, 1.0),
        clip(body.half_width_m * WIDTH_FACTOR, 0.0, 1.0),
    ]
}

/// Position, distance and speed along the observer's route.
fn along_route(view: &View<'_>, j: usize, reach_m: Real) -> [Real; 3] {
    let s = view.states;
    let nearest = view.route.project_sparsely(s.position(j), view.route_s_m, reach_m);
    let along = view.route.tangent_at(nearest.s_m);
    let quantities = [
        nearest.s_m - view.route_s_m,
        nearest.lateral_m,
        s.velocity_x_mps[j] * along.x + s.velocity_y_mps[j] * along.y,
    ];
    std::array::from_fn(|i| clip(quantities[i] * ROUTE_FACTOR[i], -1.0, 1.0))
}

fn full_row(wants: Wants, view: &View<'_>, frame: &Frame, key: u64) -> [Real; AGENT.len()] {
    let (s, a, j) = (view.states, view.agent_idx, (key & 0xffff_ffff) as usize);
    let velocity_x = s.velocity_x_mps[j] - s.velocity_x_mps[a];
    let velocity_y = s.velocity_y_mps[j] - s.velocity_y_mps[a];
    let velocity = frame.turn([velocity_x, velocity_y, 0.0, 0.0], [VELOCITY_FACTOR; 4]);
    let mut row = [0.0; AGENT.len()];
    row[..4].copy_from_slice(&place(view, frame, j));
    row[4..6].copy_from_slice(&velocity[..2]);
    row[6..9].copy_from_slice(&speed_and_size(view, j));
    row[9] = clip(Real::from_bits((key >> 32) as u32).sqrt() * DISTANCE_FACTOR, 0.0, 1.0);
    row[KINDS + view.kinds[j] as usize] = 1.0;
    if wants.ttc {
        let ttc_s = time_to_contact(s, view.bodies, a, j, TTC_SCALE_S);
        row[TTC] = ttc_s.map_or(1.0, |t| clip(t * (1.0 / TTC_SCALE_S), 0.0, 1.0));
    }
    if let Some(reach_m) = wants.route_reach_m {
        row[ROUTE_POSITION..].copy_from_slice(&along_route(view, j, reach_m));
    }
    row
}
