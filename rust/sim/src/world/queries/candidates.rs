//! What a choice of adversaries is made from: a row for each vehicle that may become one, nearest to the ego first.

use crate::causal::measures::{TTC_CAP_S, normalised_ttc};
use crate::drivers::{Driver, PlanRecord, WorldView};
use crate::error::Result;
use crate::geom::{Point2, Real, Vector2, math};
use crate::scene::AgentKind;
use crate::world::VecWorld;
use std::array::from_fn;
use std::iter::repeat;

/// Features are cut off at plus and minus this.
pub const CANDIDATE_BOUND: Real = 3.0;
/// Features of a candidate; behind them, those of the ego, which are the same in all rows.
pub const OWN_FEATURES: usize = 18;
const NUM_FEATURES: usize = OWN_FEATURES + 2;
/// Features of a row, in order: name, unit, what it is divided by, what it is.
pub const CANDIDATE_FEATURES: [(&str, &str, Real, &str); NUM_FEATURES] = [
    ("present", "", 1.0, "1; 0 in rows without a candidate, as all features but the ego's"),
    ("cos_heading", "", 1.0, "cosine of the heading relative to the ego's"),
    ("sin_heading", "", 1.0, "sine of it"),
    ("velocity_x", "m/s", 15.0, "relative to the ego, in its frame"),
    ("velocity_y", "m/s", 15.0, "relative to the ego, in its frame"),
    ("speed", "m/s", 15.0, "along the vehicle's own heading"),
    ("distance", "m", 50.0, "distance of the centres, at most 50 m"),
    ("near", "", 1.0, "exp(-distance / 10 m)"),
    ("approach", "m", 30.0, "closest in 4 s at constant velocity, the ego along its route, at most 30 m"),
    ("near_approach", "", 1.0, "exp(-approach / 5 m)"),
    ("approach_time", "s", 4.0, "time of the closest approach"),
    ("crossing", "m", 20.0, "least distance of its next 30 m straight on from the route, at most 20 m"),
    ("crossing_lead", "s", 5.0, "how much later than the ego it is there, within 10 s"),
    ("crossing_time", "s", 10.0, "when the ego is there, at most 10 s"),
    ("route_distance", "m", 20.0, "distance from the ego's next 40 m of route, at most 20 m"),
    ("route_ahead", "m", 40.0, "how far ahead on the route that is"),
    ("ttc", "", 1.0, "time to contact with the ego: 1 now, 0 in 20 s or never"),
    (
        "plan_approach",
        "m",
        30.0,
        "closest in the coming 3.2 s of its latest plan; without one 30 m, the most",
    ),
    ("ego_speed", "m/s", 15.0, "of the ego, the same in all rows, as what follows"),
    ("time_left", "", 1.0, "share of the episode that is left"),
];
/// Where the ego and a candidate are looked for: every half second up to 4 s; places on the ego's route every 4 m up to 40 m.
const NUM_TIMES: usize = 9;
const NUM_PLACES: usize = 11;
const TIME_STEP_S: Real = 0.5;
const PLACE_STEP_M: Real = 4.0;
/// The same number of places on a candidate's way, straight on up to 30 m.
const WAY_STEP_M: Real = 3.0;

/// The candidates of a world, at most R, and what is seen of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidates {
    /// Agents of the scene, nearest to the ego first.
    pub agents: Vec<usize>,
    /// Features [R, F] over their scales, cut off at [`CANDIDATE_BOUND`].
    pub features: Vec<Real>,
}

impl Candidates {
    /// At most `num_rows` vehicles that `may_be_chosen` among those that are there and move; none without an ego.
    ///
    /// `plan` is the latest plan of their driver.
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
        let rows = agents.iter().map(row_of(world, plan, ego)).chain(repeat([0.0; OWN_FEATURES]));
        let values = rows.take(num_rows).flat_map(|row| row.into_iter().chain(shared));
        let scaled =
            values.zip(CANDIDATE_FEATURES.iter().cycle()).map(|(value, (_, _, scale, _))| value / scale);
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
        let (world, planners) = (self.begun(world_idx)?, &self.drivers.planners);
        let plan = planners.first().and_then(|p| world.episode.plans[usize::from(*p)].as_ref());
        let plans = |a: usize| match world.episode.drivers[a] {
            Driver::Model(p) => planners.contains(&p) && !world.episode.has_slot(a),
            Driver::External | Driver::Towed => false,
        };
        Ok(Candidates::new(&world.view(&self.config), plan.map(|p| &p.record), plans, num_rows))
    }
}

/// What gives the features of a candidate, in the frame of the ego, which goes on along its route at constant speed.
fn row_of<'a>(
    world: &'a WorldView<'_>,
    plan: Option<&'a PlanRecord>,
    ego: usize,
) -> impl Fn(&usize) -> [Real; OWN_FEATURES] + 'a {
    let (states, path, s_m) = (world.states, &world.scene.routes[ego].path, world.route_s_m[ego]);
    let along = |ahead_m: Real| path.at(s_m + ahead_m).position;
    let speed_mps = states.speed_mps[ego].max(0.0);
    let places: [Point2; NUM_PLACES] = from_fn(|i| along(i as Real * PLACE_STEP_M));
    let times: [Point2; NUM_TIMES] = from_fn(|i| along(i as Real * TIME_STEP_S * speed_mps));
    // every fourth of the coming 32 steps of the latest plan
    let plan = plan.map(|plan| {
        let from = world.elapsed_steps.saturating_sub(plan.made_at);
        let place = |t: usize| (t, along((t - from + 1) as Real * world.dt_s * speed_mps));
        (plan, (from..plan.num_steps).take(32).step_by(4).map(place).collect::<Vec<_>>())
    });
    move |&a| {
        let (pose, velocity, ego_pose) = (states.pose(a), states.velocity(a), states.pose(ego));
        let heading = ego_pose.rotate_inverse(Vector2::new(pose.cos, pose.sin));
        let relative = ego_pose.rotate_inverse(velocity - states.velocity(ego));
        let distance_m = (pose.position - ego_pose.position).norm();
        let gap = |i: usize| (pose.position + velocity * (i as Real * TIME_STEP_S) - times[i]).norm();
        let (approach, approach_m) = least((0..times.len()).map(gap));
        let way = |i: usize| pose.position + Vector2::new(pose.cos, pose.sin) * (i as Real * WAY_STEP_M);
        let pairs = (0..NUM_PLACES).flat_map(|i| places.iter().map(move |p| (way(i) - p).norm()));
        let (crossing, crossing_m) = least(pairs);
        // a vehicle that stands is taken to begin to move
        let time_s = |way_m: Real, speed_mps: Real| way_m / speed_mps.max(1.0);
        let crossing_s = time_s((crossing % NUM_PLACES) as Real * PLACE_STEP_M, states.speed_mps[ego]);
        let its_s = time_s((crossing / NUM_PLACES) as Real * WAY_STEP_M, states.speed_mps[a]);
        let (ahead, route_m) = least(places.iter().map(|p| (pose.position - p).norm()));
        let planned_m = plan.as_ref().and_then(|(plan, steps)| {
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
