//! The score of proposals: what must not happen times a weighted mean of the rest, as nuPlan's closed loop.

use super::comfort::is_calm;
use super::forecast::{AHEAD_S, Forecast};
use super::proposals::Rollout;
use super::{Plan, Scene};
use crate::events::limits::{ACCELERATION_MPS2, AHEAD_COS, STANDING_MPS, STOPPED_MPS};
use crate::events::{bearing_cos, in_intersection, is_at_fault};
use crate::geom::{OrientedBox, Pose2, Real};
use crate::scene::LaneKind;
use std::cell::OnceCell;

/// Less progress than this is none, metres.
const LEAST_PROGRESS_M: Real = 0.1;
/// What is left of the score where static obstacles are hit.
const STATIC: Real = 0.5;
/// A box wider by this must stay on the road; by the second one, or it costs half, metres.
const EDGE_M: Real = 0.05;
const MARGIN_M: Real = 0.3;
/// Metres against traffic that cost half of the score, and all of it.
const AGAINST_M: [Real; 2] = [2.0, 6.0];
/// Lanes farther than this say nothing, metres.
const LANE_REACH_M: Real = 5.0;
/// An unavoidable contact within this time is braked for, s.
const BRAKE_S: Real = 2.0;
const BRAKE_MPS2: Real = -8.0;
/// Below this speed with the most that is comfortable, m/s.
const SLOW_MPS: Real = 5.0;

/// The action of the best proposal, of equals the first, or an emergency brake where it has a contact.
pub(super) fn best(scene: &Scene<'_>, forecast: &Forecast, rollouts: &[Rollout]) -> Plan {
    let scores = Scores::new(scene, forecast, rollouts);
    let mut order: Vec<(usize, Real)> = (0..rollouts.len()).map(|i| (i, scores.bound(i))).collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut best = (0, Real::NEG_INFINITY);
    for (i, bound) in order {
        if bound < best.1 {
            break;
        }
        // comfort, then contacts, cost less to find than the rest
        if scores.mean(i, 1.0, false, scores.calm(i)) < best.1
            || scores.mean(i, 1.0, scores.contacts(i).close, scores.calm(i)) < best.1
        {
            continue;
        }
        let value = scores.score(i);
        if value > best.1 || value == best.1 && i < best.0 {
            best = (i, value);
        }
    }
    let first = &rollouts[best.0];
    let brake_steps = (BRAKE_S / scene.dt_s).round() as usize;
    let acceleration_mps2 = match scores.contacts(best.0).first.is_some_and(|t| t <= brake_steps) {
        true if first.speeds_mps[0] < SLOW_MPS => ACCELERATION_MPS2[0],
        true => BRAKE_MPS2,
        false => first.actions[0][0],
    };
    Plan { offset_m: first.offset_m, acceleration_mps2 }
}

/// Proposals, scored.
struct Scores<'a> {
    scene: &'a Scene<'a>,
    forecast: &'a Forecast,
    rollouts: &'a [Rollout],
    parts: Vec<Parts>,
    /// Most progress of a rollout times its product, metres.
    most_m: Real,
}

/// What is scored of a proposal, each found when it is asked for.
#[derive(Clone, Default)]
struct Parts {
    calm: OnceCell<bool>,
    contacts: OnceCell<Contacts>,
    /// What the road leaves, and the share of the steps off it.
    road: OnceCell<(Real, Real)>,
    /// Of contacts, road and direction.
    product: OnceCell<Real>,
}

/// Contacts of a proposal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contacts {
    /// What those at fault leave of the score.
    pub left: Real,
    /// Step of the first one at fault.
    pub first: Option<usize>,
    /// Whether one is near at constant velocity.
    pub close: bool,
}

impl<'a> Scores<'a> {
    fn new(scene: &'a Scene<'a>, forecast: &'a Forecast, rollouts: &'a [Rollout]) -> Self {
        let parts = vec![Parts::default(); rollouts.len()];
        let mut found = Self { scene, forecast, rollouts, parts, most_m: 0.0 };
        let mut order: Vec<usize> = (0..rollouts.len()).collect();
        order.sort_by(|a, b| rollouts[*b].progress_m.total_cmp(&rollouts[*a].progress_m));
        for i in order {
            if rollouts[i].progress_m <= found.most_m {
                break;
            }
            found.most_m = found.most_m.max(found.product(i) * rollouts[i].progress_m);
        }
        found
    }

    fn calm(&self, i: usize) -> bool {
        let before = self.scene.states.acceleration_mps2[self.scene.ego];
        *self.parts[i].calm.get_or_init(|| is_calm(&self.rollouts[i], before, self.scene.dt_s))
    }

