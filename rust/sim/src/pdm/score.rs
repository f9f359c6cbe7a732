//! The score of proposals: what must not happen times a weighted mean of the rest, as nuPlan's closed loop.

use super::forecast::{AHEAD_S, Forecast};
use super::proposals::{Proposal, Rollout};
use super::{Plan, Scene};
use crate::events::WRONG_WAY_CLEARANCE_M;
use crate::geom::{OrientedBox, Point2, Real, Vector2};
use std::cell::OnceCell;

/// Who is slower than this stands, m/s.
const STANDS_MPS: Real = 0.05;
/// A box wider by this must stay on the road; by the second one, or it costs half, metres.
const EDGE_M: Real = 0.05;
const MARGIN_M: Real = 0.3;
/// What is left of the score where a proposal goes against traffic.
const WRONG_WAY: Real = 0.25;
/// Lanes farther than this say nothing, metres.
const LANE_REACH_M: Real = 5.0;
/// Cost of a metre beside the centre line: it settles ties.
const OFFSET_PER_M: Real = 1e-4;
/// An unavoidable contact within this time is braked for, s.
const BRAKE_S: Real = 2.0;
const BRAKE_MPS2: Real = -8.0;
/// Braking below [`SLOW_MPS`] m/s.
const SLOW_BRAKE_MPS2: Real = -4.05;
const SLOW_MPS: Real = 5.0;
/// Comfort: lowest and highest acceleration, highest lateral one (m/s²), jerk (m/s³).
const COMFORT: (Real, Real, Real, Real) = (-4.05, 2.4, 4.89, 8.37);

/// What the proposal does that is best in the mean over futures, or an emergency brake where most of them have a contact.
/// Of equals the first. Proposals whose progress cannot make up for the best so far are not looked at.
pub(super) fn best(scene: &Scene<'_>, proposals: &[Proposal], futures: &[(Forecast, Vec<Rollout>)]) -> Plan {
    let futures: Vec<Future<'_>> = futures
        .iter()
        .map(|(forecast, rollouts)| Future::new(scene, forecast, proposals, rollouts))
        .collect();
    let mean =
        |of: &dyn Fn(&Future<'_>) -> Real| futures.iter().map(of).sum::<Real>() / futures.len() as Real;
    let mut order: Vec<(usize, Real)> = (0..proposals.len()).map(|i| (i, mean(&|f| f.bound(i)))).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut best = (0, Real::NEG_INFINITY);
    for (i, bound) in order {
        if bound < best.1 {
            break;
        }
        let value = mean(&|f| f.score(i));
        if value > best.1 || value == best.1 && i < best.0 {
            best = (i, value);
        }
    }
    let first = &futures[0].rollouts[best.0];
    let brake_steps = (BRAKE_S / scene.dt_s).round() as usize;
    let hit = futures.iter().filter(|f| f.parts(best.0).contact.is_some_and(|t| t <= brake_steps)).count();
    let acceleration_mps2 = match 2 * hit > futures.len() {
        true if first.states[0].speed_mps < SLOW_MPS => SLOW_BRAKE_MPS2,
        true => BRAKE_MPS2,
        false => first.actions[0][0],
    };
    Plan { offset_m: proposals[best.0].offset_m, acceleration_mps2 }
}

/// Proposals in one future; what is scored of them is found when it is asked for.
struct Future<'a> {
    scene: &'a Scene<'a>,
    forecast: &'a Forecast,
    proposals: &'a [Proposal],
    rollouts: &'a [Rollout],
    parts: Vec<OnceCell<Parts>>,
    /// Most progress of a rollout, and of one times its product, metres.
    farthest_m: Real,
    most_m: Real,
}

impl<'a> Future<'a> {
    fn new(
        scene: &'a Scene<'a>,
        forecast: &'a Forecast,
        proposals: &'a [Proposal],
        rollouts: &'a [Rollout],
    ) -> Self {
        let parts = vec![OnceCell::new(); proposals.len()];
        let farthest_m = rollouts.iter().map(|r| r.progress_m).fold(1.0, Real::max);
        let mut found = Self { scene, forecast, proposals, rollouts, parts, farthest_m, most_m: 0.0 };
        let mut order: Vec<usize> = (0..proposals.len()).collect();
        order.sort_by(|a, b| rollouts[*b].progress_m.total_cmp(&rollouts[*a].progress_m));
        for i in order {
            if rollouts[i].progress_m <= found.most_m {
                break;
            }
            found.most_m = found.most_m.max(found.parts(i).product * rollouts[i].progress_m);
        }
        found
    }

