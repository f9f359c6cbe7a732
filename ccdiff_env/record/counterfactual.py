"""What would have happened: other egos, other adversaries, and whether a collision was avoidable.

All questions are asked of forks of a running environment or of a recorded rollout; neither changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import (
    ActionConfig,
    AssistedLimits,
    BicycleLimits,
    DeltaPoseLimits,
    WorldConfig,
)
from ccdiff_env.envs.single import EgoEnv
from ccdiff_env.errors import ConfigError, ResetNeededError
from ccdiff_env.policies.planners import Act, Ego, ego_driver
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, with_tracks
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.snapshot import Snapshot

__all__ = [
    "Attribution",
    "Avoidability",
    "EgoPlan",
    "attribute",
    "avoidability",
    "branch",
    "ego_plans",
    "rollout_avoidability",
]

F32 = npt.NDArray[np.float32]
Cause: TypeAlias = Literal["none", "adversaries", "ego", "either", "both"]


@dataclass(frozen=True)
class EgoPlan:
    """A way to drive on: two accelerations one after the other, along a shifted route.

    Parameters
    ----------
    acceleration_mps2
        At first, and after ``switch_s``.
    switch_s
        Seconds until the second one.
    offset_m
        Distance from the route to drive at, left positive.
    """

    acceleration_mps2: tuple[float, float]
    switch_s: float
    offset_m: float


@dataclass(frozen=True)
class Avoidability:
    """Whether some ego plan avoids every collision.

    Parameters
    ----------
    avoidable
        Whether one of the plans tried does.
    plan
        The first of them, least aggressive first; ``None`` if there is none.
    num_tried, num_safe
        Plans tried, and plans among them that avoid all collisions. The search stops after the
        batch of plans in which one was found.
    """

    avoidable: bool
    plan: EgoPlan | None
    num_tried: int
    num_safe: int


@dataclass(frozen=True)
class Attribution:
    """Who a collision of the ego comes from, by taking one cause away at a time.

    Parameters
    ----------
    collided
        Whether the ego collides as things are.
    without_adversaries
        Whether it collides when nobody is guided against it.
    with_reference
        Whether it collides when a reference planner drives it.
    cause
        ``"none"``: no collision; ``"adversaries"`` or ``"ego"``: it disappears without that one
        only; ``"either"``: without any one of the two; ``"both"``: it stays in either case.
    rollouts
        What happened in the three cases, in the order above.
    """

    collided: bool
    without_adversaries: bool
    with_reference: bool
    cause: Cause
    rollouts: tuple[Rollout, Rollout, Rollout]


def branch(
    env: EgoEnv,
    *,
    ego: Ego,
    adversaries: Sequence[str] | None = None,
    steps: int | None = None,
) -> Rollout:
    """Play a fork of an environment on, to the end or for some steps.

    Parameters
    ----------
    env
        An environment in the middle of an episode; it is not changed.
    ego
        Who drives the ego from here on, as :func:`~ccdiff_env.planners.ego_driver` takes it;
        ``"replay"`` steers back to the log.
    adversaries
        Ids of the vehicles to guide against the ego in CCDiff traffic; ``()`` for nobody,
        ``None`` to leave it as it is.
    steps
        Steps at most.

    Returns
    -------
    Rollout
        From the present state on.

    Raises
    ------
    ResetNeededError
        Before the first reset.
    ConfigError
        If the traffic takes no adversaries, or the ego cannot be driven so from outside.
    """
    fork = env.fork()
    native = fork.worlds.native
    if not native.begun(0):
        raise ResetNeededError("branch: the environment was never reset")
    if adversaries is not None:
        if not native.planners:
            raise ConfigError(
                f"adversaries: traffic is {fork.config.traffic!r}, expected one that plans, as "
                "'ccdiff'"
            )
        ids = fork.scene.agent_ids
        native.override_plan(0, guided=[ids.index(one) for one in adversaries], criticality=None)
    act = _taken_over(fork, ego)
    recorder = Recorder(fork, planner=str(ego), source_step=native.status(0).elapsed_steps)
    recorder.start()
    done, count = False, 0
    while not done and (steps is None or count < steps):
        action = act(fork.worlds.observation(0))[0]
        if fork.action_space.shape == ():
            action = np.int64(np.ravel(action)[0])
        _, _, terminated, truncated, _ = fork.step(action)
        recorder.step()
        done, count = terminated or truncated, count + 1
    return recorder.rollout()


def _taken_over(env: EgoEnv, ego: Ego) -> Act:
    """Put somebody into the ego's seat; returns the function that makes its actions."""
    driver, act = ego_driver(ego)
    if act is not None:
        if env.config.driver != "external":
            raise ConfigError(f"ego: driver is {env.config.driver!r}, expected 'external'")
        act.begin(env.worlds)
        return act
    if driver == "replay" and env.config.driver == "external":
        return lambda _: env.worlds.native.expert_actions(0)
    if driver != env.config.driver:
        agent = env.worlds.native.slot_agents(0)[0]
        env.worlds.native.assign(0, [] if agent is None else [agent], driver)
    nothing = np.zeros((1, *(env.action_space.shape or ())), np.float32)
    return lambda _: nothing.astype(np.int64) if env.action_space.shape == () else nothing


