//! What a choice of adversaries is made from: a row for each vehicle that may become one, nearest to the ego first.

use crate::causal::measures::{TTC_CAP_S, normalised_ttc};
use crate::error::Result;
use crate::geom::{Point2, Real, Vector2, math};
use crate::policy::{Driver, PlanRecord, WorldView};
use crate::scene::AgentKind;
use crate::world::VecWorld;
use serde::Serialize;
use std::array::from_fn;

/// Features are cut off at plus and minus this.
pub const CANDIDATE_BOUND: Real = 3.0;
/// Times at which the ego and a candidate are looked for, every half second up to 4 s.
const NUM_TIMES: usize = 9;
const TIME_STEP_S: Real = 0.5;
/// Places on the ego's route that a candidate's way is compared with, every 4 m up to 40 m.
const NUM_PLACES: usize = 11;
const PLACE_STEP_M: Real = 4.0;
/// Places on a candidate's straight way, every 3 m up to 30 m.
const WAY_PLACES: usize = 11;
const WAY_STEP_M: Real = 3.0;
/// Steps of the latest plan that are looked at, every fourth of the coming 32.
const PLAN_STEPS: usize = 32;
const PLAN_STRIDE: usize = 4;

/// A feature of a row.
#[derive(Clone, Copy, Serialize)]
pub struct CandidateFeature {
    /// Name.
    pub name: &'static str,
    /// Unit; empty for numbers without one.
    pub unit: &'static str,
    /// The feature is divided by this.
    pub scale: Real,
    /// What it is.
    pub doc: &'static str,
}

const fn of(name: &'static str, unit: &'static str, scale: Real, doc: &'static str) -> CandidateFeature {
    CandidateFeature { name, unit, scale, doc }
}

/// Features of a candidate; behind them, those of the ego, which are the same in all rows.
const NUM_OWN: usize = 18;
const NUM_FEATURES: usize = NUM_OWN + 2;

/// Features of a row, in order.
pub const CANDIDATE_FEATURES: [CandidateFeature; NUM_FEATURES] = [
    of("present", "", 1.0, "1; 0 in rows without a candidate, as all features but the ego's"),
    of("cos_heading", "", 1.0, "cosine of the heading relative to the ego's"),
    of("sin_heading", "", 1.0, "sine of it"),
    of("velocity_x", "m/s", 15.0, "relative to the ego, in its frame"),
    of("velocity_y", "m/s", 15.0, "relative to the ego, in its frame"),
    of("speed", "m/s", 15.0, "along the vehicle's own heading"),
    of("distance", "m", 50.0, "distance of the centres, at most 50 m"),
    of("near", "", 1.0, "exp(-distance / 10 m)"),
    of(
        "approach",
        "m",
        30.0,
        "closest approach in 4 s at constant velocity, the ego along its route, at most 30 m",
    ),
    of("near_approach", "", 1.0, "exp(-approach / 5 m)"),
    of("approach_time", "s", 4.0, "time of the closest approach"),
    of(
        "crossing",
        "m",
        20.0,
        "least distance of its next 30 m straight on from the ego's next 40 m of route, at most 20 m",
    ),
    of("crossing_lead", "s", 5.0, "how much later than the ego it is there, within 10 s"),
    of("crossing_time", "s", 10.0, "when the ego is there, at most 10 s"),
    of("route_distance", "m", 20.0, "distance from the ego's next 40 m of route, at most 20 m"),
    of("route_ahead", "m", 40.0, "how far ahead on the route that is"),
    of("ttc", "", 1.0, "time to contact with the ego: 1 now, 0 in 20 s or never"),
    of(
        "plan_approach",
        "m",
        30.0,
        "closest approach in the coming 3.2 s of its latest plan, at most 30 m, also without one",
    ),
    of("ego_speed", "m/s", 15.0, "of the ego, the same in all rows, as what follows"),
    of("time_left", "", 1.0, "share of the episode that is left"),
];

