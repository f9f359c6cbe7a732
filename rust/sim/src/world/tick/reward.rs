//! Reward of a step: what the entries of the table in [`reward_columns`] are made from.

use crate::events::limits;
use crate::geom::Real;
use crate::state::AgentStates;
use crate::world::config::WorldConfig;
use crate::world::episode::Slot;
use crate::world::reward_columns::{self, RewardForm, Step, StepFacts};

/// Scale of accelerations in the discomfort, m/s².
const COMFORT_MPS2: Real = 4.0;
/// Scale of jerk in the discomfort, m/s³.
const COMFORT_MPS3: Real = 10.0;
/// A step costs no more discomfort than this.
const MAX_DISCOMFORT: Real = 3.0;
/// Speed above the limit at which progress is worth nothing, m/s.
const SPEEDING_MPS: Real = 5.0;

/// How uncomfortable a step is, 0 to 3, from acceleration and lateral acceleration (m/s²) and jerk (m/s³).
pub(crate) fn discomfort(acceleration: Real, lateral: Real, jerk: Real) -> Real {
    let square = |x: Real, scale: Real| (x / scale) * (x / scale);
    (square(acceleration, COMFORT_MPS2) + square(lateral, COMFORT_MPS2) + square(jerk, COMFORT_MPS3))
        .min(MAX_DISCOMFORT)
}

/// Fills a slot's columns and returns the reward; `slot.progress` holds this step already.
pub(crate) fn score(
    states: &AgentStates,
    agent_idx: usize,
    slot: &mut Slot,
    facts: StepFacts,
    config: &WorldConfig,
    columns: &mut [Real],
) -> Real {
    let (speed, acceleration) = (states.speed_mps[agent_idx], states.acceleration_mps2[agent_idx]);
    let lateral = speed * states.yaw_rate_radps[agent_idx];
    let jerk = (acceleration - slot.acceleration_mps2) / config.dt_s;
    slot.acceleration_mps2 = acceleration;
    slot.ever_collided |= facts.contact.is_some();
    slot.ever_off_road |= slot.off_road;
    slot.arrived_unharmed |= facts.reached && !slot.ever_collided && !slot.ever_off_road;
    let mut step = Step {
        contact_counts: facts.contact.is_some(),
        worth: 1.0,
        soft: 1.0,
        travelled_m: slot.progress.travelled_m(),
        completion: slot.progress.completion(),
        success: (facts.terminated || facts.timed_out) && slot.arrived_unharmed,
        off_road: slot.off_road,
        off_road_centroid: slot.off_road_centroid,
        place: slot.place,
        speed_mps: speed,
        acceleration_mps2: acceleration,
        lateral_acceleration_mps2: lateral,
        jerk_mps3: jerk,
        discomfort: discomfort(acceleration, lateral, jerk),
        facts,
    };
    if config.reward.form == RewardForm::Product {
        // of single steps, where nuPlan looks at smoothed motions
        let [low, high] = limits::ACCELERATION_MPS2;
        let calm = (low..=high).contains(&acceleration)
            && lateral.abs() <= limits::LATERAL_ACCELERATION_MPS2
            && jerk.abs() <= limits::JERK_MPS3;
        let half = |ok: bool| if ok { 1.0 } else { 0.5 };
        let over = step.speeding_mps() / SPEEDING_MPS;
        let worth = half(calm) * half(step.facts.ttc_s >= limits::TTC_S) * (1.0 - over).max(0.0);
        step.worth = worth * (1.0 - 0.5 * step.aside());
        step.contact_counts = step.facts.contact.is_some_and(|c| c.at_fault);
        step.soft = 0.0;
    }
    reward_columns::fill(&step, &config.reward, &slot.drawn.style, columns)
}
