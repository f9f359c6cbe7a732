"""What would have happened: other egos, other adversaries, and whether a collision was avoidable.

All questions are asked of forks of a running environment or of a recorded rollout; neither changes.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, ResetNeededError
from ccdiff_env.planners.built_in import Ego, ego_driver
from ccdiff_env.planners.planning import Steering
from ccdiff_env.record.episode import begin, play
from ccdiff_env.record.recorder import HasWorlds, Recorder, worlds_of
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet, with_tracks
from ccdiff_env.system.fields import documented
from ccdiff_env.worlds import Worlds, normalize_seed
from ccdiff_env.worlds.snapshot import Snapshot

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Cause: TypeAlias = Literal["none", "adversaries", "ego", "either", "both"]


@documented
@dataclass(frozen=True)
class EgoPlan:
    """A way to drive on: two accelerations one after the other, along a shifted route."""

    acceleration_mps2: tuple[float, float]  #: At first, and after ``switch_s``.
    switch_s: float  #: Seconds until the second one.
    offset_m: float  #: Distance from the route to drive at, left positive.

    @property
    def words(self) -> str:
        """What the plan is, as ``"brake at 1.5 m/s²"``."""
        first, second = self.acceleration_mps2
        text = _pedal(first)
        if self.switch_s > 0.0 and second != first:
            text += f" for {self.switch_s:.1f} s, then {_pedal(second)}"
        if self.offset_m:
            side = "left" if self.offset_m > 0.0 else "right"
            text += f", {abs(self.offset_m):.1f} m to the {side}"
        return text


def _pedal(acceleration_mps2: float) -> str:
    if acceleration_mps2 == 0.0:
        return "hold the speed"
    what = "brake" if acceleration_mps2 < 0.0 else "accelerate"
    return f"{what} at {abs(acceleration_mps2):.1f} m/s²"


BATCH = 32  #: Plans that are tried together.
HOLD_S = 2.1  #: How long a steady plan lasts.
BEFORE_S = 3.0  #: How long before a collision the ego may begin to do otherwise.
#: Steady plans, least aggressive first.
STEADY = tuple(EgoPlan((a, a), 0.0, d) for d in (0, 0.75, -0.75) for a in (0, -2, 2, -4, -6))


@documented
@dataclass(frozen=True)
class Avoidability:
    """Whether some ego plan avoids every collision.

    The search stops after the batch of plans in which one was found.
    """

    avoidable: bool  #: Whether one of the plans tried does.
    plan: EgoPlan | None  #: The first of them, least aggressive first.
    num_tried: int  #: Plans tried.
    num_safe: int  #: Plans among them that avoid all collisions.
    #: With ``reactive=True``, share of futures that did not choose the plan in which it avoids all
    #: collisions, 0 without a plan.
    held: float | None = None
    #: With ``reactive=True``, share of these futures in which the ego without a plan does.
    unchanged: float | None = None


@documented
@dataclass(frozen=True)
class Attribution:
    """Who a collision of the ego comes from, by taking one cause away at a time."""

    collided: bool  #: Whether the ego collides as things are.
    without_adversaries: bool  #: Whether it collides when nobody is guided against it.
    with_reference: bool  #: Whether it collides when a reference planner drives it.
    #: ``"none"``: no collision; ``"adversaries"`` or ``"ego"``: it disappears without that one
    #: only; ``"either"``: without any one of the two; ``"both"``: it stays in either case.
    cause: Cause
    #: What happened in the three cases, in the order above.
    rollouts: tuple[Rollout, Rollout, Rollout]


def branch(
    env: HasWorlds | Worlds,
    *,
    ego: Ego,
    adversaries: Sequence[str] | None = None,
    steps: int | None = None,
    seed: int | None = None,
) -> Rollout:
    """Play a fork of an environment on, to the end or for some steps.

    Args:
        env: An environment in the middle of an episode; it is not changed.
        ego: Who drives the ego from here on, as :func:`~ccdiff_env.planners.built_in.ego_driver`
            takes it; ``"replay"`` steers back to the log.
        adversaries: Ids of the vehicles to guide against the ego in CCDiff traffic; ``()`` for
            nobody, ``None`` to leave it as it is.
        steps: Steps at most.
        seed: Seed of what traffic draws from here on; by default it draws what it would have drawn.

    Returns:
        Rollout: From the present state on.

    Raises:
        ResetNeededError: Before the first reset.
        ConfigError: If the traffic takes no adversaries, or the ego cannot be driven so from
            outside.
    """
    worlds = worlds_of(env)
    if not worlds.native.begun(0):
        raise ResetNeededError("branch: the environment was never reset")
    fork = _fork(worlds, [seed])
    native = fork.native
    if adversaries is not None:
        fork.config.guided_traffic("adversaries")
        ids = fork.scenes[native.status(0).scene_idx].agent_ids
        native.override_plan(0, guided=[ids.index(one) for one in adversaries], criticality=None)
    act = _take_over(fork, ego)
    recorder = Recorder(fork, planner=str(ego), source_step=native.status(0).elapsed_steps)
    for _ in play(fork, act, recorders={0: recorder}, most=steps):
        pass
    return recorder.rollout()


def _fork(worlds: Worlds, seeds: Sequence[int | None], **options: Any) -> Worlds:
    """Return new worlds in the state of the first one of ``worlds``, one for each seed."""
    config = worlds.config.with_options(**options)
    fork = Worlds(worlds.scenes, config, num_worlds=len(seeds), num_threads=1)
    state = Snapshot.of(worlds, 0)
    for i, seed in enumerate(seeds):
        state.put(fork, i, seed)
    return fork


def _take_over(worlds: Worlds, ego: Ego) -> Callable[..., npt.NDArray[Any]] | None:
    """Put somebody into the ego's seat; returns what makes its actions, if not the world does."""
    driver, seat = ego_driver(ego)
    at_present = worlds.config.driver
    if seat is not None:
        if at_present != "external":
            raise ConfigError(f"ego: driver is {at_present!r}, expected 'external'")
        seat.begin(worlds)
        return seat
    if driver == "replay" and at_present == "external":
        return lambda *_: worlds.native.expert_actions(0)
    if driver != at_present:
        agent = worlds.native.slot_agents(0)[0]
        worlds.native.assign(0, [] if agent is None else [agent], driver)
    return None


