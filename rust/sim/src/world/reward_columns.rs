//! The table of rewards and info columns of a step: a new reward component, or a new column of `info`, is one entry here.
//!
//! The weights of the configuration, the columns of the buffers, the metrics of episodes and the tables of the pages are
//! made from it.

use crate::choices;
use crate::events::Contact;
use crate::geom::Real;
use crate::observe::RoutePlace;
use crate::options;
use crate::options::WEIGHT;
use serde::Serialize;

/// A column of `info`, or a metric of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct InfoColumn {
    /// Name, also the key in `info`.
    pub name: &'static str,
    /// Unit; empty for flags, counts and weighted rewards.
    pub unit: &'static str,
    /// What it is.
    pub doc: &'static str,
}

choices! {
    /// Form of the reward.
    #[derive(Clone, Copy, Eq)]
    pub enum RewardForm {
        /// Weighted sum of the components.
        Sum = "sum",
        /// New progress times factors for comfort, speed, time to contact and distance from the route, as in CaRL (Jaeger
        /// et al., 2025); collisions count where they are the agent's fault. The weights of the factors are unused.
        Product = "product",
    }
}

/// What happened to a slot's agent in a step.
pub(crate) struct StepFacts {
    pub(crate) contact: Option<Contact>,
    pub(crate) ttc_s: Real,
    pub(crate) log_distance_m: Real,
    /// New progress.
    pub(crate) progress_m: Real,
    pub(crate) reached: bool,
    /// Its front has passed a stop line in red.
    pub(crate) ran_red: bool,
    /// How much it is too slow to be in time on a free road, m/s; found where it is priced.
    pub(crate) lag_mps: Real,
    /// What happened in this step ends the episode.
    pub(crate) terminated: bool,
    /// The horizon or the log ends the episode in this step.
    pub(crate) timed_out: bool,
}

/// What the rewards and info columns of a slot's step are made from.
pub(crate) struct Step {
    pub(crate) facts: StepFacts,
    /// Whether a contact counts in the form of the reward.
    pub(crate) contact_counts: bool,
    /// Worth of progress in the form of the reward, 0 to 1.
    pub(crate) worth: Real,
    /// 1 where discomfort, speeding and distance from the route are components, 0 where they are factors.
    pub(crate) soft: Real,
    /// Progress since the start.
    pub(crate) travelled_m: Real,
    pub(crate) completion: Real,
    /// The episode ends in this step as a success.
    pub(crate) success: bool,
    pub(crate) off_road: bool,
    pub(crate) off_road_centroid: bool,
    pub(crate) place: RoutePlace,
    pub(crate) speed_mps: Real,
    pub(crate) acceleration_mps2: Real,
    pub(crate) lateral_acceleration_mps2: Real,
    pub(crate) jerk_mps3: Real,
    pub(crate) discomfort: Real,
}

/// Jerk counts up to here, m/s³.
const MAX_JERK_MPS3: Real = 10.0;
/// Offset across the route counts up to here, metres.
const MAX_LANE_KEEPING_M: Real = 3.0;

impl Step {
    /// Speed above the limit, m/s.
    pub(crate) fn speeding_mps(&self) -> Real {
        (self.speed_mps - self.place.speed_limit_mps).max(0.0)
    }

    /// Offset across the route as far as it counts, metres.
    fn aside_m(&self) -> Real {
        self.place.route_distance_m.abs().min(MAX_LANE_KEEPING_M)
    }

    /// The same as a share.
    pub(crate) fn aside(&self) -> Real {
        self.aside_m() / MAX_LANE_KEEPING_M
    }
}

