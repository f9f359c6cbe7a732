"""Fields of configurations, written by `python -m tools.configuration`: do not edit.

docs/configuration.md says what the choices mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from ccdiff_env.traffic.checked_options import Options

#: Agents with a slot: they are observed, rewarded and, by default, controlled by actions.
Controlled: TypeAlias = (
    Literal["ego", "any", "vehicles"] | tuple[str, ...] | Mapping[str, tuple[str, ...]]
)

#: Which vehicles come first where an episode starts.
VehicleRanking: TypeAlias = Literal["cliques", "nearest", "ttc", "first", "random"]

#: Who moves pedestrians.
Pedestrians: TypeAlias = Literal["replay", "social_force"]

#: What follows when a controlled agent touches another one, or leaves the road.
Consequence: TypeAlias = Literal["ignore", "stop", "remove", "terminate"]

#: What follows when agents without a slot touch.
TrafficCollision: TypeAlias = Literal["ignore", "stop"]


@dataclass(frozen=True, kw_only=True)
class UnicycleLimits(Options):
    """Limits of the unicycle: actions are acceleration (m/s²) and yaw rate (rad/s).

    The defaults are those of the released models of traffic (reference.md, dynamics), but for the
    reverse gear.
    """

    #: Lowest and highest acceleration (m/s², in [-100, 100]).
    acceleration_mps2: tuple[float, float] = (-10.0, 8.0)
    #: Lowest and highest speed (m/s, in [-100, 100]). Vehicles brake to a stop and do not reverse.
    speed_mps: tuple[float, float] = (0.0, 30.0)
    min_yaw_rate_radps: float = 0.1  #: Yaw rate that is allowed at any speed (rad/s, in (0, 10]).
    max_curvature_1pm: float = 0.5  #: Highest yaw rate per speed, a curvature (1/m, in (0, 10]).
    #: Highest yaw rate times speed (m/s², in (0, 100]).
    max_lateral_acceleration_mps2: float = 6.2831855
    #: The acceleration of an agent of a world changes no faster than this (m/s³, in (0, 1000]).
    max_jerk_mps3: float = 1000.0
    #: The yaw rate of an agent of a world changes no faster than this, but for the limits above
    #: (rad/s², in (0, 1000]).
    max_yaw_acceleration_radps2: float = 1000.0


@dataclass(frozen=True, kw_only=True)
class BicycleLimits(Options):
    """Limits of the kinematic bicycle: actions are acceleration (m/s²) and steering angle (rad)."""

    #: Lowest and highest acceleration (m/s², in [-100, 100]).
    acceleration_mps2: tuple[float, float] = (-10.0, 8.0)
    #: Lowest and highest speed along the heading (m/s, in [-100, 100]). Vehicles brake to a stop
    #: and do not reverse.
    speed_mps: tuple[float, float] = (0.0, 30.0)
    #: Largest steering angle of the front wheel, below π/2 (rad, in (0, 1.57]).
    max_steering_rad: float = 0.6
    #: Highest yaw rate times speed (m/s², in (0, 100]).
    max_lateral_acceleration_mps2: float = 6.2831855
    #: Wheelbase as a share of the length (in (0, 1]). 0.6 fits passenger cars: nuPlan's Pacifica
    #: has 3.089 m of 5.176 m.
    wheelbase_share: float = 0.6


@dataclass(frozen=True, kw_only=True)
class DeltaPoseLimits(Options):
    """Limits of one step of the delta-pose model: actions are dx, dy (m) and turn (rad) in the
    agent's own frame.

    The defaults allow −10 to 40 m/s along, 10 m/s across and 5 rad/s at steps of 0.1 s.
    """

    #: Lowest and highest displacement forwards per step (m, in [-100, 100]).
    dx_m: tuple[float, float] = (-1.0, 4.0)
    #: Lowest and highest displacement to the left per step (m, in [-100, 100]).
    dy_m: tuple[float, float] = (-1.0, 1.0)
    #: Lowest and highest turn to the left per step (rad, in [-3.1, 3.1]).
    dheading_rad: tuple[float, float] = (-0.5, 0.5)


#: Rule whose driving the actions change.
AssistedBase: TypeAlias = Literal["idm", "pdm"]


@dataclass(frozen=True, kw_only=True)
class AssistedLimits(Options):
    """Limits of assisted driving: actions change what IDM or PDM-Closed would do.

    The vehicle is a unicycle with the acceleration of its base plus a change, steered to a distance
    from its base's path; the zero action is the base.
    """

    base: AssistedBase = "idm"  #: The rule that is changed.
    #: Change of the acceleration at -1 and +1, about zero (m/s², in [-100, 100]).
    delta_mps2: tuple[float, float] = (-6.0, 2.0)
    #: Distance from the path at -1 and +1, left positive, about zero (m, in [-100, 100]).
    offset_m: tuple[float, float] = (-1.5, 1.5)
    #: Lowest and highest acceleration, about zero (m/s², in [-100, 100]).
    acceleration_mps2: tuple[float, float] = (-8.0, 2.4)
    #: The acceleration changes no faster than this, except down to that of the base, or up to that
    #: of PDM (m/s³, in (0, 1000]).
    max_jerk_mps3: float = 8.0
    #: The base's own acceleration changes no faster than this, except where it brakes harder than
    #: nuPlan's comfort allows, 4.05 m/s² (m/s³, in (0, 1000]).
    base_jerk_mps3: float = 1000.0
    speed_mps: tuple[float, float] = (0.0, 30.0)  #: Lowest and highest speed (m/s, in [-100, 100]).


#: Model of motion with its limits.
Dynamics: TypeAlias = UnicycleLimits | BicycleLimits | DeltaPoseLimits | AssistedLimits

DYNAMICS: dict[str, type[Dynamics]] = {
    "unicycle": UnicycleLimits,
    "bicycle": BicycleLimits,
    "delta_pose": DeltaPoseLimits,
    "assisted": AssistedLimits,
}


@dataclass(frozen=True, kw_only=True)
class ActionGrid(Options):
    """Physical actions to choose from: every value of one axis with every value of the other.

    The action of an index is ``first[index // len(second)]``, ``second[index % len(second)]``. The
    first axis is column 0 (acceleration, its change, or dx). The second is the turning column: 2
    (dψ) for delta pose, whose dy is 0, else 1.
    """

    first: tuple[float, ...]  #: Accelerations, m/s² (delta pose: dx, m) (in [-100, 100]).
    #: Yaw rates, rad/s (bicycle: steering angles, rad (in [-100, 100]); delta pose: turns, rad;
    #: assisted: distances, m).
    second: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class ActionConfig(Options):
    """Actions.

    Continuous ones are normalised: each column lies in [-1, 1], zero means zero, and +1 and -1 mean
    the figures below, or less where the dynamics' own limits are narrower.
    """

    #: Model of motion with its limits; also by name or as ``{name: limits}``.
    dynamics: Dynamics = field(default_factory=UnicycleLimits)
    discrete: bool = False  #: Whether actions are indices of ``grid``, not numbers.
    #: Physical actions to choose from; ``None``: the dynamics' default 7 x 9 grid.
    grid: ActionGrid | None = None
    max_acceleration_mps2: float = 4.0  #: Acceleration at +1 (m/s², in (0, 100]).
    max_deceleration_mps2: float = 8.0  #: Deceleration at -1 (m/s², in (0, 100]).
    max_yaw_rate_radps: float = 1.0  #: Unicycle: yaw rate at +1 (rad/s, in (0, 10]).
    max_steering_rad: float = 0.5  #: Bicycle: front wheel angle at +1 (rad, in (0, 1.5)).
    max_displacement_m: float = 3.0  #: Delta pose: displacement at +1, per step (m, in (0, 100]).
    max_turn_rad: float = 0.1  #: Delta pose: turn at +1, per step (rad, in (0, 3.1]).


@dataclass(frozen=True, kw_only=True)
class BevConfig(Options):
    """Choice of the bird's-eye raster, uint8 [channels, S, S]."""

    size_px: int = 84  #: Rows and columns S (in [8, 1024]).
    metres_per_px: float = 0.6  #: Side of a pixel (m, in [0.05, 10]).
    lights: bool = False  #: Whether there is a channel of traffic lights.


@dataclass(frozen=True, kw_only=True)
class ObservationConfig(Options):
    """Choice of rows and columns of the observation."""

    num_neighbors: int = 12  #: Nearest agents that are seen, K rows (in [0, 512]).
    num_route_points: int = 10  #: Points of the route ahead, P rows (in [0, 256]).
    route_spacing_m: float = 4.0  #: Distance from one route point to the next (m, in (0, 1000]).
    #: Nearest segments of map lines, N rows (in [0, 256]); egos learn faster without.
    num_map_segments: int = 0
    radius_m: float = 60.0  #: Agents farther than this are not seen (m, in (0, 1000]).
    masks: bool = True  #: Whether masks are part of the row.
    #: Columns of ``ego``; ``None``, or ``"default"`` in the list: all but those on request.
    ego_columns: tuple[str, ...] | None = None
    agent_columns: tuple[str, ...] | None = None  #: Columns of ``agents``, in the same way.
    map_columns: tuple[str, ...] | None = None  #: Columns of ``map``, in the same way.
    bev: BevConfig | None = None  #: Bird's-eye raster beside the row; ``None``: none.


#: Form of the reward.
RewardForm: TypeAlias = Literal["sum", "product"]


@dataclass(frozen=True, kw_only=True)
class RewardConfig(Options):
    """Weights of the reward components; the reward is their sum, or a product of factors.

    Also by the name of a form: ``reward="product"``.
    """

    form: RewardForm = "sum"  #: Form of the reward.
    progress: float = 0.02  #: Per metre of new progress along the route (in [-1000000, 1000000]).
    collision: float = -2.5  #: At the step of a collision (in [-1000000, 1000000]).
    off_road: float = -3.0  #: At each step with a corner off the road (in [-1000000, 1000000]).
    #: Per unit of discomfort, (a / 4 m/s²)² + (jerk / 10 m/s³)² + (lateral a / 4 m/s²)², at most 3,
    #: per step (in [-1000000, 1000000]).
    comfort: float = -0.004
    speed_limit: float = -0.01  #: Per m/s above the speed limit, per step (in [-1000000, 1000000]).
    #: Per metre of offset across the route, at most 3, per step (in [-1000000, 1000000]).
    lane_keeping: float = -0.004
    goal: float = 1.0  #: When the goal is reached (in [-1000000, 1000000]).
    #: Per m/s³ of jerk either way, at most 10, per step (in [-1000000, 1000000]).
    jerk: float = 0.0
    #: At the step at which the front passes a stop line in red (in [-1000000, 1000000]).
    red_light: float = 0.0
    #: Per m/s below the mean speed that reaches the goal in time, with nobody within 8 m ahead, per
    #: step (in [-1000000, 1000000]).
    lagging: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Randomization(Options):
    """Unobserved changes of the dynamics, drawn for each agent with a slot and episode."""

    acceleration_gain: float = 0.0  #: Accelerations are scaled by up to 1 ± this (in [0, 0.9]).
    yaw_gain: float = 0.0  #: The same for yaw rates or wheel angles (in [0, 0.9]).
    #: Actions take effect up to this many steps late (in [0, 100]); until then the action is zero.
    delay_steps: int = 0
    size: float = 0.0  #: Length and width are scaled by up to 1 ± this (in [0, 0.9]).
    #: Standard deviation of noise on numbers with a unit in observations, by their scales (in [0,
    #: 10]).
    noise: float = 0.0


@dataclass(frozen=True, kw_only=True)
class IdmConfig(Options):
    """Parameters of the intelligent driver model (Treiber, Hennecke, Helbing 2000)."""

    headway_s: float = 1.2  #: Time headway T (s, in (0, 60]).
    min_gap_m: float = 2.0  #: Gap at standstill s₀ (m, in [0, 100]).
    acceleration_mps2: float = 1.5  #: Greatest acceleration a (m/s², in (0, 100]).
    deceleration_mps2: float = 2.5  #: Comfortable deceleration b (m/s², in (0, 100]).
    max_braking_mps2: float = 8.0  #: Hardest braking (m/s², in (0, 100]).
    exponent: float = 4.0  #: Acceleration exponent δ (in (0, 100]).
    #: Other agents also count at their positions after this time at constant velocity (s, in [0,
    #: 60]).
    anticipation_s: float = 1.0


#: What happens to a world whose episode has ended (Gymnasium's autoreset modes).
Autoreset: TypeAlias = Literal["next_step", "same_step", "disabled"]

#: How the scene of an episode is chosen when the reset names none.
SceneOrder: TypeAlias = Literal["random", "sequential"]


@dataclass(frozen=True, kw_only=True)
class WorldOptions(Options):
    """Configuration of worlds."""

    dt_s: float = 0.1  #: Step (s, in (0, 1]); must equal the scenes' own.
    #: Logged steps before the first free one (in [0, 10000]); episodes start at this step of the
    #: log. Drivers that use more history see the earlier states as missing.
    history_steps: int = 30
    #: Episodes start up to this many steps later, sampled for each episode (in [0, 10000]). Sampled
    #: egos start anywhere by default.
    start_spread_steps: int = 0
    #: Share of the episodes of sampled egos that take any vehicle, also one whose log stands (in
    #: [0, 1]).
    standing_share: float = 0.0
    horizon_steps: int = 100  #: Steps of an episode at most (in [1, 100000]).
    #: Steps that a call of ``step`` holds its action for, at most to the end of the episode (in [1,
    #: 1000]). Rewards are summed up; a learner's discount per call is that of a step to this power.
    decision_steps: int = 1
    #: Agents with a slot, which are observed and rewarded; ids as a list, or as lists by the name
    #: of the scene.
    controlled: Controlled = "ego"
    num_slots: int = 1  #: Slots per world (in [1, 512]).
    #: Which vehicles get the slots of ``controlled="vehicles"``, behind the ego.
    ranking: VehicleRanking = "first"
    #: Driver of the agents with a slot: ``"external"`` (actions), or a name.
    driver: str = "external"
    #: Who drives the other vehicles: a driver by name, or shares by name that sum to 1, drawn for
    #: each vehicle and episode from the world's seed. Cyclists, motorcycles and obstacles follow
    #: the log. A ``PythonTraffic`` is also accepted.
    traffic: str | Mapping[str, float] = "replay"
    pedestrians: Pedestrians = "replay"  #: Who moves pedestrians.
    #: Drivers of single vehicles by id, in place of ``driver`` and ``traffic``.
    drivers: Mapping[str, str] = field(default_factory=dict, hash=False)
    #: Whether agents that appear later in the log enter. They never appear inside driven agents.
    late_arrivals: bool = True
    #: Whether background agents leave at the end of their log; else they drive on.
    vanish_with_log: bool = False
    truncate_at_log_end: bool = True  #: Whether the episode is truncated where the log ends.
    on_collision: Consequence = "terminate"  #: Consequence of a collision for a controlled agent.
    #: What follows when agents without a slot touch and one of them, a vehicle, does not follow its
    #: log.
    on_traffic_collision: TrafficCollision = "stop"
    #: Consequence of a box corner off the road for a controlled agent.
    on_off_road: Consequence = "terminate"
    #: Consequence of passing a stop line in red for a controlled agent.
    on_red_light: Consequence = "ignore"
    #: Whether an agent's episode ends at its goal, the logged position at the episode's last step;
    #: else it drives on.
    terminate_at_goal: bool = True
    #: Agents with a slot that play against the others, ids by the name of the scene. The reward of
    #: an adversary is minus the mean reward of the others; once only adversaries are left, their
    #: episodes are truncated.
    adversaries: Mapping[str, tuple[str, ...]] = field(default_factory=dict, hash=False)
    num_adversaries: int = 0  #: Slots after the first one that also hold adversaries (in [0, 511]).
    #: Share of the rewards for its own road departures and discomfort that an adversary also gets
    #: (in [-1000000, 1000000]).
    adversary_shaping: float = 0.0
    speed_limit_mps: float = 15.0  #: Speed limit where the map has none (m/s, in (0, 100]).
    action: ActionConfig = field(default_factory=ActionConfig)  #: Actions.
    observation: ObservationConfig = field(default_factory=ObservationConfig)  #: Observations.
    reward: RewardConfig = field(default_factory=RewardConfig)  #: Rewards.
    #: Lowest and highest factors of weights of the reward by name, drawn for each episode or set by
    #: a reset, and observed as ``style`` (in [0, 1000000]).
    style: Mapping[str, tuple[float, float]] = field(default_factory=dict, hash=False)
    #: Unobserved changes of the dynamics.
    randomization: Randomization = field(default_factory=Randomization)
    idm: IdmConfig = field(default_factory=IdmConfig)  #: Options of the driver ``"idm"``.
    autoreset: Autoreset = "next_step"  #: What happens to a world whose episode has ended.
    #: How the scene of an episode is chosen when the reset names none.
    scene_order: SceneOrder = "random"


@dataclass(frozen=True, kw_only=True)
class PythonOptions(Options):
    """Options of a custom traffic model, written in Python:
    ``ccdiff_env.traffic.PythonTraffic``.
    """

    replan_steps: int = 5  #: Steps from one plan to the next (in [1, 10000]).
    history_states: int = 31  #: Past states of each agent, the present one included (in [1, 1000]).
    #: Fewest states that the log must have at the start of an episode, the present one included (in
    #: [1, 1000]); an environment that starts earlier is refused. Missing states are not valid.
    least_history_states: int = 1
    #: Points on each vehicle's route, 2 m apart from its position on (in [0, 1000]).
    route_points: int = 41


@dataclass(frozen=True, kw_only=True)
class EgosConfig(Options):
    """Options of traffic that the policy of an ego drives."""

    #: The policy: one of those that ship, or the path of a ``.safetensors`` file.
    policy: str = "ego"


#: The decision causal graph that the network sees.
GraphMode: TypeAlias = Literal["causal", "full"]

#: How the vehicles to be guided are chosen.
Ranking: TypeAlias = (
    Literal["cliques", "greedy", "distance_cliques", "ttc", "first", "random", "gradient", "reach"]
    | Mapping[str, tuple[str, ...]]
)

#: The driver of the vehicles outside the guided set.
BackgroundDriver: TypeAlias = Literal["ccdiff", "idm", "replay"]

#: Agents with which contacts count in the collision objectives.
CollisionTargets: TypeAlias = Literal["ego", "all"]

#: Position of a vehicle relative to the nearest target.
Conflict: TypeAlias = Literal["rear_end", "cut_in", "crossing", "head_on"]

#: Which vehicles stand still for the whole episode.
ParkedRule: TypeAlias = Literal["parked", "standing", "nobody"]


@dataclass(frozen=True, kw_only=True)
class CcdiffConfig(Options):
    """CCDiff as a driver: of the traffic (``traffic="ccdiff"``), or of the controlled agents.

    The options of its rivals as well, ``ccdiff_env.traffic.NETWORKS`` (``traffic="ctg"``,
    docs/rivals.md): options that a network does not use must have their defaults. Plans are made
    for all worlds of a batch at once, every ``replan_steps``, and followed in between.
    """

    #: Weights: ``"fast"`` (the shipped ones of the network), or a safetensors file.
    weights: str = "fast"
    #: Where the network runs: ``"cpu"``, ``"cuda"``, or ``"cuda:N"``, one of several graphics
    #: cards.
    device: str = "cpu"
    #: Distance from the ego, or from any vehicle driven from outside, beyond which IDM drives along
    #: the routes, unseen by the network (m, in [0, 10000]). ``None``: all are planned for.
    plan_radius_m: float | None = None
    #: Steps from one plan to the next n, at most the horizon of the plans (in [1, 1000]).
    replan_steps: int = 5
    #: Network evaluations of the DDIM sampler (one: guidance moves its only step) (in [1, 1000]);
    #: ``None``: DDPM with all 100 steps.
    denoising_steps: int | None = 5
    num_samples: int = 1  #: Samples per plan N (in [1, 1024]).
    #: Weight w of the conditional branch in classifier-free guidance (in [1, 2)).
    cfg_weight: float = 1.0
    #: Standard deviation of the noise that is denoised, or what logits of tokens are divided by (in
    #: (0, 100]); 1 for other networks. Below 1 likely plans are drawn more often.
    temperature: float = 1.0
    #: Correlate the noise of successive plans of a vehicle (0.5; tokens reuse it), so that speeds
    #: after 3 s spread as those of the log (docs/results.md#likelihood-of-the-log).
    keep_noise: bool = False
    #: Whether the network gets the routes of its vehicles: the path of the log, then the lanes
    #: ahead. It needs weights trained with routes. Who backs up in the log goes with it, or waits.
    follow_route: bool = False
    graph: GraphMode = "causal"  #: The decision causal graph G that the network sees.
    num_guided: int | None = 5  #: Vehicles that are guided K (in [0, 512]); ``None``: all.
    #: How they are chosen; ids by the name of the scene choose them directly.
    ranking: Ranking = "cliques"
    #: A policy that chooses, in place of the ranking, which vehicle is guided at every plan and how
    #: strongly, or none: ``"learned"``, the shipped one, or a file
    #: (examples/train_adversary_selection.py). ``criticality`` scales its strengths. It was trained
    #: with ``replan_steps`` of 20.
    adversary_policy: str | None = None
    rerank: bool = True  #: Whether they are chosen again at every plan, not only at the first one.
    #: The driver of the vehicles that are not guided.
    background_driver: BackgroundDriver = "ccdiff"
    #: Scale of the guidance: 0 is realistic traffic, 1 the guidance as configured (in [0, 10]); the
    #: learning rate grows with its power of 1.5 (routes: 1.8 times that, so that an ego collides as
    #: often). Of tokens, a guided vehicle takes the best of 1 + criticality² samples. Worlds can
    #: change it at any time.
    criticality: float = 0.0
    #: Guidance: a preset (``"rl"``, ``"paper"``) or settings.
    guidance: str | Mapping[str, Any] = "rl"
    #: Push unguided plans away from contacts and back onto the road, which costs the gradients of
    #: each plan. Tokens take the first of 8 samples without a contact or a step off the road in 1.5
    #: s.
    careful: bool = False
    #: Agents with which contacts count in the collision objectives.
    collision_targets: CollisionTargets = "ego"
    #: Agents that guidance aims at, by id; empty: those of ``collision_targets``.
    targets: tuple[str, ...] = ()
    #: Kinds of conflict: only vehicles in such a position to the nearest target are guided; empty:
    #: all.
    conflicts: tuple[Conflict, ...] = ()
    #: Whether guided plans that the ego cannot evade are replaced by unguided ones. It evades by
    #: steady accelerations (−8 to 3 m/s²) on the route and up to 2.5 m beside it, between the
    #: guided vehicles.
    avoidable_only: bool = False
    #: Time of the episode from which plans are guided (s, in [0, 10000]).
    guided_from_s: float = 0.0
    #: Time of the episode until which plans are guided (s, in [0, 10000]); ``None``: to its end.
    guided_until_s: float | None = None
    explain: bool = False  #: Whether plans keep attention and gradient statistics, at some cost.
    parked_rule: ParkedRule = "parked"  #: Vehicles that stand still for the whole episode.
