//! Everything that can be chosen about a world, checked once.

use crate::dynamics::{ActionGrid, Dynamics, UnicycleLimits};
use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::observe::ObservationConfig;
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::world::traffic::{EXTERNAL, IdmConfig, Traffic};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which agents have a slot: they are observed, rewarded and, by default, driven from outside.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Controlled {
    /// The ego.
    Ego,
    /// Vehicles present at the start, in the scene's order (the ego first), as many as there are slots.
    Vehicles,
    /// Agents by id; those a scene does not have leave their slot empty.
    Ids(Vec<String>),
    /// Agents by id, chosen for each scene by its name; slots beyond a scene's list stay empty.
    PerScene(BTreeMap<String, Vec<String>>),
}

impl Controlled {
    /// Whether one of these agents is there at a step of a scene's log.
    pub(crate) fn anyone_at(&self, scene: &Scene, step: usize) -> bool {
        let present = |id: &str| scene.agent_index(id).is_some_and(|a| scene.is_valid(a, step));
        match self {
            Self::Ego => present(EGO_ID),
            Self::Vehicles => (0..scene.num_agents())
                .any(|a| scene.agents[a].kind == AgentKind::Vehicle && scene.is_valid(a, step)),
            Self::Ids(ids) => ids.iter().any(|id| present(id)),
            Self::PerScene(scenes) => scenes.get(&scene.name).into_iter().flatten().any(|id| present(id)),
        }
    }
}

/// What follows when a controlled agent touches another one, or leaves the road.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Consequence {
    /// Nothing; the event is reported.
    Ignore,
    /// The agent stands still from then on, and its episode goes on.
    Stop,
    /// The agent leaves the world, and its episode ends.
    Remove,
    /// The agent's episode ends.
    Terminate,
}

/// What happens to a world whose episode has ended (Gymnasium's autoreset modes).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// The next step resets it; the action of that step is ignored and its reward is zero.
    NextStep,
    /// It is reset within the step; the last observation goes to `final_obs`.
    SameStep,
    /// It waits for a reset; stepping it is an error.
    Disabled,
}

/// How the scene of an episode is chosen when the reset names none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneOrder {
    /// Uniformly, from the world's generator.
    Random,
    /// World i of E plays scenes i, i + E, i + 2E … in the order of the scene list, and round again.
    Sequential,
}

/// How the reward is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RewardForm {
    /// Weighted sum of the components.
    Sum,
    /// New progress times factors for comfort, speed, time to contact and distance from the route, as in CaRL (Jaeger
    /// et al., 2025); collisions count where they are the agent's fault. The weights of the factors are unused.
    Product,
}

/// Weights of the reward components; the reward is their sum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RewardConfig {
    /// How the reward is made.
    pub form: RewardForm,
    /// Per metre of new progress along the route.
    pub progress: Real,
    /// At the step of a collision.
    pub collision: Real,
    /// At each step with a corner off the road.
    pub off_road: Real,
    /// Per unit of discomfort, (a / 4 m/s²)² + (jerk / 10 m/s³)² + (lateral a / 4 m/s²)², at most 3, per step.
    pub comfort: Real,
    /// Per m/s above the speed limit, per step.
    pub speed_limit: Real,
    /// Per metre of distance from the route, at most 3, per step.
    pub lane_keeping: Real,
    /// When the goal is reached.
    pub goal: Real,
}

impl Default for RewardConfig {
    fn default() -> Self {
        Self {
            form: RewardForm::Sum,
            progress: 0.1,
            collision: -10.0,
            off_road: -5.0,
            comfort: -0.004,
            speed_limit: -0.05,
            lane_keeping: -0.02,
            goal: 2.0,
        }
    }
}

/// Actions. Continuous ones are normalised: each column lies in [-1, 1], zero means zero, and +1 and −1 mean the
/// figures below, or less where the dynamics' own limits are narrower.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActionConfig {
    /// Model of motion with its limits. By default vehicles brake to a stop and do not reverse.
    pub dynamics: Dynamics,
    /// Actions are indices of `grid`, not numbers.
    pub discrete: bool,
    /// Physical actions to choose from; the dynamics' default grid if absent.
    pub grid: Option<ActionGrid>,
    /// Acceleration at +1, m/s².
    pub max_acceleration_mps2: Real,
    /// Deceleration at −1, m/s².
    pub max_deceleration_mps2: Real,
    /// Unicycle: yaw rate at +1, rad/s.
    pub max_yaw_rate_radps: Real,
    /// Bicycle: front wheel angle at +1, rad.
    pub max_steering_rad: Real,
    /// Delta pose: displacement at +1, metres per step.
    pub max_displacement_m: Real,
    /// Delta pose: turn at +1, rad per step.
    pub max_turn_rad: Real,
}