def ego_plans(num_samples: int, seed: int = 0) -> list[EgoPlan]:
    """Return plans to try, least aggressive first.

    The first 45 brake or accelerate evenly, or brake and go on, each on the route and up to 2.5 m
    beside it; the rest is drawn at random.

    Args:
        num_samples: Plans to return, at least 1.
        seed: For the random ones.
    """
    if type(num_samples) is not int or num_samples < 1:
        raise ConfigError(f"num_samples is {num_samples!r}, expected an integer of at least 1")
    accelerations, offsets = json.loads(_native.schema("steady_plans"))
    plans = [EgoPlan((a, a), 0.0, d) for d in offsets for a in accelerations]
    plans += [EgoPlan((first, 2.0), 1.5, d) for d in offsets for first in (-8.0, -4.0)]
    rng = np.random.default_rng(normalize_seed(seed))
    while len(plans) < num_samples:
        first, second = rng.uniform(-8.0, 4.0, 2)
        switch, offset = rng.uniform(0.3, 2.5), rng.uniform(-4.0, 4.0)
        plans.append(EgoPlan((float(first), float(second)), float(switch), float(offset)))
    return plans[:num_samples]


def avoidability(
    env: HasWorlds | Worlds,
    *,
    num_samples: int = 128,
    seed: int = 0,
    reactive: bool = False,
    ego: Ego = "idm",
    draws: int = 2,
) -> Avoidability:
    """Search for an ego plan that stays on the road and free of collisions to the episode's end.

    A found plan proves that a collision is avoidable; none found means that it is not avoidable by
    the plans tried. Plans know what traffic will draw: some avoid a collision by luck.
    ``reactive=True`` asks for more: the least aggressive of 15 steady plans that avoids all
    collisions in ``draws`` futures is tested in as many others.

    Args:
        env: An environment in the middle of an episode, with continuous actions and an ego driven
            from outside; it is not changed.
        num_samples: Plans to try at most.
        seed: For the plans.
        reactive: Whether plans are steady, last 2.1 s and must hold in other futures.
        ego: Who drives after such a plan, as :func:`~ccdiff_env.planners.built_in.ego_driver` takes
            it.
        draws: Futures that choose among these plans: the present draw of traffic, and others.

    Raises:
        ResetNeededError: Before the first reset.
        ConfigError: If the ego takes no continuous actions from outside, or traffic that shall
            react does not.
    """
    worlds = worlds_of(env)
    config = worlds.config
    if config.driver != "external":
        raise ConfigError(f"avoidability: driver is {config.driver!r}, expected 'external'")
    if not worlds.native.begun(0):
        raise ResetNeededError("avoidability: the environment was never reset")
    if not reactive:
        plans, tried = ego_plans(num_samples, seed), 0
        for first in range(0, len(plans), BATCH):
            some = plans[first : first + BATCH]
            safe = _try(worlds, some)
            tried += len(some)
            if safe.any():
                return Avoidability(True, some[int(np.argmax(safe))], tried, int(safe.sum()))
        return Avoidability(False, None, tried, 0)
    if ego == "replay":
        raise ConfigError("ego is 'replay', expected one that can drive from off the log")
    if config.traffic in ("replay", "constant_velocity"):
        raise ConfigError(
            f"avoidability: traffic is {config.traffic!r}, expected one that reacts, as 'idm' or "
            "'ccdiff'"
        )
    if type(draws) is not int or draws < 1:
        raise ConfigError(f"draws is {draws!r}, expected an integer of at least 1")
    drawn = np.random.SeedSequence(normalize_seed(seed)).generate_state(2 * draws - 1, np.uint64)
    futures = [None, *drawn.tolist()]

    def held(some: Sequence[EgoPlan | None], seeds: Sequence[int | None]) -> Bool:
        """Whether plans are safe in futures [P, F]."""
        pairs = [(plan, one) for plan in some for one in seeds]
        tried = _try(worlds, [p for p, _ in pairs], [s for _, s in pairs], ego)
        return tried.reshape(len(some), len(seeds))

    steady = STEADY[:num_samples]
    good = held(steady, futures[:draws]).all(axis=1)
    plan = steady[int(np.argmax(good))] if good.any() else None
    unchanged, share = held([None, plan], futures[draws:]).mean(axis=1).tolist()
    found = plan is not None, plan, len(steady), int(good.sum())
    return Avoidability(*found, share if plan else 0.0, unchanged)