class Steering:
    """Turns an acceleration and a distance from the route into normalised actions.

    Parameters
    ----------
    worlds
        Worlds whose first slot is steered, with continuous actions of the unicycle or bicycle.

    Raises
    ------
    ConfigError
        For indices of a grid, and for the delta-pose model.
    """

    def __init__(self, worlds: Worlds) -> None:
        action: ActionConfig = worlds.config.action
        if action.discrete or isinstance(action.dynamics, (AssistedLimits, DeltaPoseLimits)):
            raise ConfigError(
                "actions: plans of the ego need continuous actions of the unicycle or bicycle"
            )
        self._worlds = worlds
        self._action = action
        self._routes: dict[int, F32] = {}

    def _route(self, world_idx: int) -> F32:
        if world_idx not in self._routes:
            route = self._worlds.native.route(world_idx, 0)
            if route is None:
                raise ConfigError("plans of the ego: the slot is empty")
            self._routes[world_idx] = route[0]
        return self._routes[world_idx]

    def action(
        self, world_idx: int, states: Any, ego: int, acceleration_mps2: float, offset_m: float
    ) -> F32:
        """Return the action [W] that steers towards the shifted route ahead (pure pursuit)."""
        route = self._route(world_idx)
        at, heading = states["position"][ego], float(states["heading"][ego])
        speed = float(states["speed"][ego])
        reach = max(4.0, 0.8 * speed)
        nearest = int(np.argmin(((route - at) ** 2).sum(axis=1)))
        beyond = np.linalg.norm(route[nearest:] - route[nearest], axis=1) >= reach
        target = nearest + (int(np.argmax(beyond)) if beyond.any() else len(beyond) - 1)
        before = route[max(target - 1, 0)]
        way = route[target] - before if target > 0 else route[min(1, len(route) - 1)] - route[0]
        way = way / max(float(np.linalg.norm(way)), 1e-6)
        goal = route[target] + offset_m * np.array([-way[1], way[0]])
        dx, dy = goal - at
        angle = np.arctan2(dy, dx) - heading
        angle = float(np.arctan2(np.sin(angle), np.cos(angle)))
        curvature = 2.0 * np.sin(angle) / max(float(np.hypot(dx, dy)), 1.0)
        limits = self._action
        limit = (
            limits.max_acceleration_mps2 if acceleration_mps2 > 0 else limits.max_deceleration_mps2
        )
        if isinstance(limits.dynamics, BicycleLimits):
            length = float(
                self._worlds.scenes[self._worlds.native.status(world_idx).scene_idx].sizes[ego, 0]
            )
            wheel = np.arctan(curvature * limits.dynamics.wheelbase_share * length)
            turn = wheel / limits.max_steering_rad
        else:
            turn = curvature * speed / limits.max_yaw_rate_radps
        return np.clip(np.array([acceleration_mps2 / limit, turn]), -1.0, 1.0).astype(np.float32)


