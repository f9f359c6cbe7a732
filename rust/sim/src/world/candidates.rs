//! What a choice of adversaries is made from: a row for each vehicle that may become one, nearest to the ego first.

use crate::causal::measures::{AgentFrame, Ttc, normalised_ttc};
use crate::error::Result;
use crate::geom::{Point2, Pose2, Real, Vector2, math};
use crate::policy::{Driver, PlanRecord, WorldView};
use crate::scene::AgentKind;
use crate::world::VecWorld;
use serde::Serialize;

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
/// Times to a place are not those of a vehicle slower than this, m/s.
const LEAST_SPEED_MPS: Real = 1.0;
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
    #[serde(skip)]
    of: fn(&EgoFacts, &Facts) -> Real,
}

/// What all rows have in common, in the frame of the ego.
#[derive(Default)]
struct EgoFacts {
    speed_mps: Real,
    acceleration_mps2: Real,
    time_left: Real,
    route_left_m: Real,
    at_10_m: Vector2,
    at_20_m: Vector2,
    at_40_m: Vector2,
    share_of_rows: Real,
}

/// What is found out about a candidate, in the frame of the ego; zero in rows without one.
#[derive(Default)]
struct Facts {
    present: Real,
    at: Vector2,
    cos: Real,
    sin: Real,
    velocity: Vector2,
    speed_mps: Real,
    acceleration_mps2: Real,
    distance_m: Real,
    approach_m: Real,
    approach_s: Real,
    crossing_m: Real,
    crossing_lead_s: Real,
    crossing_s: Real,
    route_distance_m: Real,
    route_ahead_m: Real,
    ttc_s: Real,
    planned: Real,
    plan_gap_m: Real,
    plan_route_gap_m: Real,
    plan_route_s: Real,
    was_guided: Real,
}

macro_rules! features {
    ($($name:literal, $unit:literal, $scale:literal, $doc:literal, $of:expr;)+) => {
        /// Features of a row, in order.
        pub const CANDIDATE_FEATURES: &[CandidateFeature] =
            &[$(CandidateFeature { name: $name, unit: $unit, scale: $scale, doc: $doc, of: $of }),+];
    };
}

