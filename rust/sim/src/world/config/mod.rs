//! Everything that can be chosen about a world, checked once.

mod differences;
mod traffic;

pub use differences::{Drawn, Randomization};
pub(crate) use differences::{check_style, styled};
pub use traffic::{EXTERNAL, Traffic};

use crate::choices;
use crate::drivers::IdmConfig;
use crate::dynamics::{ActionGrid, AssistedLimits, BicycleLimits, DeltaPoseLimits, Dynamics, UnicycleLimits};
use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::observe::{BevConfig, ObservationConfig};
use crate::options;
use crate::options::{POSITIVE_MOTION, Table, WEIGHT, within};
use crate::scene::{AgentKind, EGO_ID, Scene};
use crate::world::reward_columns::RewardConfig;
use differences::check_styles;
use std::collections::BTreeMap;

choices! {
    /// Agents with a slot: they are observed, rewarded and, by default, controlled by actions.
    #[derive(Clone, Eq)]
    pub enum Controlled {
        /// The ego.
        Ego = "ego",
        /// A vehicle and a start drawn for each episode from those whose log is 10 m away at the end of the horizon; in a
        /// scene without any, the ego. `ego="any"` for short.
        Any = "any",
        /// Vehicles present at the start, the ego first, then by `ranking`, as many as there are slots.
        Vehicles = "vehicles",
        /// Agents by id; unknown ones leave their slot empty.
        Ids(Vec<String>) = "ids",
        /// Agents by id for each scene by its name; other slots stay empty.
        PerScene(BTreeMap<String, Vec<String>>) = "per_scene",
    }
}

impl Controlled {
    /// Whether one of these agents is there at a step of a scene's log.
    pub(crate) fn anyone_at(&self, scene: &Scene, step: usize) -> bool {
        let present = |id: &str| scene.agent_index(id).is_some_and(|a| scene.is_valid(a, step));
        match self {
            Self::Ego | Self::Any => present(EGO_ID),
            Self::Vehicles => (0..scene.num_agents())
                .any(|a| scene.agents[a].kind == AgentKind::Vehicle && scene.is_valid(a, step)),
            Self::Ids(ids) => ids.iter().any(|id| present(id)),
            Self::PerScene(scenes) => scenes.get(&scene.name).into_iter().flatten().any(|id| present(id)),
        }
    }
}

choices! {
    /// Which vehicles come first where an episode starts.
    #[derive(Clone, Copy, Eq)]
    pub enum VehicleRanking {
        /// Those of heavy cliques of the time-to-contact graph of the three seconds before.
        Cliques = "cliques",
        /// The nearest to the ego.
        Nearest = "nearest",
        /// Those that would touch the ego soonest at constant velocities, then the nearest.
        Ttc = "ttc",
        /// The scene's order.
        First = "first",
        /// A shuffle, the same for every episode.
        Random = "random",
    }
}

choices! {
    /// What follows when a controlled agent touches another one, or leaves the road.
    #[derive(Clone, Copy, Eq)]
    pub enum Consequence {
        /// Nothing; the event is reported.
        Ignore = "ignore",
        /// The agent stands still from then on, and its episode goes on.
        Stop = "stop",
        /// The agent leaves the world, and its episode ends.
        Remove = "remove",
        /// The agent's episode ends.
        Terminate = "terminate",
    }
}

choices! {
    /// Who moves pedestrians.
    #[derive(Clone, Copy, Eq)]
    pub enum Pedestrians {
        /// Their log.
        Replay = "replay",
        /// The social force model along their logged paths: they give way to vehicles and to each other.
        SocialForce = "social_force",
    }
}

choices! {
    /// What follows when agents without a slot touch.
    #[derive(Clone, Copy, Eq)]
    pub enum TrafficCollision {
        /// They go on through one another (paper).
        Ignore = "ignore",
        /// They stay where they touch.
        Stop = "stop",
    }
}

choices! {
    /// What happens to a world whose episode has ended (Gymnasium's autoreset modes).
    #[derive(Clone, Copy, Eq)]
    pub enum Autoreset {
        /// The next step resets it; the action of that step is ignored and its reward is zero.
        NextStep = "next_step",
        /// It is reset within the step; the last observation goes to `final_obs`.
        SameStep = "same_step",
        /// It waits for a reset; stepping it is an error.
        Disabled = "disabled",
    }
}

choices! {
    /// How the scene of an episode is chosen when the reset names none.
    #[derive(Clone, Copy, Eq)]
    pub enum SceneOrder {
        /// Uniformly, from the world's generator.
        Random = "random",
        /// World i of E plays scenes i, i + E, i + 2E … in the order of the scene list, and round again.
        Sequential = "sequential",
    }
}

