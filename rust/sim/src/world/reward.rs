//! Reward of a step: the sum of named components, each also reported as a column.

use crate::events::{Contact, ContactKind};
use crate::geom::Real;
use crate::state::AgentStates;
use crate::world::columns::Col;
use crate::world::config::{RewardForm, WorldConfig};
use crate::world::episode::{STANDING_M, Slot};

/// Scale of accelerations in the discomfort, m/s².
const COMFORT_MPS2: Real = 4.0;
/// Scale of jerk in the discomfort, m/s³.
const COMFORT_MPS3: Real = 10.0;
/// A step costs no more discomfort than this.
const MAX_DISCOMFORT: Real = 3.0;
/// Distance from the route counts up to here, metres.
const MAX_LANE_KEEPING_M: Real = 3.0;
/// Limits of nuPlan's comfort: braking and acceleration, sideways (m/s²), jerk (m/s³).
const COMFORT_BOUNDS: [(Real, Real); 3] = [(-4.05, 2.40), (-4.89, 4.89), (-8.37, 8.37)];
/// Speed above the limit at which progress is worth nothing, m/s.
const SPEEDING_MPS: Real = 5.0;
/// Times to contact below this halve the worth of progress, seconds.
const LEAST_TTC_S: Real = 0.95;
/// Share of the route that makes an episode a success.
const SUCCESS_COMPLETION: Real = 0.95;

/// What a slot's reward is made from, besides its state.
pub(crate) struct StepFacts {
    /// A contact that begins in this step.
    pub(crate) contact: Option<Contact>,
    pub(crate) ttc_s: Real,
    pub(crate) log_distance_m: Real,
}

impl StepFacts {
    /// Number of the side that is hit, as in the columns.
    pub(crate) fn contact_number(&self) -> Real {
        match self.contact.map(|c| c.kind) {
            None => 0.0,
            Some(ContactKind::Front) => 1.0,
            Some(ContactKind::Rear) => 2.0,
            Some(ContactKind::Side) => 3.0,
        }
    }
}

/// How uncomfortable a step is, 0 to 3, from acceleration and lateral acceleration (m/s²) and jerk (m/s³).
pub(crate) fn discomfort(acceleration: Real, lateral: Real, jerk: Real) -> Real {
    let square = |x: Real, scale: Real| (x / scale) * (x / scale);
    (square(acceleration, COMFORT_MPS2) + square(lateral, COMFORT_MPS2) + square(jerk, COMFORT_MPS3))
        .min(MAX_DISCOMFORT)
}

/// Fills a slot's columns (all but the time limit) and returns the reward. `slot.best_s_m` holds the progress of
/// this step already; `slot` learns accidents and the goal.
pub(crate) fn score(
    states: &AgentStates,
    agent_idx: usize,
    slot: &mut Slot,
    facts: &StepFacts,
    progress_before_m: Real,
    config: &WorldConfig,
    columns: &mut [Real],
) -> Real {
    let weights = &config.reward;
    let flag = |b: bool| if b { 1.0 } else { 0.0 };
    let (speed, acceleration) = (states.speed_mps[agent_idx], states.acceleration_mps2[agent_idx]);
    let lateral = speed * states.yaw_rate_radps[agent_idx];
    let jerk = (acceleration - slot.acceleration_mps2) / config.dt_s;
    slot.acceleration_mps2 = acceleration;

    let discomfort = discomfort(acceleration, lateral, jerk);
    let collided = facts.contact.is_some();
    slot.ever_collided |= collided;
    slot.ever_off_road |= slot.off_road;
    let standing = slot.goal_s_m - slot.start_s_m < STANDING_M;
    let reached = !standing && !slot.goal_reached && slot.best_s_m >= slot.goal_s_m;
    slot.goal_reached |= reached;

    let at_fault = facts.contact.is_some_and(|c| c.at_fault);
    let (worth, counts, soft) = match weights.form {
        RewardForm::Sum => (1.0, collided, 1.0),
        RewardForm::Product => {
            let calm = [acceleration, lateral, jerk]
                .iter()
                .zip(COMFORT_BOUNDS)
                .all(|(x, (low, high))| (low..=high).contains(x));
            let half = |ok: bool| if ok { 1.0 } else { 0.5 };
            let over = (speed - slot.speed_limit_mps).max(0.0) / SPEEDING_MPS;
            let beside = slot.route_distance_m.abs().min(MAX_LANE_KEEPING_M) / MAX_LANE_KEEPING_M;
            let worth = half(calm) * half(facts.ttc_s >= LEAST_TTC_S) * (1.0 - over).max(0.0);
            (worth * (1.0 - 0.5 * beside), at_fault, 0.0)
        }
    };
    let mut set = |column: Col, value: Real| columns[column as usize] = value;
    let components = [
        (Col::RewardProgress, weights.progress * (slot.best_s_m - progress_before_m) * worth),
        (Col::RewardCollision, weights.collision * flag(counts)),
        (Col::RewardOffRoad, weights.off_road * flag(slot.off_road)),
        (Col::RewardComfort, weights.comfort * soft * discomfort),
        (Col::RewardSpeedLimit, weights.speed_limit * soft * (speed - slot.speed_limit_mps).max(0.0)),
        (
            Col::RewardLaneKeeping,
            weights.lane_keeping * soft * slot.route_distance_m.abs().min(MAX_LANE_KEEPING_M),
        ),
        (Col::RewardGoal, weights.goal * flag(reached)),
    ];
    let mut total = 0.0;
    for (column, value) in components {
        set(column, value);
        total += value;
    }
    set(Col::Collision, flag(collided));
    set(Col::CollisionKind, facts.contact_number());
    set(Col::CollisionPartner, facts.contact.map_or(0.0, |c| (c.partner + 1) as Real));
    set(Col::AtFault, flag(at_fault));
    set(Col::OffRoad, flag(slot.off_road));
    set(Col::OffRoadCentroid, flag(slot.off_road_centroid));
    set(Col::WrongWay, flag(slot.wrong_way));
    set(Col::GoalReached, flag(reached));
    set(Col::HasLane, flag(slot.lane_distance_m.is_some()));
    set(Col::LaneDistance, slot.lane_distance_m.unwrap_or(0.0));
    set(Col::RouteDistance, slot.route_distance_m);
    set(Col::Progress, slot.best_s_m - slot.start_s_m);
    set(Col::RouteCompletion, slot.completion());
    set(Col::Speed, speed);
    set(Col::Acceleration, acceleration);
    set(Col::LateralAcceleration, lateral);
    set(Col::Jerk, jerk);
    set(Col::Ttc, facts.ttc_s);
    set(Col::LogDistance, facts.log_distance_m);
    total
}

/// Whether an episode that ends now was a success.
pub(crate) fn is_success(slot: &Slot) -> bool {
    !slot.ever_collided && !slot.ever_off_road && slot.completion() >= SUCCESS_COMPLETION
}