def ego_plans(num_samples: int, seed: int = 0) -> list[EgoPlan]:
    """Return plans to try, least aggressive first.

    The first 45 brake or accelerate evenly, or brake and go on, each on the route and up to 2.5 m
    beside it; the rest is drawn at random.

    Parameters
    ----------
    num_samples
        Plans to return.
    seed
        For the random ones.
    """
    offsets = (0.0, 1.0, -1.0, 2.5, -2.5)
    accelerations = (0.0, -1.5, -3.0, -5.0, -8.0, 1.5, 3.0)
    plans = [EgoPlan((a, a), 0.0, d) for d in offsets for a in accelerations]
    plans += [EgoPlan((first, 2.0), 1.5, d) for d in offsets for first in (-8.0, -4.0)]
    rng = np.random.default_rng(seed)
    while len(plans) < num_samples:
        first, second = rng.uniform(-8.0, 4.0, 2)
        switch, offset = rng.uniform(0.3, 2.5), rng.uniform(-4.0, 4.0)
        plans.append(EgoPlan((float(first), float(second)), float(switch), float(offset)))
    return plans[:num_samples]


def avoidability(
    env: EgoEnv,
    *,
    num_samples: int = 128,
    horizon_s: float | None = None,
    stay_on_road: bool = True,
    seed: int = 0,
    batch: int = 32,
) -> Avoidability:
    """Search for an ego plan that stays free of collisions from the present moment on.

    A found plan proves that a collision is avoidable; none found means that it is not avoidable by
    the plans tried.

    Parameters
    ----------
    env
        An environment in the middle of an episode, with continuous actions and an ego driven from
        outside; it is not changed.
    num_samples
        Plans to try at most.
    horizon_s
        How far plans are followed; to the end of the episode by default.
    stay_on_road
        Whether a plan must not leave the road either.
    seed
        For the plans.
    batch
        Plans that are tried together.

    Raises
    ------
    ResetNeededError
        Before the first reset.
    ConfigError
        If the ego takes no continuous actions from outside.
    """
    config = env.config
    if config.driver != "external":
        raise ConfigError(f"avoidability: driver is {config.driver!r}, expected 'external'")
    if not env.worlds.native.begun(0):
        raise ResetNeededError("avoidability: the environment was never reset")
    start = Snapshot.from_bytes(env.snapshot()).world
    plans = ego_plans(num_samples, seed)
    left = config.horizon_steps - env.worlds.native.status(0).elapsed_steps
    steps = left if horizon_s is None else min(round(horizon_s / config.dt_s), left)
    tried = 0
    for first in range(0, len(plans), batch):
        some = plans[first : first + batch]
        safe = _try(env, start, some, steps, stay_on_road)
        tried += len(some)
        if safe.any():
            return Avoidability(True, some[int(np.argmax(safe))], tried, int(safe.sum()))
    return Avoidability(False, None, tried, 0)


def _try(
    env: EgoEnv, start: bytes, plans: list[EgoPlan], steps: int, stay_on_road: bool
) -> npt.NDArray[np.bool_]:
    """Whether each plan stays free of collisions; all run at once, from the same moment."""
    config = env.config.with_options(decision_steps=1)
    worlds = Worlds(env.worlds.scenes, config, num_worlds=len(plans), num_threads=1)
    for i in range(len(plans)):
        worlds.native.restore(i, start)
    steering = Steering(worlds)
    ego = int(worlds.native.slot_agents(0)[0] or 0)
    names = worlds.column_names
    collision, off_road = names.index("collision"), names.index("off_road")
    safe = np.ones(len(plans), np.bool_)
    running = np.ones(len(plans), np.bool_)
    out = worlds.arrays()
    actions = np.zeros((len(plans), 1, worlds.native.action_width), np.float32)
    for t in range(steps):
        if not running.any():
            break
        seconds = t * env.config.dt_s
        for i in np.flatnonzero(running):
            plan = plans[i]
            acceleration = plan.acceleration_mps2[int(seconds >= plan.switch_s)]
            states = worlds.native.states(int(i))
            actions[i, 0, :2] = steering.action(int(i), states, ego, acceleration, plan.offset_m)
        worlds.native.step(actions, out, running)
        hit = out.columns[:, 0, collision] > 0
        if stay_on_road:
            hit = hit | (out.columns[:, 0, off_road] > 0)
        safe &= ~hit
        running &= ~hit & ~out.done
    return safe


