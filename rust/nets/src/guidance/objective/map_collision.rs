//! Parts of the body off the road, as released (reference.md#guidance).
//!
//! A grid of 10 x 10 points in the box. Steps at which some points are on the road and some are not count:
//! loss_i = Σ_t w_t Σ over off-road points c of (1 - d_c / diagonal), d_c the distance from c to the nearest on-road point of
//! the same box, w_t = γ^t / Σ γ^t; 0 for agents that stand now.
//! Gradient: the off-road points are held fixed and the on-road points carry it, so a positive weight pushes the on-road part
//! away from them, back to the road. There is none once the whole box is off the road.
//!
//! Differs from the released code: a point is on the road where the scene's drivable area holds it, not where the pixel of a
//! raster of 0.5 m does; a box counts as wholly on (or off) the road where the twelve points round its outline, at thirds of its
//! sides, are: that settles most boxes without looking at the other 88.

use super::Evaluation;
use crate::guidance::context::GuidanceContext;
use crate::guidance::rollout::Rollout;
use ccdiff_sim::geom::{Point2, Region};
use ccdiff_sim::options;
use ccdiff_sim::options::WEIGHT;

/// Points per side of the grid.
const SIDE: usize = 10;

/// Points (row, column) round the outline at thirds of the sides; neighbours in this order lie far apart, so that a box that
/// is partly off the road is found early.
const OUTLINE: [(usize, usize); 12] = {
    const E: usize = SIDE - 1;
    const A: usize = E / 3;
    const B: usize = E - A;
    [(0, 0), (E, E), (0, E), (E, 0), (0, A), (E, B), (0, B), (E, A), (A, E), (B, E), (A, 0), (B, 0)]
};

options! {
    /// Settings of the off-road loss.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct MapCollision {
        /// Signed weight; positive keeps to the road.
        weight: f32 = 1.0, range WEIGHT;
    }
}

/// The column of a set that is nearest to one, the lower of two; none of an empty set.
fn nearest_column(set: u16, column: usize) -> Option<usize> {
    let low = (set & ((2 << column) - 1)).checked_ilog2().map(|low| low as usize);
    let high = (set >> column != 0).then(|| column + (set >> column).trailing_zeros() as usize);
    match (low, high) {
        (Some(low), Some(high)) if high - column >= column - low => Some(low),
        (low, high) => high.or(low),
    }
}

/// A box at a step: the points of its grid are centre + along · forward + across · left.
struct Grid {
    along_m: [f32; SIDE],
    across_m: [f32; SIDE],
    diagonal_m: f32,
}

impl Grid {
    fn new(length_m: f32, width_m: f32) -> Self {
        let place = |k: usize| k as f32 / (SIDE - 1) as f32 - 0.5;
        Self {
            along_m: std::array::from_fn(|k| place(k) * length_m),
            across_m: std::array::from_fn(|k| place(k) * width_m),
            diagonal_m: (length_m * length_m + width_m * width_m).sqrt(),
        }
    }

    /// A point of the grid in the scene.
    fn point(&self, (row, column): (usize, usize), (x, y): (f32, f32), (cos, sin): (f32, f32)) -> Point2 {
        let (along, across) = (self.along_m[column], self.across_m[row]);
        Point2::new(x + along * cos - across * sin, y + along * sin + across * cos)
    }

    /// Whether the points round the outline are partly on the road and partly not.
    fn is_partly_on(&self, road: &Region, place: (f32, f32), turn: (f32, f32)) -> bool {
        let is_on = |at| road.contains(self.point(at, place, turn));
        let first = is_on(OUTLINE[0]);
        OUTLINE[1..].iter().any(|at| is_on(*at) != first)
    }

    /// On-road points: one set of columns (along) per row (across).
    fn on_road(&self, road: &Region, place: (f32, f32), turn: (f32, f32)) -> [u16; SIDE] {
        let bit = |at: (usize, usize)| u16::from(road.contains(self.point(at, place, turn))) << at.1;
        std::array::from_fn(|row| (0..SIDE).fold(0, |set, column| set | bit((row, column))))
    }

    /// The on-road point nearest to a point of the grid, as (row, column), and its squared distance.
    fn nearest(&self, on_road: &[u16; SIDE], row: usize, column: usize) -> ((usize, usize), f32) {
        let mut best = ((row, column), f32::INFINITY);
        for (other, set) in on_road.iter().enumerate() {
            if let Some(nearest) = nearest_column(*set, column) {
                let across = self.across_m[other] - self.across_m[row];
                let along = self.along_m[nearest] - self.along_m[column];
                let distance_sq = across * across + along * along;
                if distance_sq < best.1 {
                    best = ((other, nearest), distance_sq);
                }
            }
        }
        best
    }
}

impl MapCollision {
    pub(super) fn evaluate(&self, context: &GuidanceContext<'_>, plan: &Rollout, out: &mut Evaluation<'_>) {
        for agent in (0..context.num_agents()).filter(|a| out.wanted[*a] && context.moving[*a]) {
            let Some(road) = context.roads[agent] else { continue };
            let grid = Grid::new(context.length_m[agent], context.width_m[agent]);
            for t in 0..plan.num_steps {
                let at = agent * plan.num_steps + t;
                let (x, y, cos, sin) = (plan.x_m[at], plan.y_m[at], plan.cos[at], plan.sin[at]);
                if road.holds_square(Point2::new(x, y), 0.5 * grid.diagonal_m)
                    || !grid.is_partly_on(road, (x, y), (cos, sin))
                {
                    continue;
                }
                let on_road = grid.on_road(road, (x, y), (cos, sin));
                let weight = context.step_weights[t];
                // sums over off-road points: loss, and the gradient in the body's own axes and about its centre
                let (mut loss, mut forward, mut left, mut turn) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
                for row in 0..SIDE {
                    for column in (0..SIDE).filter(|c| on_road[row] >> c & 1 == 0) {
                        let ((r, c), distance_sq) = grid.nearest(&on_road, row, column);
                        let distance_m = distance_sq.sqrt();
                        loss += 1.0 - distance_m / grid.diagonal_m;
                        // d(1 - |c - q| / diagonal)/dq points from the on-road point q to the off-road point c
                        let size = 1.0 / (distance_m * grid.diagonal_m);
                        let (q_along, q_across) = (grid.along_m[c], grid.across_m[r]);
                        let (f, l) =
                            (size * (grid.along_m[column] - q_along), size * (grid.across_m[row] - q_across));
                        forward += f;
                        left += l;
                        turn += q_along * l - q_across * f;
                    }
                }
                out.losses[agent] += weight * loss;
                let scale = out.scale * weight;
                out.gradient.x[at] += scale * (forward * cos - left * sin);
                out.gradient.y[at] += scale * (forward * sin + left * cos);
                out.gradient.heading[at] += scale * turn;
            }
        }
    }
}