impl Default for ActionConfig {
    fn default() -> Self {
        Self {
            dynamics: Dynamics::Unicycle(UnicycleLimits {
                speed_mps: [0.0, 30.0],
                ..UnicycleLimits::default()
            }),
            discrete: false,
            grid: None,
            max_acceleration_mps2: 4.0,
            max_deceleration_mps2: 8.0,
            max_yaw_rate_radps: 1.0,
            max_steering_rad: 0.5,
            max_displacement_m: 3.0,
            max_turn_rad: 0.1,
        }
    }
}

/// Configuration of a [`super::VecWorld`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldConfig {
    /// Step, seconds; must equal the scenes' own.
    pub dt_s: Real,
    /// Logged steps before the first free one; episodes start at this step of the log.
    pub history_steps: usize,
    /// Episodes start up to this many steps later, drawn anew for each; 0: always at the same step.
    pub start_spread_steps: usize,
    /// Steps of an episode at most.
    pub horizon_steps: usize,
    /// Steps for which an action is held: a call of `step` advances by so many, or up to the episode's end.
    pub decision_steps: usize,
    /// Agents with a slot.
    pub controlled: Controlled,
    /// Slots per world, C.
    pub num_slots: usize,
    /// Who drives the agents that have a slot: actions from outside ([`EXTERNAL`]), or a policy by name.
    pub driver: String,
    /// Who drives the other vehicles; pedestrians, cyclists, motorcycles and static obstacles follow the log.
    pub traffic: Traffic,
    /// Who drives single vehicles, by their ids, whatever `driver` and `traffic` say.
    pub drivers: BTreeMap<String, String>,
    /// Agents that the log brings later enter (once their place is free).
    pub late_arrivals: bool,
    /// Background agents leave when the log has them no more; otherwise they drive on to the end of their route.
    pub vanish_with_log: bool,
    /// The episode is truncated where the log ends.
    pub truncate_at_log_end: bool,
    /// Consequence of a collision for a controlled agent.
    pub on_collision: Consequence,
    /// Consequence of a contact for agents without a slot, where a vehicle takes part in it that does not follow its log:
    /// ignore or stop.
    pub on_traffic_collision: Consequence,
    /// Consequence of a box corner off the road for a controlled agent.
    pub on_off_road: Consequence,
    /// The episode of an agent ends when it reaches its goal, the logged position at the episode's last step.
    pub terminate_at_goal: bool,
    /// Speed limit where the map has none, m/s.
    pub speed_limit_mps: Real,
    /// Actions.
    pub action: ActionConfig,
    /// Observations.
    pub observation: ObservationConfig,
    /// Rewards.
    pub reward: RewardConfig,
    /// Intelligent driver model.
    pub idm: IdmConfig,
    /// Options of further policies by name, unread here; part of what snapshots are checked against.
    pub policies: BTreeMap<String, serde_json::Value>,
    /// Autoreset mode.
    pub autoreset: Autoreset,
    /// Choice of scenes.
    pub scene_order: SceneOrder,
}

impl Default for WorldConfig {
    fn default() -> Self {
        Self {
            dt_s: 0.1,
            history_steps: 30,
            start_spread_steps: 0,
            horizon_steps: 100,
            decision_steps: 1,
            controlled: Controlled::Ego,
            num_slots: 1,
            driver: EXTERNAL.into(),
            traffic: "replay".into(),
            drivers: BTreeMap::new(),
            late_arrivals: true,
            vanish_with_log: false,
            truncate_at_log_end: true,
            on_collision: Consequence::Terminate,
            on_traffic_collision: Consequence::Stop,
            on_off_road: Consequence::Terminate,
            terminate_at_goal: true,
            speed_limit_mps: 15.0,
            action: ActionConfig::default(),
            observation: ObservationConfig::default(),
            reward: RewardConfig::default(),
            idm: IdmConfig::default(),
            policies: BTreeMap::new(),
            autoreset: Autoreset::NextStep,
            scene_order: SceneOrder::Random,
        }
    }
}

fn check(ok: bool, field: &'static str, got: impl ToString, expected: &str) -> Result<()> {
    if ok { Ok(()) } else { Err(SimError::Config { field, got: got.to_string(), expected: expected.into() }) }
}

impl WorldConfig {
    /// Parses and checks a configuration.
    ///
    /// # Errors
    /// [`SimError::Config`] for unknown fields, wrong types and values out of range.
    pub fn from_json(text: &str) -> Result<Self> {
        let config: Self = serde_json::from_str(text).map_err(|e| SimError::Config {
            field: "json",
            got: e.to_string(),
            expected: "the fields of WorldConfig".into(),
        })?;
        config.validate()?;
        Ok(config)
    }

