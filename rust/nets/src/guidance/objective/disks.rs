//! Vehicles as two disks each: radius W/2, centres at -(L/2 - W/2) and L/2 - W/2 along the body axis.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;

/// Disks of a vehicle.
pub(super) const PER_VEHICLE: usize = 2;

/// Disks of all agents of a world and where their plans go.
pub(super) struct Disks {
    /// Offset of the foremost disk of each agent along the body axis, metres, [M]; the other one is as far behind.
    pub(super) reach_m: Vec<f32>,
    /// Least and largest x and y of each plan, [M].
    bounds: Vec<[f32; 4]>,
}

/// One pair of disks at one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct DiskPair {
    /// Distance of the centres, metres.
    pub(super) distance_m: f32,
    /// From the first to the second, unit length; zero where the centres coincide.
    direction: (f32, f32),
    offsets_m: (f32, f32),
}

impl Disks {
    pub(super) fn new(context: &GuidanceContext<'_>, plan: &Rollout) -> Self {
        let m = context.num_agents();
        let reach = |a: usize| (0.5 * (context.length_m[a] - context.width_m[a])).max(0.0);
        let bounds = (0..m).map(|a| {
            let steps = a * plan.num_steps..(a + 1) * plan.num_steps;
            let range = |v: &[f32]| v.iter().fold((f32::MAX, f32::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
            let (x, y) = (range(&plan.x_m[steps.clone()]), range(&plan.y_m[steps]));
            [x.0, x.1, y.0, y.1]
        });
        Self { reach_m: (0..m).map(reach).collect(), bounds: bounds.collect() }
    }

    /// Whether the centres of two plans can come nearer than this at all.
    pub(super) fn may_meet(&self, i: usize, j: usize, distance_m: f32) -> bool {
        let ([a, b, c, d], [e, f, g, h]) = (self.bounds[i], self.bounds[j]);
        e - b < distance_m && a - f < distance_m && g - d < distance_m && c - h < distance_m
    }

    /// All pairs of disks of two agents at a step.
    pub(super) fn pairs<'p>(
        &'p self,
        plan: &'p Rollout,
        (i, j): (usize, usize),
        t: usize,
    ) -> impl Iterator<Item = DiskPair> + 'p {
        let (at_i, at_j) = (i * plan.num_steps + t, j * plan.num_steps + t);
        let (dx, dy) = (plan.x_m[at_j] - plan.x_m[at_i], plan.y_m[at_j] - plan.y_m[at_i]);
        let of = |agent: usize| [-self.reach_m[agent], self.reach_m[agent]];
        of(i).into_iter().flat_map(move |a| {
            of(j).into_iter().map(move |b| {
                let x = dx + b * plan.cos[at_j] - a * plan.cos[at_i];
                let y = dy + b * plan.sin[at_j] - a * plan.sin[at_i];
                let distance_m = (x * x + y * y).sqrt();
                let inverse = if distance_m > 0.0 { 1.0 / distance_m } else { 0.0 };
                DiskPair { distance_m, direction: (x * inverse, y * inverse), offsets_m: (a, b) }
            })
        })
    }
}

impl DiskPair {
    /// Adds the gradient of a function of the distance, with this derivative, to the agents that take one.
    pub(super) fn add_gradient(
        &self,
        plan: &Rollout,
        (i, j): (usize, usize),
        t: usize,
        derivative: f32,
        moves: (bool, bool),
        out: &mut Evaluation<'_>,
    ) {
        let (x, y) = (derivative * self.direction.0, derivative * self.direction.1);
        for (agent, moves, sign, offset_m) in
            [(i, moves.0, -1.0, self.offsets_m.0), (j, moves.1, 1.0, self.offsets_m.1)]
        {
            if moves {
                let at = agent * plan.num_steps + t;
                out.gradient.x[at] += sign * x;
                out.gradient.y[at] += sign * y;
                out.gradient.heading[at] += sign * offset_m * (y * plan.cos[at] - x * plan.sin[at]);
            }
        }
    }
}

/// Calls `visit` with every pair of agents of which at least one is of interest, moves and counts, and with which of
/// the two have a loss: agents that stand have none and are not moved (as released).
pub(super) fn for_pairs(
    context: &GuidanceContext<'_>,
    wanted: &[bool],
    mut visit: impl FnMut((usize, usize), (bool, bool)),
) {
    let m = context.num_agents();
    for i in 0..m {
        for j in i + 1..m {
            let moves = (context.moving[i], context.moving[j]);
            let counts = context.partner[i] || context.partner[j];
            if counts && (wanted[i] || wanted[j]) && (moves.0 || moves.1) && !context.is_apart(i, j) {
                visit((i, j), moves);
            }
        }
    }
}