    fn contacts(&self, i: usize) -> &Contacts {
        self.parts[i].contacts.get_or_init(|| contacts(self.scene, self.forecast, &self.rollouts[i]))
    }

    fn road(&self, i: usize) -> (Real, Real) {
        *self.parts[i].road.get_or_init(|| road(self.scene, &self.rollouts[i]))
    }

    fn product(&self, i: usize) -> Real {
        let left = self.contacts(i).left;
        *self.parts[i].product.get_or_init(|| {
            if left == 0.0 || self.road(i).0 == 0.0 {
                return 0.0;
            }
            left * self.road(i).0 * direction(self.scene, &self.rollouts[i])
        })
    }

    /// Progress as a share of the most; 1 for all where none makes any.
    fn progress(&self, i: usize, product: Real) -> Real {
        if self.most_m > LEAST_PROGRESS_M {
            (product * self.rollouts[i].progress_m / self.most_m).clamp(0.0, 1.0)
        } else {
            1.0
        }
    }

    fn mean(&self, i: usize, product: Real, is_close: bool, is_calm: bool) -> Real {
        let flag = |holds: bool| if holds { 1.0 } else { 0.0 };
        product * (5.0 * self.progress(i, product) + 5.0 * flag(!is_close) + 2.0 * flag(is_calm)) / 12.0
    }

    /// What the score is at most.
    fn bound(&self, i: usize) -> Real {
        self.mean(i, 1.0, false, true)
    }

    fn score(&self, i: usize) -> Real {
        let (Contacts { first, close, .. }, product) = (self.contacts(i), self.product(i));
        if product > 0.0 {
            return self.mean(i, product, *close, self.calm(i));
        }
        // all proposals fail: the latest contact first
        let steps = self.forecast.num_steps as Real;
        let contact = first.map_or(steps, |t| t as Real) / steps;
        let clear = if *close { 0.0 } else { 1.0 };
        1e-2 * contact - 5e-3 * self.road(i).1 + 2e-3 * self.progress(i, 1.0) + 1e-3 * clear - 0.1
    }
}

/// Contacts with all others; close ones come soon at constant speed, ahead or beside an ego between lanes.
pub(super) fn contacts(scene: &Scene<'_>, forecast: &Forecast, rollout: &Rollout) -> Contacts {
    let (mut left, mut first, mut close) = (1.0, None::<usize>, false);
    let (own, dt_s) = (scene.footprint(scene.ego), scene.dt_s);
    let ego_mps = rollout.speeds_mps.iter().copied().fold(0.0, Real::max);
    for other in &forecast.others {
        let (reach_m, most_mps) = (own.radius_m + other.footprint.radius_m, ego_mps + other.speed_mps);
        // whether both touch at a step, or would some time after it at the ego's constant speed
        let touch = |step: usize, ahead_s: Real| {
            let mut body = own.at(&rollout.poses[step]);
            body.centre += body.forward() * (rollout.speeds_mps[step] * ahead_s);
            let time_s = step as Real * dt_s + ahead_s;
            (body.centre - other.centre(time_s)).norm_squared() < reach_m * reach_m
                && body.overlaps(&other.at(time_s))
        };
        // the next step at which both may touch within the time that is looked ahead
        let near = |from: usize| {
            let mut t = from;
            while let Some(pose) = rollout.poses.get(t) {
                let way = other.centre(t as Real * dt_s) - pose.position;
                let clear_m = way.norm() - reach_m - most_mps * AHEAD_S[AHEAD_S.len() - 1] - 0.01;
                if clear_m <= 0.0 {
                    return Some(t);
                }
                // nearer by this much a step; where nothing moves, never
                t = t.saturating_add(1 + (clear_m / (most_mps * dt_s)).min(1e6) as usize);
            }
            None
        };
        let mut steps = std::iter::successors(near(0), |t| near(t + 1));
        let body = |t: usize| own.at(&rollout.poses[t]);
        if let Some(t) = steps.clone().find(|t| *t > 0 && touch(*t, 0.0)) {
            let stands = [rollout.speeds_mps[t], other.speed_mps].map(|speed_mps| speed_mps <= STOPPED_MPS);
            let there = other.at(t as Real * dt_s);
            if is_at_fault(&body(t), &there, stands, || is_between_lanes(scene, &body(t), false)) {
                left = Real::min(left, if other.is_static { STATIC } else { 0.0 });
                first = Some(first.map_or(t, |f| f.min(t)));
            }
        }
        let is_close = |t: &usize| {
            rollout.speeds_mps[*t] >= STANDING_MPS && AHEAD_S.iter().any(|ahead_s| touch(*t, *ahead_s))
        };
        close = close
            || steps.find(is_close).is_some_and(|t| {
                let cos = bearing_cos(&body(t), other.centre(t as Real * dt_s));
                cos > AHEAD_COS || cos >= -AHEAD_COS && is_between_lanes(scene, &body(t), true)
            });
    }
    Contacts { left, first, close }
}