    /// Checks every range.
    ///
    /// # Errors
    /// [`SimError::Config`] names the first field that is out of its range.
    pub fn validate(&self) -> Result<()> {
        let positive = |x: Real| x.is_finite() && x > 0.0;
        check(positive(self.dt_s) && self.dt_s <= 1.0, "dt_s", self.dt_s, "seconds in (0, 1]")?;
        check(self.horizon_steps >= 1, "horizon_steps", self.horizon_steps, "at least 1")?;
        check(self.decision_steps >= 1, "decision_steps", self.decision_steps, "at least 1")?;
        check((1..=512).contains(&self.num_slots), "num_slots", self.num_slots, "1 to 512")?;
        check(
            self.controlled != Controlled::Ego || self.num_slots == 1,
            "num_slots",
            self.num_slots,
            "1 when only the ego is controlled",
        )?;
        if let Controlled::Ids(ids) = &self.controlled {
            let expected = "as many slots as there are ids, ids not empty";
            check(!ids.is_empty() && ids.len() == self.num_slots, "num_slots", self.num_slots, expected)?;
        }
        if let Controlled::PerScene(scenes) = &self.controlled {
            let longest = scenes.values().map(Vec::len).max().unwrap_or(0);
            let expected = "at least as many slots as any scene has ids";
            check(longest <= self.num_slots, "num_slots", self.num_slots, expected)?;
        }
        let external = self.traffic.names().any(|name| name == EXTERNAL);
        check(!external, "traffic", EXTERNAL, "a background policy")?;
        if let Traffic::Mix(shares) = &self.traffic {
            let sum: Real = shares.values().sum();
            let good = shares.values().all(|s| *s >= 0.0) && (sum - 1.0).abs() < 1e-3;
            check(good, "traffic", format!("{shares:?}"), "shares of at least 0 that sum to 1")?;
        }
        let stop = matches!(self.on_traffic_collision, Consequence::Ignore | Consequence::Stop);
        let got = format!("{:?}", self.on_traffic_collision);
        check(stop, "on_traffic_collision", got.to_lowercase(), "ignore or stop")?;
        check(positive(self.speed_limit_mps), "speed_limit_mps", self.speed_limit_mps, "a positive speed")?;
        let r = &self.reward;
        for (field, value) in [
            ("reward.progress", r.progress),
            ("reward.collision", r.collision),
            ("reward.off_road", r.off_road),
            ("reward.comfort", r.comfort),
            ("reward.speed_limit", r.speed_limit),
            ("reward.lane_keeping", r.lane_keeping),
            ("reward.goal", r.goal),
        ] {
            check(value.is_finite() && value.abs() <= 1e6, field, value, "a finite weight")?;
        }
        let a = &self.action;
        for (field, value) in [
            ("action.max_acceleration_mps2", a.max_acceleration_mps2),
            ("action.max_deceleration_mps2", a.max_deceleration_mps2),
            ("action.max_yaw_rate_radps", a.max_yaw_rate_radps),
            ("action.max_steering_rad", a.max_steering_rad),
            ("action.max_displacement_m", a.max_displacement_m),
            ("action.max_turn_rad", a.max_turn_rad),
        ] {
            check(positive(value), field, value, "a positive number")?;
        }
        check(a.max_steering_rad < 1.5, "action.max_steering_rad", a.max_steering_rad, "below 1.5 rad")?;
        if let Some(fault) = a.dynamics.first_fault() {
            check(false, "action.dynamics", format!("bad {fault}"), "finite limits in order")?;
        }
        if let Some(grid) = &a.grid {
            let finite = grid.first.iter().chain(&grid.second).all(|v| v.is_finite());
            let got = format!("{} x {}", grid.first.len(), grid.second.len());
            check(
                finite && (2..=10_000).contains(&grid.len()),
                "action.grid",
                got,
                "2 to 10000 finite actions",
            )?;
        }
        match self.idm.first_fault() {
            Some((field, value, expected)) => check(false, field, value, expected),
            None => Ok(()),
        }
    }

    /// Whether somebody drives under a name from the start of an episode.
    pub fn names(&self, policy: &str) -> bool {
        let mut names = self.traffic.names().chain(self.drivers.values().map(String::as_str));
        self.driver == policy || names.any(|name| name == policy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_legal_and_survives_json() {
        let config = WorldConfig::default();
        config.validate().unwrap();
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(WorldConfig::from_json(&text).unwrap(), config);
    }

    #[test]
    fn bad_values_are_named() {
        for (json, field) in [
            (r#"{"dt_s": 0}"#, "dt_s"),
            (r#"{"traffic": "external"}"#, "traffic"),
            (r#"{"num_slots": 3}"#, "num_slots"),
            (r#"{"decision_steps": 0}"#, "decision_steps"),
            (r#"{"colour": 3}"#, "json"),
            (r#"{"reward": {"goal": 1e9}}"#, "reward.goal"),
        ] {
            match WorldConfig::from_json(json) {
                Err(SimError::Config { field: got, .. }) => assert_eq!(got, field, "{json}"),
                other => panic!("{json} gave {other:?}"),
            }
        }
    }
}