/// The candidates of a world, at most R, and what is seen of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidates {
    /// Agents of the scene, nearest to the ego first.
    pub agents: Vec<usize>,
    /// Features [R, F] over their scales, cut off at [`CANDIDATE_BOUND`].
    pub features: Vec<Real>,
}

impl Candidates {
    /// The vehicles that `may_be_chosen` among those that are there and move, at most `num_rows` of them; nobody, and zeros, without an ego.
    ///
    /// `plan` is the latest plan of who drives them.
    pub fn new(
        world: &WorldView<'_>,
        plan: Option<&PlanRecord>,
        may_be_chosen: impl Fn(usize) -> bool,
        num_rows: usize,
    ) -> Self {
        let states = world.states;
        let Some(ego) = world.ego.filter(|ego| states.active[*ego]) else {
            return Self { agents: Vec::new(), features: vec![0.0; num_rows * NUM_FEATURES] };
        };
        let from_ego = |a: usize| (states.position(a) - states.position(ego)).norm();
        let is_candidate = |a: &usize| {
            *a != ego
                && states.active[*a]
                && world.scene.kinds[*a] == AgentKind::Vehicle
                && !world.halted[*a]
                && !world.scene.routes[*a].is_parked()
                && states.same_level(ego, *a)
                && may_be_chosen(*a)
        };
        let mut agents: Vec<usize> = (0..states.len()).filter(is_candidate).collect();
        agents.sort_by(|a, b| from_ego(*a).total_cmp(&from_ego(*b)).then(a.cmp(b)));
        agents.truncate(num_rows);
        let left = world.horizon_steps.saturating_sub(world.elapsed_steps);
        let shared = [states.speed_mps[ego], left as Real / world.horizon_steps.max(1) as Real];
        let way = EgoWay::new(world, plan, ego);
        let rows = agents.iter().map(|a| way.row(world, *a)).chain(std::iter::repeat([0.0; NUM_OWN]));
        let values = rows.take(num_rows).flat_map(|row| row.into_iter().chain(shared));
        let scaled = values.zip(CANDIDATE_FEATURES.iter().cycle()).map(|(value, f)| value / f.scale);
        let features = scaled.map(|value| value.clamp(-CANDIDATE_BOUND, CANDIDATE_BOUND)).collect();
        Self { agents, features }
    }
}

impl VecWorld {
    /// The candidates of a world: vehicles whose drivers plan. At most `num_rows` of them.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn candidates(&self, world_idx: usize, num_rows: usize) -> Result<Candidates> {
        self.status(world_idx)?;
        let (world, planners) = (self.world(world_idx)?, self.policies.planners());
        let plan = planners.first().and_then(|p| world.episode.plans[usize::from(*p)].as_ref());
        let plans = |a: usize| match world.episode.drivers[a] {
            Driver::Policy(p) => planners.contains(&p) && !world.episode.has_slot(a),
            Driver::External | Driver::Towed => false,
        };
        Ok(Candidates::new(&world.view(&self.config), plan.map(|p| &p.record), plans, num_rows))
    }
}

/// Where the ego goes along its route from where it is, in steps of [`PLACE_STEP_M`] and, at constant speed, of [`TIME_STEP_S`].
struct EgoWay<'a> {
    ego: usize,
    places: [Point2; NUM_PLACES],
    times: [Point2; NUM_TIMES],
    /// At steps of the latest plan.
    plan: Option<(&'a PlanRecord, Vec<(usize, Point2)>)>,
}