options! {
    /// Actions. Continuous ones are normalised: each column lies in [-1, 1], zero means zero, and +1 and -1 mean the
    /// figures below, or less where the dynamics' own limits are narrower.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct ActionConfig {
        /// Model of motion with its limits; also by name or as `{name: limits}`.
        dynamics: Dynamics = Dynamics::default();
        /// Whether actions are indices of `grid`, not numbers.
        discrete: bool = false;
        /// Physical actions to choose from; `None`: the dynamics' default 7 x 9 grid.
        grid: Option<ActionGrid> = None;
        /// Acceleration at +1.
        max_acceleration_mps2: Real = 4.0, unit "m/s²", range POSITIVE_MOTION;
        /// Deceleration at -1.
        max_deceleration_mps2: Real = 8.0, unit "m/s²", range POSITIVE_MOTION;
        /// Unicycle: yaw rate at +1.
        max_yaw_rate_radps: Real = 1.0, unit "rad/s", range within(0.0, 10.0).open_below();
        /// Bicycle: front wheel angle at +1.
        max_steering_rad: Real = 0.5, unit "rad", range within(0.0, 1.5).open_below().open_above();
        /// Delta pose: displacement at +1, per step.
        max_displacement_m: Real = 3.0, unit "m", range POSITIVE_MOTION;
        /// Delta pose: turn at +1, per step.
        max_turn_rad: Real = 0.1, unit "rad", range within(0.0, 3.1).open_below();
    }
}

options! {
    /// Configuration of worlds.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct WorldConfig {
        /// Step; must equal the scenes' own.
        dt_s: Real = 0.1, unit "s", range within(0.0, 1.0).open_below();
        /// Logged steps before the first free one; episodes start at this step of the log. Drivers that use more
        /// history see the earlier states as missing.
        history_steps: usize = 30, range within(0.0, 10_000.0);
        /// Episodes start up to this many steps later, sampled for each episode. Sampled egos start anywhere by
        /// default.
        start_spread_steps: usize = 0, range within(0.0, 10_000.0);
        /// Share of the episodes of sampled egos that take any vehicle, also one whose log stands.
        standing_share: Real = 0.0, range within(0.0, 1.0);
        /// Steps of an episode at most.
        horizon_steps: usize = 100, range within(1.0, 100_000.0);
        /// Steps that a call of `step` holds its action for, at most to the end of the episode. Rewards are summed up; a
        /// learner's discount per call is that of a step to this power.
        decision_steps: usize = 1, range within(1.0, 1000.0);
        /// Agents with a slot, which are observed and rewarded; ids as a list, or as lists by the name of the scene.
        controlled: Controlled = Controlled::Ego;
        /// Slots per world.
        num_slots: usize = 1, range within(1.0, 512.0);
        /// Which vehicles get the slots of `controlled="vehicles"`, behind the ego.
        ranking: VehicleRanking = VehicleRanking::First;
        /// Driver of the agents with a slot: `"external"` (actions), or a name.
        driver: String = EXTERNAL.into();
        /// Who drives the other vehicles: a driver by name, or shares by name that sum to 1, drawn for each vehicle and
        /// episode from the world's seed. Cyclists, motorcycles and obstacles follow the log. A `PythonTraffic` is also
        /// accepted.
        traffic: Traffic = "replay".into();
        /// Who moves pedestrians.
        pedestrians: Pedestrians = Pedestrians::Replay;
        /// Drivers of single vehicles by id, in place of `driver` and `traffic`.
        drivers: BTreeMap<String, String> = BTreeMap::new();
        /// Whether agents that appear later in the log enter. They never appear inside driven agents.
        late_arrivals: bool = true;
        /// Whether background agents leave at the end of their log; else they drive on.
        vanish_with_log: bool = false;
        /// Whether the episode is truncated where the log ends.
        truncate_at_log_end: bool = true;
        /// Consequence of a collision for a controlled agent.
        on_collision: Consequence = Consequence::Terminate;
        /// What follows when agents without a slot touch and one of them, a vehicle, does not follow its log.
        on_traffic_collision: TrafficCollision = TrafficCollision::Stop;
        /// Consequence of a box corner off the road for a controlled agent.
        on_off_road: Consequence = Consequence::Terminate;
        /// Consequence of passing a stop line in red for a controlled agent.
        on_red_light: Consequence = Consequence::Ignore;
        /// Whether an agent's episode ends at its goal, the logged position at the episode's last step; else it drives on.
        terminate_at_goal: bool = true;
        /// Agents with a slot that play against the others, ids by the name of the scene. The reward of an adversary is
        /// minus the mean reward of the others; once only adversaries are left, their episodes are truncated.
        adversaries: BTreeMap<String, Vec<String>> = BTreeMap::new();
        /// Slots after the first one that also hold adversaries.
        num_adversaries: usize = 0, range within(0.0, 511.0);
        /// Share of the rewards for its own road departures and discomfort that an adversary also gets.
        adversary_shaping: Real = 0.0, range WEIGHT;
        /// Speed limit where the map has none.
        speed_limit_mps: Real = 15.0, unit "m/s", range POSITIVE_MOTION;
        /// Actions.
        action: ActionConfig = ActionConfig::default();
        /// Observations.
        observation: ObservationConfig = ObservationConfig::default();
        /// Rewards.
        reward: RewardConfig = RewardConfig::default();
        /// Lowest and highest factors of weights of the reward by name, drawn for each episode or set by a reset, and
        /// observed as `style`.
        style: BTreeMap<String, [Real; 2]> = BTreeMap::new(), range within(0.0, 1e6);
        /// Unobserved changes of the dynamics.
        randomization: Randomization = Randomization::default();
        /// Options of the driver `"idm"`.
        idm: IdmConfig = IdmConfig::default();
        /// Further drivers by custom names, as `{kind: options}`; part of what snapshots are checked against. In Python
        /// those of networks have a field of their own.
        named_drivers: BTreeMap<String, serde_json::Value> = BTreeMap::new();
        /// What happens to a world whose episode has ended.
        autoreset: Autoreset = Autoreset::NextStep;
        /// How the scene of an episode is chosen when the reset names none.
        scene_order: SceneOrder = SceneOrder::Random;
    }
}