features! {
    "present", "", 1.0, "1; 0 in rows without a candidate, as all features but the ego's", |_, r| r.present;
    "x", "m", 50.0, "ahead of the ego", |_, r| r.at.x;
    "y", "m", 50.0, "to the left of the ego", |_, r| r.at.y;
    "cos_heading", "", 1.0, "cosine of the heading relative to the ego's", |_, r| r.cos;
    "sin_heading", "", 1.0, "sine of it", |_, r| r.sin;
    "velocity_x", "m/s", 15.0, "relative to the ego, in its frame", |_, r| r.velocity.x;
    "velocity_y", "m/s", 15.0, "relative to the ego, in its frame", |_, r| r.velocity.y;
    "speed", "m/s", 15.0, "along the vehicle's own heading", |_, r| r.speed_mps;
    "acceleration", "m/s2", 5.0, "change of speed over the last step", |_, r| r.acceleration_mps2;
    "distance", "m", 50.0, "distance of the centres, at most 50 m", |_, r| r.distance_m.min(50.0);
    "near", "", 1.0, "exp(-distance / 10 m)", |_, r| r.present * math::exp(-0.1 * r.distance_m);
    "approach", "m", 30.0, "closest approach in 4 s at constant velocity, the ego along its route, at most 30 m",
        |_, r| r.approach_m.min(30.0);
    "near_approach", "", 1.0, "exp(-approach / 5 m)", |_, r| r.present * math::exp(-0.2 * r.approach_m);
    "approach_time", "s", 4.0, "time of the closest approach", |_, r| r.approach_s;
    "crossing", "m", 20.0, "least distance of its next 30 m straight on from the ego's next 40 m of route, at most 20 m",
        |_, r| r.crossing_m.min(20.0);
    "crossing_lead", "s", 5.0, "how much later than the ego it is there, within 10 s",
        |_, r| r.crossing_lead_s.clamp(-10.0, 10.0);
    "crossing_time", "s", 10.0, "when the ego is there, at most 10 s", |_, r| r.crossing_s.min(10.0);
    "route_distance", "m", 20.0, "distance from the ego's next 40 m of route, at most 20 m",
        |_, r| r.route_distance_m.min(20.0);
    "route_ahead", "m", 40.0, "how far ahead on the route that is", |_, r| r.route_ahead_m;
    "ttc", "", 1.0, "time to contact with the ego: 1 now, 0 in 20 s or never", |_, r| r.present * normalised_ttc(r.ttc_s);
    "planned", "", 1.0, "1 if the latest plan holds it and the ego; 0: the three that follow are at their limits",
        |_, r| r.planned;
    "plan_gap", "m", 30.0, "least distance from the ego in the latest plan's coming 3.2 s, at most 30 m",
        |_, r| r.plan_gap_m.min(30.0);
    "plan_route_gap", "m", 30.0, "the same from the ego at constant speed along its route", |_, r| r.plan_route_gap_m.min(30.0);
    "plan_route_time", "s", 3.2, "when that is", |_, r| r.plan_route_s;
    "was_guided", "", 1.0, "1 if the latest plan guides it", |_, r| r.was_guided;
    "ego_speed", "m/s", 15.0, "of the ego, the same in all rows, as what follows", |e, _| e.speed_mps;
    "ego_acceleration", "m/s2", 5.0, "change of the ego's speed over the last step", |e, _| e.acceleration_mps2;
    "time_left", "", 1.0, "share of the episode that is left", |e, _| e.time_left;
    "route_left", "m", 40.0, "length of the ego's route that is left, at most 40 m", |e, _| e.route_left_m;
    "route_x_10", "m", 40.0, "ahead of the ego, its route in 10 m", |e, _| e.at_10_m.x;
    "route_y_10", "m", 20.0, "to the left of the ego, its route in 10 m", |e, _| e.at_10_m.y;
    "route_x_20", "m", 40.0, "in 20 m", |e, _| e.at_20_m.x;
    "route_y_20", "m", 20.0, "in 20 m", |e, _| e.at_20_m.y;
    "route_x_40", "m", 40.0, "in 40 m", |e, _| e.at_40_m.x;
    "route_y_40", "m", 20.0, "in 40 m", |e, _| e.at_40_m.y;
    "candidates", "", 1.0, "share of the rows that hold a candidate", |e, _| e.share_of_rows;
}

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
    ///
    /// # Errors
    /// What times to contact refuse.
    pub fn new(
        world: &WorldView<'_>,
        plan: Option<&PlanRecord>,
        may_be_chosen: impl Fn(usize) -> bool,
        num_rows: usize,
    ) -> Result<Self> {
        let (states, width) = (world.states, CANDIDATE_FEATURES.len());
        let Some(ego) = world.ego.filter(|ego| states.active[*ego]) else {
            return Ok(Self { agents: Vec::new(), features: vec![0.0; num_rows * width] });
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
        let way = EgoWay::new(world, ego);
        let shared =
            EgoFacts { share_of_rows: agents.len() as Real / num_rows.max(1) as Real, ..way.facts(world) };
        let ttc_s = times_to_contact(world, ego, &agents)?;
        let rows = agents.iter().zip(ttc_s).map(|(a, ttc_s)| Facts { ttc_s, ..way.row(world, plan, *a) });
        let rows = rows.chain(std::iter::repeat_with(Facts::default)).take(num_rows);
        let features = rows.flat_map(|row| {
            let value = |f: &CandidateFeature| (f.of)(&shared, &row) / f.scale;
            CANDIDATE_FEATURES
                .iter()
                .map(|f| value(f).clamp(-CANDIDATE_BOUND, CANDIDATE_BOUND))
                .collect::<Vec<_>>()
        });
        Ok(Self { features: features.collect(), agents })
    }
}