    fn parts(&self, i: usize) -> &Parts {
        let make = || Parts::new(self.scene, self.forecast, &self.proposals[i], &self.rollouts[i]);
        self.parts[i].get_or_init(make)
    }

    /// Progress as a share of the most.
    fn progress(&self, i: usize) -> Real {
        let of_m = if self.most_m > 0.1 { self.most_m } else { self.farthest_m };
        (self.rollouts[i].progress_m / of_m).clamp(0.0, 1.0)
    }

    fn mean(&self, i: usize, product: Real, is_close: bool, is_calm: bool) -> Real {
        let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
        product * (5.0 * self.progress(i) + 5.0 * flag(!is_close) + 2.0 * flag(is_calm)) / 12.0
    }

    /// What the score is at most.
    fn bound(&self, i: usize) -> Real {
        self.mean(i, 1.0, false, true) - OFFSET_PER_M * self.proposals[i].offset_m.abs()
    }

    fn score(&self, i: usize) -> Real {
        let (p, steps) = (self.parts(i), self.forecast.num_steps as Real);
        let value = if p.product > 0.0 {
            self.mean(i, p.product, p.close, p.calm)
        } else {
            // all proposals fail: the latest contact first
            let contact = p.contact.map_or(steps, |t| t as Real) / steps;
            let clear = if p.close { 0.0 } else { 1.0 };
            1e-2 * contact - 5e-3 * p.off_road + 2e-3 * self.progress(i) + 1e-3 * clear - 0.1
        };
        value - OFFSET_PER_M * self.proposals[i].offset_m.abs()
    }
}

/// What is scored of a proposal.
#[derive(Clone)]
struct Parts {
    /// Step of the first contact at fault.
    contact: Option<usize>,
    /// Whether a contact is near at constant velocity.
    close: bool,
    /// Share of the steps off the road.
    off_road: Real,
    calm: bool,
    /// Of contact, road and direction.
    product: Real,
}

impl Parts {
    fn new(scene: &Scene<'_>, forecast: &Forecast, proposal: &Proposal, rollout: &Rollout) -> Self {
        let (contact, close) = contacts(scene, forecast, proposal, rollout);
        let (road, off_road) = road(scene, rollout);
        let product = if contact.is_some() { 0.0 } else { road * direction(scene, rollout) };
        Self { contact, close, off_road, calm: is_calm(scene, rollout), product }
    }
}

fn box_at(scene: &Scene<'_>, centre: Point2, direction: Vector2) -> OrientedBox {
    let own = scene.footprint(scene.ego);
    let (half_length_m, half_width_m) = (own.half_length_m, own.half_width_m);
    OrientedBox { centre, cos: direction.x, sin: direction.y, half_length_m, half_width_m }
}

/// Step of the first contact at fault, and whether one is close at constant velocity.
fn contacts(
    scene: &Scene<'_>,
    forecast: &Forecast,
    proposal: &Proposal,
    rollout: &Rollout,
) -> (Option<usize>, bool) {
    let own = scene.footprint(scene.ego);
    let (mut contact, mut close) = (None::<usize>, false);
    for other in &forecast.others {
        let near_sq = (own.radius_m + other.footprint.radius_m).powi(2);
        let touches = |step: usize, ahead_s: Real| {
            let (state, direction) = (&rollout.states[step], rollout.directions[step]);
            let centre = Point2::new(state.x, state.y) + direction * (state.speed_mps * ahead_s);
            let time_s = step as Real * scene.dt_s + ahead_s;
            (centre - other.centre(time_s)).norm_squared() < near_sq
                && box_at(scene, centre, direction).overlaps(&other.at(time_s))
        };
        // who touches already is no matter of this plan
        if touches(0, 0.0) {
            continue;
        }
        let first = (1..rollout.states.len()).find(|t| touches(*t, 0.0));
        if let Some(t) = first.filter(|t| contact.is_none_or(|c| *t < c))
            && at_fault(scene, proposal, rollout, t, other)
        {
            contact = Some(t);
        }
        for t in 0..first.unwrap_or(rollout.states.len()) {
            if close {
                break;
            }
            let (state, direction) = (&rollout.states[t], rollout.directions[t]);
            let way = other.centre(t as Real * scene.dt_s) - Point2::new(state.x, state.y);
            if state.speed_mps > STANDS_MPS && way.dot(&direction) > 0.0 {
                close = AHEAD_S.iter().any(|ahead_s| touches(t, *ahead_s));
            }
        }
    }
    (contact, close)
}