/// Whether a body is off the road or in several lanes and in none of them whole; or, where asked for, in an intersection.
fn is_between_lanes(scene: &Scene<'_>, body: &OrientedBox, or_in_intersection: bool) -> bool {
    let (centre, corners) = (body.centre, body.corners());
    let ground = scene.ground(centre);
    if ground.road.as_ref().is_some_and(|road| !road.holds_box(body)) {
        return true;
    }
    let Some(lanes) = &ground.lanes else { return false };
    let map = &scene.prepared.scene.map;
    if or_in_intersection && in_intersection(lanes, map, centre) {
        return true;
    }
    let mut held: Vec<usize> = corners.iter().flat_map(|c| lanes.holding(map, *c)).collect();
    held.sort_unstable();
    let whole = held.chunk_by(|a, b| a == b).any(|corners| corners.len() == 4);
    held.dedup();
    held.len() > 1 && !whole
}

/// What the road leaves of the score, and the share of steps off it; where a proposal starts off the road counts nothing.
fn road(scene: &Scene<'_>, rollout: &Rollout) -> (Real, Real) {
    if scene.prepared.road.is_none() {
        return (1.0, 0.0);
    }
    let own = scene.footprint(scene.ego);
    let (mut been_on, mut been_inside, mut off, mut near) = (false, false, 0usize, false);
    for pose in &rollout.poses {
        let Some(region) = &scene.ground(pose.position).road else { continue };
        if region.holds_square(pose.position, own.radius_m + 1.5 * MARGIN_M) {
            (been_on, been_inside) = (true, true);
            continue;
        }
        let inside = |margin_m: Real| {
            let mut wide = own.at(pose);
            wide.half_length_m += margin_m;
            wide.half_width_m += margin_m;
            region.holds_box(&wide)
        };
        let is_on = inside(EDGE_M);
        let is_inside = is_on && inside(MARGIN_M);
        (been_on, been_inside) = (been_on || is_on, been_inside || is_inside);
        off += usize::from(been_on && !is_on);
        near |= been_inside && !is_inside;
    }
    let left = if off > 0 { 0.0 } else { 1.0 };
    (if near { 0.5 * left } else { left }, off as Real / rollout.poses.len() as Real)
}

/// What driving direction leaves of the score, by the longest way against traffic from [`AGAINST_M`] on.
pub(super) fn direction(scene: &Scene<'_>, rollout: &Rollout) -> Real {
    let way_m = |step: usize| (rollout.poses[step].position - rollout.poses[step - 1].position).norm();
    let against = |step: usize| is_against_traffic(scene, &rollout.poses[step]);
    let (last, mut most_m, mut clear) = (rollout.poses.len() - 1, 0.0 as Real, 0);
    while clear < last {
        let (mut step, mut between_m) = (clear + 1, 0.0);
        while step < last && between_m + way_m(step) < AGAINST_M[0] {
            between_m += way_m(step);
            step += 1;
        }
        if against(step) {
            let first = (clear + 1..step).rev().take_while(|t| against(*t)).last().unwrap_or(step);
            let run = (first..=last).take_while(|t| *t <= step || against(*t));
            (step, between_m) = run.fold((first, 0.0), |(_, sum_m), t| (t + 1, sum_m + way_m(t)));
            most_m = most_m.max(between_m);
        }
        clear = step;
    }
    if most_m < AGAINST_M[0] {
        1.0
    } else if most_m < AGAINST_M[1] {
        0.5
    } else {
        0.0
    }
}

/// Whether the lanes that hold a point lead the other way; ways through intersections say nothing.
fn is_against_traffic(scene: &Scene<'_>, pose: &Pose2) -> bool {
    let Some(lanes) = &scene.ground(pose.position).lanes else { return false };
    let near = lanes.nearest_by_direction(pose.position, pose.cos, pose.sin, LANE_REACH_M);
    if near.any.is_none_or(|hit| hit.agrees()) {
        return false;
    }
    let map = &scene.prepared.scene.map;
    let mut opposed = false;
    for lane_idx in lanes.holding(map, pose.position) {
        let hit = lanes.on_lane(lane_idx, pose.position, pose.cos, pose.sin);
        let agrees = hit.is_some_and(|hit| hit.agrees());
        if agrees || map.lanes[lane_idx].kind == LaneKind::Connector {
            return false;
        }
        opposed = true;
    }
    opposed
}