impl VecWorld {
    /// The candidates of a world: vehicles whose drivers plan. At most `num_rows` of them.
    ///
    /// # Errors
    /// As [`VecWorld::status`]; what times to contact refuse.
    pub fn candidates(&self, world_idx: usize, num_rows: usize) -> Result<Candidates> {
        self.status(world_idx)?;
        let world = self.world(world_idx)?;
        let planners = self.policies.planners();
        let plan = planners.first().and_then(|p| world.episode.plans[usize::from(*p)].as_ref());
        let plans = |a: usize| match world.episode.drivers[a] {
            Driver::Policy(p) => planners.contains(&p) && !world.episode.has_slot(a),
            Driver::External | Driver::Towed => false,
        };
        Candidates::new(&world.view(&self.config), plan.map(|p| &p.record), plans, num_rows)
    }
}

/// Where the ego is and goes.
struct EgoWay {
    ego: usize,
    pose: Pose2,
    velocity: Vector2,
    speed_mps: Real,
    /// Along its route from where it is: in steps of [`PLACE_STEP_M`], and at constant speed in steps of [`TIME_STEP_S`].
    places: [Point2; NUM_PLACES],
    times: [Point2; NUM_TIMES],
    /// At constant speed at each fourth step of a plan.
    plan_times: [Point2; PLAN_STEPS / PLAN_STRIDE],
    route_left_m: Real,
}

impl EgoWay {
    fn new(world: &WorldView<'_>, ego: usize) -> Self {
        let (states, path, s_m) = (world.states, &world.scene.routes[ego].path, world.route_s_m[ego]);
        let speed_mps = states.speed_mps[ego].max(0.0);
        let along = |ahead_m: Real| path.at(s_m + ahead_m).position;
        Self {
            ego,
            pose: states.pose(ego),
            velocity: states.velocity(ego),
            speed_mps,
            places: std::array::from_fn(|i| along(i as Real * PLACE_STEP_M)),
            times: std::array::from_fn(|i| along(i as Real * TIME_STEP_S * speed_mps)),
            plan_times: std::array::from_fn(|i| {
                along((i * PLAN_STRIDE + 1) as Real * world.dt_s * speed_mps)
            }),
            route_left_m: (path.length_m() - s_m).clamp(0.0, 40.0),
        }
    }

    fn turned(&self, v: Vector2) -> Vector2 {
        Vector2::new(v.x * self.pose.cos + v.y * self.pose.sin, v.y * self.pose.cos - v.x * self.pose.sin)
    }

    fn facts(&self, world: &WorldView<'_>) -> EgoFacts {
        let left = world.horizon_steps.saturating_sub(world.elapsed_steps);
        let place =
            |ahead_m: Real| self.turned(self.places[(ahead_m / PLACE_STEP_M) as usize] - self.pose.position);
        EgoFacts {
            speed_mps: world.states.speed_mps[self.ego],
            acceleration_mps2: world.states.acceleration_mps2[self.ego],
            time_left: left as Real / world.horizon_steps.max(1) as Real,
            route_left_m: self.route_left_m,
            at_10_m: 0.5 * (place(8.0) + place(12.0)),
            at_20_m: place(20.0),
            at_40_m: place(40.0),
            share_of_rows: 0.0,
        }
    }