/// Whether a contact is the ego's fault: with its front, with who stands, or beside the centre of its lane.
fn at_fault(
    scene: &Scene<'_>,
    proposal: &Proposal,
    rollout: &Rollout,
    step: usize,
    other: &super::forecast::Other,
) -> bool {
    let (state, direction, own) =
        (&rollout.states[step], rollout.directions[step], scene.footprint(scene.ego));
    let (centre, time_s) = (Point2::new(state.x, state.y), step as Real * scene.dt_s);
    if state.speed_mps <= STANDS_MPS || (other.centre(time_s) - centre).dot(&direction) < -own.half_length_m {
        return false;
    }
    let nose = OrientedBox {
        centre: centre + direction * (own.half_length_m - 0.2),
        half_length_m: 0.25,
        ..box_at(scene, centre, direction)
    };
    other.speed_mps < STANDS_MPS || proposal.offset_m != 0.0 || nose.overlaps(&other.at(time_s))
}

/// What the road leaves of the score, and the share of steps off it; where a proposal starts off the road counts nothing.
fn road(scene: &Scene<'_>, rollout: &Rollout) -> (Real, Real) {
    let Some(region) = &scene.prepared.road else { return (1.0, 0.0) };
    let own = scene.footprint(scene.ego);
    let (mut been_on, mut been_inside, mut off, mut near) = (false, false, 0usize, false);
    for (state, direction) in rollout.states.iter().zip(&rollout.directions) {
        let centre = Point2::new(state.x, state.y);
        if region.holds_square(centre, own.radius_m + 1.5 * MARGIN_M) {
            (been_on, been_inside) = (true, true);
            continue;
        }
        let inside = |margin_m: Real| {
            let mut wide = box_at(scene, centre, *direction);
            wide.half_length_m += margin_m;
            wide.half_width_m += margin_m;
            wide.corners().iter().all(|corner| region.contains(*corner))
        };
        let is_on = inside(EDGE_M);
        let is_inside = is_on && inside(MARGIN_M);
        (been_on, been_inside) = (been_on || is_on, been_inside || is_inside);
        off += usize::from(been_on && !is_on);
        near |= been_inside && !is_inside;
    }
    let left = if off > 0 { 0.0 } else { 1.0 };
    (if near { 0.5 * left } else { left }, off as Real / rollout.states.len() as Real)
}

/// What driving direction leaves of the score: going against the only lane near costs, where it was right before.
fn direction(scene: &Scene<'_>, rollout: &Rollout) -> Real {
    let Some(lanes) = &scene.prepared.lanes else { return 1.0 };
    let mut been_right = false;
    for (state, direction) in rollout.states.iter().zip(&rollout.directions).step_by(2) {
        let at = Point2::new(state.x, state.y);
        let near = lanes.nearest_by_direction(at, direction.x, direction.y, LANE_REACH_M);
        let wrong = near.any.is_some_and(|hit| !hit.agrees())
            && near.agreeing.is_none_or(|hit| hit.distance_m > WRONG_WAY_CLEARANCE_M);
        been_right |= !wrong;
        if been_right && wrong {
            return WRONG_WAY;
        }
    }
    1.0
}

fn is_calm(scene: &Scene<'_>, rollout: &Rollout) -> bool {
    let (least, most, across, jerk) = COMFORT;
    let mut last = scene.states.acceleration_mps2[scene.ego];
    rollout.actions.iter().zip(&rollout.states).all(|([acceleration, yaw_rate], state)| {
        let change = (acceleration - last).abs() / scene.dt_s;
        last = *acceleration;
        *acceleration > least
            && *acceleration < most
            && (yaw_rate * state.speed_mps).abs() < across
            && change < jerk
    })
}