def _try(
    origin: Worlds,
    plans: Sequence[EgoPlan | None],
    seeds: Sequence[int | None] | None = None,
    then: Ego | None = None,
) -> Bool:
    """Whether each plan stays free of collisions, and on the road; all run at once, from here on.

    With ``then``, that one drives after ``HOLD_S``, and where there is no plan.
    """
    return _driven(_fork(origin, seeds or [None] * len(plans), decision_steps=1), plans, then)


def _driven(
    worlds: Worlds,
    plans: Sequence[EgoPlan | None],
    then: Ego | None = None,
    recorders: Mapping[int, Recorder] = MappingProxyType({}),
) -> Bool:
    """Drive each of some worlds by a plan, see :func:`_try`."""
    native, steering = worlds.native, Steering(worlds)
    driver, seat = ("external", None) if then is None else ego_driver(then)
    if seat is not None:
        seat.begin(worlds)
    agent = int(native.slot_agents(0)[0] or 0)
    begun = native.status(0).elapsed_steps
    actions = np.zeros((len(plans), native.action_width), np.float32)
    left = np.zeros(len(plans), np.bool_)  # to the one who drives after the plans

    def act(obs: F32, running: Bool) -> F32:
        for i in np.flatnonzero(running & ~left).tolist():
            plan, status = plans[i], native.status(i)
            seconds = (status.elapsed_steps - begun) * worlds.config.dt_s
            if plan is None or (then is not None and seconds > HOLD_S - 1e-6):
                left[i] = True
                if driver != "external":
                    native.assign(i, [agent], driver)
                continue
            acceleration = plan.acceleration_mps2[int(seconds >= plan.switch_s)]
            actions[i, :2] = steering.action(
                i, native.states(i), agent, acceleration, plan.offset_m
            )
        if seat is not None and (left & running).any():
            actions[left] = seat(obs, left & running)[left]
        return actions

    columns = [worlds.column_names.index(name) for name in ("collision", "off_road")]
    safe = np.ones(len(plans), np.bool_)
    for step in play(worlds, act, recorders=recorders):
        hit = (step.out.columns[:, 0, columns] > 0).any(axis=1)
        safe &= ~hit
        step.running[hit] = False
    return safe


