//! The schema of per-slot figures that a step reports beside observation and reward: `info` is made from it.

use serde::Serialize;

/// One figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Column {
    /// Name, also the key in `info`.
    pub name: &'static str,
    /// Unit; empty for flags, counts and weighted rewards.
    pub unit: &'static str,
    /// What it is.
    pub doc: &'static str,
}

macro_rules! columns {
    ($($variant:ident, $name:literal, $unit:literal, $doc:literal;)*) => {
        /// Position of each figure in a slot's row.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(usize)]
        pub enum Col { $(#[doc = $doc] $variant),* }

        /// All figures in the order of [`Col`].
        pub const COLUMNS: &[Column] = &[$(Column { name: $name, unit: $unit, doc: $doc }),*];
    };
}

columns! {
    RewardProgress, "reward_progress", "", "weighted reward of new progress along the route";
    RewardCollision, "reward_collision", "", "weighted reward of the step of a collision";
    RewardOffRoad, "reward_off_road", "", "weighted reward of a step with a corner off the road";
    RewardComfort, "reward_comfort", "", "weighted reward of acceleration, jerk and lateral acceleration";
    RewardSpeedLimit, "reward_speed_limit", "", "weighted reward of speed above the limit";
    RewardLaneKeeping, "reward_lane_keeping", "", "weighted reward of distance from the route";
    RewardGoal, "reward_goal", "", "weighted reward of reaching the goal";
    Collision, "collision", "", "1 at the step at which the agent begins to touch another one";
    CollisionKind, "collision_kind", "", "side of this agent that is hit: 0 none, 1 front, 2 rear, 3 side";
    CollisionPartner, "collision_partner", "", "1 + index of the other agent in the scene's list; 0 for none";
    AtFault, "at_fault", "", "1 if the collision counts against this agent";
    OffRoad, "off_road", "", "1 while a corner of the box is off the road";
    OffRoadCentroid, "off_road_centroid", "", "1 while the centre is off the road";
    WrongWay, "wrong_way", "", "1 while the agent drives against the only lane near";
    GoalReached, "goal_reached", "", "1 at the step at which the goal is reached";
    HasLane, "has_lane", "", "1 if a lane is near, so that lane_distance and wrong_way mean something";
    LaneDistance, "lane_distance", "m", "distance to the nearest lane centre, 0 without one";
    RouteDistance, "route_distance", "m", "signed distance from the route, left positive";
    Progress, "progress", "m", "farthest position along the route since the start";
    RouteCompletion, "route_completion", "", "progress over the distance to the goal, 0 to 1";
    Speed, "speed", "m/s", "speed along the heading";
    Acceleration, "acceleration", "m/s2", "change of speed over the step";
    LateralAcceleration, "lateral_acceleration", "m/s2", "speed times yaw rate";
    Jerk, "jerk", "m/s3", "change of acceleration over the step";
    Ttc, "ttc", "s", "least time to contact with any agent at constant velocities, at most 10";
    LogDistance, "log_distance", "m", "distance from the agent's own log, 0 where the log has ended";
    Success, "is_success", "", "1 at the end of an episode with at least 95 % of the route, no collision and no step off the road";
    TimeLimit, "time_limit", "", "1 at the step at which the horizon or the log ends the episode";
}

/// Number of figures M.
pub const NUM_COLUMNS: usize = COLUMNS.len();

/// Columns of the reward components, which come first.
pub(crate) const NUM_COMPONENTS: usize = 7;
/// What stays in the figures of a decision once it has happened: the collision, with its facts.
const CONTACT: [Col; 4] = [Col::Collision, Col::CollisionKind, Col::CollisionPartner, Col::AtFault];

/// Reward and figures of a slot over the steps of a decision so far.
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

    /// Joins them to the figures of the next step and returns the sum of the rewards: components add up, a collision
    /// and the reached goal stay, the other figures are those of the step.
    pub(crate) fn join(&self, reward: f32, row: &mut [f32]) -> f32 {
        for (value, earlier) in row.iter_mut().zip(&self.columns).take(NUM_COMPONENTS) {
            *value += earlier;
        }
        if row[Col::Collision as usize] == 0.0 {
            CONTACT.iter().for_each(|c| row[*c as usize] = self.columns[*c as usize]);
        }
        let goal = Col::GoalReached as usize;
        row[goal] = row[goal].max(self.columns[goal]);
        self.reward + reward
    }
}

/// Longest time to contact that is looked for, seconds.
pub const TTC_HORIZON_S: f32 = 10.0;