impl<'a> EgoWay<'a> {
    fn new(world: &WorldView<'_>, plan: Option<&'a PlanRecord>, ego: usize) -> Self {
        let (path, s_m) = (&world.scene.routes[ego].path, world.route_s_m[ego]);
        let along = |ahead_m: Real| path.at(s_m + ahead_m).position;
        let speed_mps = world.states.speed_mps[ego].max(0.0);
        let plan = plan.map(|plan| {
            let from = world.elapsed_steps.saturating_sub(plan.made_at);
            let steps = (from..plan.num_steps).take(PLAN_STEPS).step_by(PLAN_STRIDE);
            let ahead_m = |t: usize| (t - from + 1) as Real * world.dt_s * speed_mps;
            (plan, steps.map(|t| (t, along(ahead_m(t)))).collect())
        });
        Self {
            ego,
            places: from_fn(|i| along(i as Real * PLACE_STEP_M)),
            times: from_fn(|i| along(i as Real * TIME_STEP_S * speed_mps)),
            plan,
        }
    }

    /// The features of a candidate, in the frame of the ego.
    fn row(&self, world: &WorldView<'_>, a: usize) -> [Real; NUM_OWN] {
        let (states, ego) = (world.states, self.ego);
        let (pose, velocity, ego_pose) = (states.pose(a), states.velocity(a), states.pose(ego));
        let heading = ego_pose.rotate_inverse(Vector2::new(pose.cos, pose.sin));
        let relative = ego_pose.rotate_inverse(velocity - states.velocity(ego));
        let distance_m = (pose.position - ego_pose.position).norm();
        let gap = |i: usize| (pose.position + velocity * (i as Real * TIME_STEP_S) - self.times[i]).norm();
        let (approach, approach_m) = least((0..NUM_TIMES).map(gap));
        let way = |i: usize| pose.position + Vector2::new(pose.cos, pose.sin) * (i as Real * WAY_STEP_M);
        let pairs = (0..WAY_PLACES).flat_map(|i| self.places.iter().map(move |p| (way(i) - p).norm()));
        let (crossing, crossing_m) = least(pairs);
        // a vehicle that stands is taken to begin to move
        let time_s = |way_m: Real, speed_mps: Real| way_m / speed_mps.max(1.0);
        let crossing_s = time_s((crossing % NUM_PLACES) as Real * PLACE_STEP_M, states.speed_mps[ego]);
        let its_s = time_s((crossing / NUM_PLACES) as Real * WAY_STEP_M, states.speed_mps[a]);
        let (ahead, route_m) = least(self.places.iter().map(|p| (pose.position - p).norm()));
        let planned_m = self.plan.as_ref().and_then(|(plan, steps)| {
            let row = plan.agents.iter().position(|b| *b == a)?;
            let first = (plan.selected_sample[row] * plan.agents.len() + row) * plan.num_steps;
            let at = |t: usize| Point2::new(plan.samples[3 * (first + t)], plan.samples[3 * (first + t) + 1]);
            Some(least(steps.iter().map(|(t, p)| (at(*t) - p).norm())).1)
        });
        let [own, egos] = [a, ego].map(|a| states.oriented_box(a, &world.scene.footprints[a]));
        let ttc_s = egos.time_to_contact(states.velocity(ego), &own, velocity, TTC_CAP_S);
        [
            1.0,
            heading.x,
            heading.y,
            relative.x,
            relative.y,
            states.speed_mps[a],
            distance_m.min(50.0),
            math::exp(-0.1 * distance_m),
            approach_m.min(30.0),
            math::exp(-0.2 * approach_m),
            approach as Real * TIME_STEP_S,
            crossing_m.min(20.0),
            (its_s - crossing_s).clamp(-10.0, 10.0),
            crossing_s.min(10.0),
            route_m.min(20.0),
            ahead as Real * PLACE_STEP_M,
            normalised_ttc(ttc_s.unwrap_or(TTC_CAP_S)),
            planned_m.unwrap_or(Real::INFINITY).min(30.0),
        ]
    }
}

/// Place and value of the least of some numbers, the first of several.
fn least(values: impl Iterator<Item = Real>) -> (usize, Real) {
    values.enumerate().fold((0, Real::INFINITY), |best, (i, v)| if v < best.1 { (i, v) } else { best })
}