macro_rules! columns {
    (
        rewards {$(
            $(#[doc = $about:literal])+
            $component:ident, $weight:ident = $default:expr, $what:literal, $reward:expr;
        )*}
        info {$($variant:ident, $name:literal, $unit:literal, $doc:literal, $value:expr;)*}
    ) => {
        options! {
            /// Weights of the reward components; the reward is their sum, or a product of factors.
            ///
            /// Also by the name of a form: `reward="product"`.
            #[derive(Clone, Copy)]
            #[serde(deny_unknown_fields, default)]
            pub struct RewardConfig {
                /// Form of the reward.
                form: RewardForm = RewardForm::Sum;
                $($(#[doc = $about])+ $weight: Real = $default, range WEIGHT;)*
            }
        }

        /// Position of each column in a slot's row.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(usize)]
        pub enum Col { $(#[doc = $what] $component,)* $(#[doc = $doc] $variant,)* }

        /// All columns in the order of [`Col`]: those of the reward components come first.
        pub const COLUMNS: &[InfoColumn] = &[
            $(InfoColumn { name: concat!("reward_", stringify!($weight)), unit: "", doc: $what },)*
            $(InfoColumn { name: $name, unit: $unit, doc: $doc },)*
        ];

        /// Names of the reward components, as the configuration has them.
        pub const COMPONENTS: [&str; NUM_COMPONENTS] = [$(stringify!($weight)),*];

        impl RewardConfig {
            /// Weight of a component.
            pub(crate) fn weight(&self, component: &str) -> Option<Real> {
                match component {
                    $(stringify!($weight) => Some(self.$weight),)*
                    _ => None,
                }
            }
        }

        /// Number of reward components, whose columns come first.
        pub(crate) const NUM_COMPONENTS: usize = [$(Col::$component),*].len();

        /// Fills a slot's row and returns the reward; `style` are factors of the weights.
        #[allow(clippy::redundant_closure_call, reason = "entries of the table are closures")]
        pub(crate) fn fill(
            step: &Step,
            weights: &RewardConfig,
            style: &[Real; NUM_COMPONENTS],
            row: &mut [Real],
        ) -> Real {
            let mut total = 0.0;
            $(
                let reward: fn(Real, &Step) -> Real = $reward;
                row[Col::$component as usize] =
                    reward(weights.$weight * style[Col::$component as usize], step);
                total += row[Col::$component as usize];
            )*
            $(
                let value: fn(&Step) -> Real = $value;
                row[Col::$variant as usize] = value(step);
            )*
            total
        }
    };
}

columns! {
    // weight, default, what it is, and the reward from the weight and the step
    rewards {
        /// Per metre of new progress along the route.
        RewardProgress, progress = 0.02, "weighted reward of new progress along the route",
            |weight, s| weight * s.facts.progress_m * s.worth;
        /// At the step of a collision.
        RewardCollision, collision = -2.5, "weighted reward of the step of a collision",
            |weight, s| weight * Real::from(s.contact_counts);
        /// At each step with a corner off the road.
        RewardOffRoad, off_road = -3.0, "weighted reward of a step with a corner off the road",
            |weight, s| weight * Real::from(s.off_road);
        /// Per unit of discomfort, (a / 4 m/s²)² + (jerk / 10 m/s³)² + (lateral a / 4 m/s²)², at most 3, per step.
        RewardComfort, comfort = -0.004, "weighted reward of acceleration, jerk and lateral acceleration",
            |weight, s| weight * s.soft * s.discomfort;
        /// Per m/s above the speed limit, per step.
        RewardSpeedLimit, speed_limit = -0.01, "weighted reward of speed above the limit",
            |weight, s| weight * s.soft * s.speeding_mps();
        /// Per metre of offset across the route, at most 3, per step.
        RewardLaneKeeping, lane_keeping = -0.004, "weighted reward of the offset across the route",
            |weight, s| weight * s.soft * s.aside_m();
        /// When the goal is reached.
        RewardGoal, goal = 1.0, "weighted reward of reaching the goal",
            |weight, s| weight * Real::from(s.facts.reached);
        /// Per m/s³ of jerk either way, at most 10, per step.
        RewardJerk, jerk = 0.0, "weighted reward of jerk alone",
            |weight, s| weight * s.soft * s.jerk_mps3.abs().min(MAX_JERK_MPS3);
        /// At the step at which the front passes a stop line in red.
        RewardRedLight, red_light = 0.0, "weighted reward of passing a stop line in red",
            |weight, s| weight * Real::from(s.facts.ran_red);
        /// Per m/s below the mean speed that reaches the goal in time, with nobody within 8 m ahead, per step.
        RewardLagging, lagging = 0.0, "weighted reward of a speed too low to be in time on a free road",
            |weight, s| weight * s.facts.lag_mps;
    }
    // name, unit, what it is, and the value from the step
    info {
        Collision, "collision", "", "1 at the step at which the agent begins to touch another one",
            |s| Real::from(s.facts.contact.is_some());
        CollisionKind, "collision_kind", "", "side of this agent that is hit: 0 none, 1 front, 2 rear, 3 side",
            |s| s.facts.contact.map_or(0.0, |c| Real::from(c.kind as u8 + 1));
        CollisionPartner, "collision_partner", "", "1 + index of the other agent in the scene's list; 0 for none",
            |s| s.facts.contact.map_or(0.0, |c| (c.partner + 1) as Real);
        AtFault, "at_fault", "", "1 if the collision counts against this agent",
            |s| Real::from(s.facts.contact.is_some_and(|c| c.at_fault));
        OffRoad, "off_road", "", "1 while a corner of the box is off the road",
            |s| Real::from(s.off_road);
        OffRoadCentroid, "off_road_centroid", "", "1 while the centre is off the road",
            |s| Real::from(s.off_road_centroid);
        WrongWay, "wrong_way", "", "1 while the agent faces against the lane whose surface holds it",
            |s| Real::from(s.place.wrong_way);
        GoalReached, "goal_reached", "", "1 at the step at which the goal is reached",
            |s| Real::from(s.facts.reached);
        HasLane, "has_lane", "", "1 if a lane is near, else lane_distance is 0",
            |s| Real::from(s.place.lane_distance_m.is_some());
        LaneDistance, "lane_distance", "m", "to the nearest lane centre, those of its direction first; 0 without one",
            |s| s.place.lane_distance_m.unwrap_or(0.0);
        RouteDistance, "route_distance", "m", "offset across the route at its tracked place, left positive",
            |s| s.place.route_distance_m;
        Progress, "progress", "m", "farthest position along the route since the start",
            |s| s.travelled_m;
        RouteCompletion, "route_completion", "", "share of the way to the goal, 0 to 1; 1 where the goal is reached",
            |s| s.completion;
        Speed, "speed", "m/s", "speed along the heading",
            |s| s.speed_mps;
        Acceleration, "acceleration", "m/s2", "change of speed over the step",
            |s| s.acceleration_mps2;
        LateralAcceleration, "lateral_acceleration", "m/s2", "speed times yaw rate",
            |s| s.lateral_acceleration_mps2;
        Jerk, "jerk", "m/s3", "change of acceleration over the step",
            |s| s.jerk_mps3;
        Ttc, "ttc", "s", "least time to contact with any agent at constant velocities, at most 10",
            |s| s.facts.ttc_s;
        LogDistance, "log_distance", "m", "distance from the agent's own log, 0 where the log has ended",
            |s| s.facts.log_distance_m;
        Success, "is_success", "", "1 at the end of an episode that reached its goal, without a collision or a step off the road up to then",
            |s| Real::from(s.success);
        TimeLimit, "time_limit", "", "1 at the step at which the horizon or the log ends the episode",
            |s| Real::from(s.facts.timed_out);
        Speeding, "speeding", "m/s", "speed above the limit, 0 below it",
            Step::speeding_mps;
        RanRed, "ran_red", "", "1 at the step at which the front passes a stop line, every light of which is red",
            |s| Real::from(s.facts.ran_red);
    }
}

/// Number of columns M.
pub const NUM_COLUMNS: usize = COLUMNS.len();

/// What stays in the columns of a decision once it has happened: the collision, with its details.
const CONTACT: [Col; 4] = [Col::Collision, Col::CollisionKind, Col::CollisionPartner, Col::AtFault];

/// Reward and info columns of a slot over the steps of a decision so far.
pub(crate) struct Earlier {
    reward: f32,
    columns: [f32; NUM_COLUMNS],
}

impl Earlier {
    /// What a slot's row holds.
    pub(crate) fn of(reward: f32, row: &[f32]) -> Self {
        let mut columns = [0.0; NUM_COLUMNS];
        columns.copy_from_slice(row);
        Self { reward, columns }
    }

    /// Adds components and reward to those of the next step; a collision, the reached goal and a red light passed stay.
    pub(crate) fn join(&self, reward: f32, row: &mut [f32]) -> f32 {
        for (value, earlier) in row.iter_mut().zip(&self.columns).take(NUM_COMPONENTS) {
            *value += earlier;
        }
        if row[Col::Collision as usize] == 0.0 {
            CONTACT.iter().for_each(|c| row[*c as usize] = self.columns[*c as usize]);
        }
        for column in [Col::GoalReached as usize, Col::RanRed as usize] {
            row[column] = row[column].max(self.columns[column]);
        }
        self.reward + reward
    }
}

/// Longest time to contact that is looked for, seconds.
pub const TTC_HORIZON_S: f32 = 10.0;