    fn row(&self, world: &WorldView<'_>, plan: Option<&PlanRecord>, a: usize) -> Facts {
        let states = world.states;
        let (pose, velocity, speed_mps) = (states.pose(a), states.velocity(a), states.speed_mps[a]);
        let gap = |i: usize| (pose.position + velocity * (i as Real * TIME_STEP_S) - self.times[i]).norm();
        let (approach, approach_m) = least((0..NUM_TIMES).map(gap));
        let from_place = |p: &Point2| (pose.position - p).norm();
        let (nearest, route_distance_m) = least(self.places.iter().map(from_place));
        let way = |i: usize| pose.position + Vector2::new(pose.cos, pose.sin) * (i as Real * WAY_STEP_M);
        let pairs = (0..WAY_PLACES).flat_map(|i| self.places.iter().map(move |p| (way(i) - p).norm()));
        let (crossing, crossing_m) = least(pairs);
        let time = |places: usize, step_m: Real, speed_mps: Real| {
            places as Real * step_m / speed_mps.max(LEAST_SPEED_MPS)
        };
        let crossing_s = time(crossing % NUM_PLACES, PLACE_STEP_M, self.speed_mps);
        let (cos, sin) = (
            pose.cos * self.pose.cos + pose.sin * self.pose.sin,
            pose.sin * self.pose.cos - pose.cos * self.pose.sin,
        );
        let facts = Facts {
            present: 1.0,
            at: self.turned(pose.position - self.pose.position),
            cos,
            sin,
            velocity: self.turned(velocity - self.velocity),
            speed_mps,
            acceleration_mps2: states.acceleration_mps2[a],
            distance_m: (pose.position - self.pose.position).norm(),
            approach_m,
            approach_s: approach as Real * TIME_STEP_S,
            crossing_m,
            crossing_lead_s: time(crossing / NUM_PLACES, WAY_STEP_M, speed_mps) - crossing_s,
            crossing_s,
            route_distance_m,
            route_ahead_m: nearest as Real * PLACE_STEP_M,
            plan_gap_m: Real::INFINITY,
            plan_route_gap_m: Real::INFINITY,
            plan_route_s: PLAN_STEPS as Real * world.dt_s,
            ..Facts::default()
        };
        let planned = plan.and_then(|plan| self.planned(world, plan, a, &facts));
        planned.unwrap_or(facts)
    }

    /// What the latest plan says of a candidate; `None` where it does not hold both, or is at its end.
    fn planned(&self, world: &WorldView<'_>, plan: &PlanRecord, a: usize, facts: &Facts) -> Option<Facts> {
        let row = |agent: usize| plan.agents.iter().position(|b| *b == agent);
        let (own, egos) = (row(a)?, row(self.ego)?);
        let from = world.elapsed_steps.checked_sub(plan.made_at)?;
        let steps = || (from..plan.num_steps).take(PLAN_STEPS).step_by(PLAN_STRIDE);
        steps().next()?;
        let at = |row: usize, step: usize| {
            let m = plan.agents.len();
            let at = ((plan.selected_sample[row] * m + row) * plan.num_steps + step) * 3;
            Point2::new(plan.samples[at], plan.samples[at + 1])
        };
        let (_, plan_gap_m) = least(steps().map(|t| (at(own, t) - at(egos, t)).norm()));
        let (place, plan_route_gap_m) =
            least(steps().zip(&self.plan_times).map(|(t, p)| (at(own, t) - p).norm()));
        Some(Facts {
            planned: 1.0,
            plan_gap_m,
            plan_route_gap_m,
            plan_route_s: (place * PLAN_STRIDE) as Real * world.dt_s,
            was_guided: f32::from(plan.guided[own]),
            ..*facts
        })
    }
}

/// Place and value of the least of some numbers, the first of several.
fn least(values: impl Iterator<Item = Real>) -> (usize, Real) {
    values.enumerate().fold((0, Real::INFINITY), |best, (i, v)| if v < best.1 { (i, v) } else { best })
}

/// Times to contact of the ego with each of some agents, seconds.
fn times_to_contact(world: &WorldView<'_>, ego: usize, agents: &[usize]) -> Result<Vec<Real>> {
    let chosen: Vec<usize> = std::iter::once(ego).chain(agents.iter().copied()).collect();
    let of = |value: &dyn Fn(usize) -> Real| chosen.iter().map(|a| value(*a)).collect::<Vec<Real>>();
    let (states, footprints) = (world.states, &world.scene.footprints);
    let heading = of(&|a| states.heading_rad[a]);
    let frame = AgentFrame {
        x_m: &of(&|a| states.x[a]),
        y_m: &of(&|a| states.y[a]),
        heading_rad: &heading,
        speed_mps: &of(&|a| states.speed_mps[a]),
        length_m: &of(&|a| 2.0 * footprints[a].half_length_m),
        width_m: &of(&|a| 2.0 * footprints[a].half_width_m),
        valid: &vec![true; chosen.len()],
        apart: &[],
    };
    let mut ttc_s = vec![0.0; chosen.len() * chosen.len()];
    frame.checked()?.ttc_s(Ttc::Oriented, &heading, &mut ttc_s)?;
    Ok(ttc_s[1..chosen.len()].to_vec())
}