def rollout_avoidability(
    rollout: Rollout, *, before_s: float = 3.0, after_s: float = 2.0, **options: Any
) -> Avoidability | None:
    """Ask whether a recorded ego's first collision was avoidable, the others doing as recorded.

    Parameters
    ----------
    rollout
        A recorded episode.
    before_s
        How long before the collision the ego may begin to do otherwise.
    after_s
        How long after the recorded collision plans are followed. Where the recording ends
        earlier, the others go on at constant velocity.
    **options
        As for :func:`avoidability`.

    Returns
    -------
    Avoidability or None
        ``None`` if the ego does not collide.
    """
    hits = rollout.collisions("ego")
    if not hits:
        return None
    scene = rollout.to_scene()
    history = rollout.start_step
    start = max(hits[0].step - round(before_s / rollout.dt_s), 0)
    end = hits[0].step + max(round(after_s / rollout.dt_s), 1)
    config = WorldConfig(
        dt_s=rollout.dt_s,
        history_steps=history,
        horizon_steps=end - start,
        terminate_at_goal=False,
    )
    env = EgoEnv(scenes=[_cut(scene, start, history + end + 2)], config=config)
    env.reset(seed=0)
    return avoidability(env, **options)


def _cut(scene: Scene, first: int, num_steps: int) -> Scene:
    """Scene whose log begins at a later step and goes on, at constant velocity, up to a number."""
    tracks = scene.tracks()
    more = max(num_steps - scene.num_steps, 0)
    ahead = (np.arange(1, more + 1) * scene.dt).astype(np.float32)
    last = {name: array[:, -1:] for name, array in dict[str, Any](tracks).items()}
    on = {name: np.repeat(array, more, axis=1) for name, array in last.items()}
    on["position"] = last["position"] + last["velocity"] * ahead[None, :, None]
    full = {
        name: np.ascontiguousarray(np.concatenate([array, on[name]], axis=1)[:, first:])
        for name, array in dict[str, Any](tracks).items()
    }
    return with_tracks(scene, full, np.flatnonzero(full["valid"].any(axis=1)))


def attribute(
    env: EgoEnv, *, ego: Ego, reference: Ego = "idm", steps: int | None = None
) -> Attribution:
    """Ask who a collision of the ego comes from, from the present moment of an environment on.

    Parameters
    ----------
    env
        An environment in CCDiff traffic in the middle of an episode; it is not changed.
    ego
        Who drives the ego as things are.
    reference
        Who drives it instead.
    steps
        Steps to look ahead at most.

    Raises
    ------
    ConfigError
        If the traffic takes no adversaries.
    """
    factual = branch(env, ego=ego, steps=steps)
    calm = branch(env, ego=ego, adversaries=(), steps=steps)
    careful = branch(env, ego=reference, steps=steps)
    hits = [bool(rollout.collisions("ego")) for rollout in (factual, calm, careful)]
    cause: Cause
    if not hits[0]:
        cause = "none"
    elif hits[1]:
        cause = "both" if hits[2] else "ego"
    else:
        cause = "adversaries" if hits[2] else "either"
    return Attribution(hits[0], hits[1], hits[2], cause, (factual, calm, careful))