def rollout_avoidability(
    rollout: Rollout, *, before_s: float = BEFORE_S, **options: Any
) -> Avoidability | None:
    """Ask whether a recorded ego's first collision was avoidable, the others doing as recorded.

    Plans are followed for 2 s after the recorded collision. Where the recording ends earlier, the
    others go on at constant velocity.

    Args:
        rollout: A recorded episode.
        before_s: How long before the collision the ego may begin to do otherwise.
        **options: As for :func:`avoidability`.

    Returns:
        Avoidability or None: ``None`` if the ego does not collide.
    """
    found = _before_contact(rollout, before_s)
    return None if found is None else avoidability(found[0], **options)


def avoidable(rollout: Rollout) -> float:
    """Return whether the first collision of a recorded ego was avoidable, 1 or 0, as a metric of
    ``bench planners``; NaN if it does not collide.
    """
    found = rollout_avoidability(rollout)
    return float("nan") if found is None else float(found.avoidable)


def with_rescue(rollout: Rollout) -> Rollout:
    """Return a recorded episode that knows whether the ego's first collision was avoidable, for
    pages: ``meta["rescue"]`` has ``text`` in words and, if it was, ``step`` and the saving ``path``
    from it on, x, y (m) and heading (rad).
    """
    found = _before_contact(rollout, BEFORE_S)
    if found is None:
        return rollout
    worlds, start = found
    verdict = avoidability(worlds)
    rescue: dict[str, Any] = {"text": f"not avoidable by {verdict.num_tried} plans"}
    if verdict.plan is not None:
        recorder = Recorder(fork := _fork(worlds, [None], decision_steps=1))
        _driven(fork, [verdict.plan], recorders={0: recorder})
        saved = recorder.rollout()
        ego = saved.agent_ids.index("ego")
        poses = np.column_stack([saved.position[ego], saved.heading[ego]])[saved.valid[ego]]
        text = f"avoidable: {verdict.plan.words} from {start * rollout.dt_s:.1f} s"
        rescue = {"text": text, "step": start, "path": poses.round(3).tolist()}
    return dataclasses.replace(rollout, meta={**rollout.meta, "rescue": rescue})


def _before_contact(rollout: Rollout, before_s: float) -> tuple[Worlds, int] | None:
    """Worlds in which the others do as recorded, from some seconds before the ego's first collision
    to 2 s after it, and the recorded step at which they begin; ``None`` without a collision.
    """
    hits = rollout.collisions("ego")
    if not hits:
        return None
    scene = rollout.to_scene()
    history = rollout.start_step
    start = max(hits[0].step - round(before_s / rollout.dt_s), 0)
    end = hits[0].step + max(round(2.0 / rollout.dt_s), 1)
    config = WorldConfig().with_options(
        dt_s=rollout.dt_s,
        history_steps=history,
        horizon_steps=end - start,
        terminate_at_goal=False,
        autoreset="disabled",
    )
    return begin(SceneSet([_cut(scene, start, history + end + 2)]), config, 0), start


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
    return with_tracks(scene, full, np.flatnonzero(full["valid"].any(axis=1)), first=first)


def attribute(
    env: HasWorlds | Worlds, *, ego: Ego, reference: Ego = "idm", steps: int | None = None
) -> Attribution:
    """Ask who a collision of the ego comes from, from the present moment of an environment on.

    Args:
        env: An environment in CCDiff traffic in the middle of an episode; it is not changed.
        ego: Who drives the ego as things are.
        reference: Who drives it instead.
        steps: Steps to look ahead at most.

    Raises:
        ConfigError: If the traffic takes no adversaries.
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