/// All tables of a configuration of worlds.
pub const TABLES: &[&Table] = &[
    &WorldConfig::TABLE,
    &ActionConfig::TABLE,
    &UnicycleLimits::TABLE,
    &BicycleLimits::TABLE,
    &DeltaPoseLimits::TABLE,
    &AssistedLimits::TABLE,
    &ActionGrid::TABLE,
    &ObservationConfig::TABLE,
    &BevConfig::TABLE,
    &RewardConfig::TABLE,
    &Randomization::TABLE,
    &IdmConfig::TABLE,
];

fn check(ok: bool, field: &'static str, got: impl ToString, expected: &str) -> Result<()> {
    if ok { Ok(()) } else { Err(SimError::config(field, got, expected)) }
}

impl WorldConfig {
    /// Parses and checks a configuration.
    ///
    /// # Errors
    /// [`SimError::Config`] for unknown fields, wrong types and values out of range.
    pub fn from_json(text: &str) -> Result<Self> {
        let config: Self = options::read("", text)?;
        config.check_together()?;
        Ok(config)
    }

    /// Checks every range, and that the fields do not contradict each other.
    ///
    /// # Errors
    /// [`SimError::Config`] names the first field that is wrong.
    pub fn validate(&self) -> Result<()> {
        options::check("", self)?;
        self.check_together()
    }

    fn check_together(&self) -> Result<()> {
        let slots = self.num_slots;
        let (fits, expected) = match &self.controlled {
            Controlled::Ego | Controlled::Any => (slots == 1, "1 when only the ego is controlled"),
            Controlled::Ids(ids) => {
                (!ids.is_empty() && ids.len() == slots, "as many slots as there are ids, ids not empty")
            }
            Controlled::PerScene(scenes) => {
                (scenes.values().all(|ids| ids.len() <= slots), "at least as many slots as any scene has ids")
            }
            Controlled::Vehicles => (true, ""),
        };
        check(fits, "num_slots", slots, expected)?;
        let external = self.traffic.shares().iter().any(|(name, _)| *name == EXTERNAL);
        check(!external, "traffic", EXTERNAL, "a driver of traffic")?;
        if let Traffic::Mix(shares) = &self.traffic {
            let sum: Real = shares.values().sum();
            let good = shares.values().all(|s| *s >= 0.0) && (sum - 1.0).abs() < 1e-3;
            check(good, "traffic", format!("{shares:?}"), "shares of at least 0 that sum to 1")?;
        }
        if let Dynamics::Assisted(limits) = &self.action.dynamics
            && let Some((name, range)) = limits.off_zero()
        {
            let got = format!("{name} = {range:?}");
            check(false, "action.dynamics.assisted", got, "a range about zero")?;
        }
        let own = !matches!(self.action.dynamics, Dynamics::DeltaPose(_));
        let expected = "no gains and delays of actions that are poses";
        check(own || !self.randomization.of_actions(), "randomization", "given", expected)?;
        check_styles(&self.style, &self.reward)?;
        if let Some(grid) = &self.action.grid {
            let got = format!("{} x {}", grid.first.len(), grid.second.len());
            check((2..=10_000).contains(&grid.num_actions()), "action.grid", got, "2 to 10000 actions")?;
        }
        Ok(())
    }

    /// Whether agents may have a driver of this name from the start of an episode.
    pub fn names(&self, driver: &str) -> bool {
        let in_traffic = self.traffic.shares().iter().any(|(name, _)| *name == driver);
        in_traffic || self.driver == driver || self.drivers.values().any(|name| name == driver)
    }
}
