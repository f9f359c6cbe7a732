//! What is summed up over an episode, from the info columns of its steps.

use crate::geom::Real;
use crate::world::reward_columns::{COLUMNS, Col, InfoColumn, NUM_COLUMNS, NUM_COMPONENTS, TTC_HORIZON_S};
use serde::{Deserialize, Serialize};

const fn metric(name: &'static str, unit: &'static str, doc: &'static str) -> InfoColumn {
    InfoColumn { name, unit, doc }
}

/// Metrics of an episode, in the order of [`Metrics`]: those below, then the sums of the reward components.
pub const METRICS: &[InfoColumn] = &{
    let mut all = [OWN[0]; OWN.len() + NUM_COMPONENTS];
    let mut i = 0;
    while i < all.len() {
        all[i] = if i < OWN.len() {
            OWN[i]
        } else {
            metric(COLUMNS[i - OWN.len()].name, "", "sum of this component")
        };
        i += 1;
    }
    all
};

const OWN: &[InfoColumn] = &[
    metric("return", "", "sum of the rewards"),
    metric("length", "", "steps"),
    metric("collision", "", "1 if the agent ever collided"),
    metric("at_fault", "", "1 if a collision counts against the agent"),
    metric("off_road", "", "1 if a corner of the box was ever off the road"),
    metric("wrong_way", "", "1 if the agent ever faced against the lane whose surface holds it"),
    metric("goal_reached", "", "1 if the goal was reached"),
    metric("progress", "m", "way along the route"),
    metric("route_completion", "", "share of the way to the goal, 0 to 1; 1 where the goal is reached"),
    metric("is_success", "", "1 for the goal, without a collision or a step off the road up to then"),
    metric("min_ttc", "s", "least time to contact with any agent, at most 10"),
    metric("mean_speed", "m/s", "mean speed along the heading"),
    metric("mean_log_distance", "m", "mean distance from the agent's own log"),
];

/// Number of metrics.
pub const NUM_METRICS: usize = METRICS.len();

/// Metrics of one agent's episode.
pub type Metrics = [f64; NUM_METRICS];

/// Figures of which is kept whether they ever were 1.
const EVER: [Col; 5] = [Col::Collision, Col::AtFault, Col::OffRoad, Col::WrongWay, Col::GoalReached];
/// Figures of which the last value counts.
const LAST: [Col; 3] = [Col::Progress, Col::RouteCompletion, Col::Success];
/// Figures that are averaged.
const MEAN: [Col; 2] = [Col::Speed, Col::LogDistance];

/// Running sums of one agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct EpisodeStatistics {
    steps: u32,
    total: f64,
    components: [f64; NUM_COMPONENTS],
    means: [f64; MEAN.len()],
    ever: [bool; EVER.len()],
    last: [Real; LAST.len()],
    min_ttc_s: Real,
}

impl Default for EpisodeStatistics {
    fn default() -> Self {
        Self {
            steps: 0,
            total: 0.0,
            components: [0.0; NUM_COMPONENTS],
            means: [0.0; MEAN.len()],
            ever: [false; EVER.len()],
            last: [0.0; LAST.len()],
            min_ttc_s: TTC_HORIZON_S,
        }
    }
}

impl EpisodeStatistics {
    /// Adds a step.
    pub(crate) fn add(&mut self, reward: Real, columns: &[Real]) {
        debug_assert_eq!(columns.len(), NUM_COLUMNS);
        self.steps = self.steps.saturating_add(1);
        self.total += f64::from(reward);
        for (sum, value) in self.components.iter_mut().zip(columns) {
            *sum += f64::from(*value);
        }
        for (sum, column) in self.means.iter_mut().zip(MEAN) {
            *sum += f64::from(columns[column as usize]);
        }
        for (ever, column) in self.ever.iter_mut().zip(EVER) {
            *ever |= columns[column as usize] > 0.0;
        }
        self.last = LAST.map(|column| columns[column as usize]);
        self.min_ttc_s = self.min_ttc_s.min(columns[Col::Ttc as usize]);
    }

    /// Puts another reward in the place of one that was added.
    pub(crate) fn pay_instead(&mut self, added: Real, reward: Real) {
        self.total += f64::from(reward) - f64::from(added);
    }

    /// Whether all sums are finite.
    pub(crate) fn is_finite(&self) -> bool {
        let sums = self.components.iter().chain(&self.means).chain([&self.total]);
        sums.into_iter().all(|x| x.is_finite())
            && self.last.iter().chain([&self.min_ttc_s]).all(|x| x.is_finite())
    }

    /// The metrics so far.
    pub(crate) fn metrics(&self) -> Metrics {
        let mut metrics = [0.0; NUM_METRICS];
        let steps = f64::from(self.steps.max(1));
        let values = [self.total, f64::from(self.steps)]
            .into_iter()
            .chain(self.ever.map(|e| f64::from(u8::from(e))))
            .chain(self.last.map(f64::from))
            .chain([f64::from(self.min_ttc_s)])
            .chain(self.means.map(|sum| sum / steps))
            .chain(self.components);
        metrics.iter_mut().zip(values).for_each(|(metric, value)| *metric = value);
        metrics
    }
}
