"""Recording of running worlds as rollouts."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import ConfigError, ResetNeededError
from ccdiff_env.record.rollout import Intention, Rollout, RolloutEvent
from ccdiff_env.scenes import with_tracks
from ccdiff_env.traffic import TrafficPlan

if TYPE_CHECKING:
    from ccdiff_env.worlds import Worlds

_STATES = ("position", "heading", "velocity", "active", "elevation_m")
_CONTACT = ("collision_kind", "collision_partner", "at_fault")  #: Columns.


class HasWorlds(Protocol):
    """An environment on native worlds."""

    @property
    def worlds(self) -> Worlds:
        """The native worlds."""


def worlds_of(env: HasWorlds | Worlds) -> Worlds:
    """Return the worlds of an environment, of a wrapper of one, or worlds by themselves."""
    unwrapped: Any = getattr(env, "unwrapped", env)
    worlds: Worlds = getattr(unwrapped, "worlds", unwrapped)
    return worlds


def _in_words(traffic: str | Mapping[str, float]) -> str:
    """Traffic as one text: the name, or shares in percent."""
    if isinstance(traffic, str):
        return traffic
    return " + ".join(f"{share:.0%} {name}" for name, share in traffic.items())


class Recorder:
    """Records one world of an environment.

    Made after a reset, it has started; before one, :meth:`start` comes after it. A step may be
    recorded twice. Environments of adversary selection call :meth:`step` themselves.

    Args:
        env: An environment of this package, a wrapper of one, or native worlds by themselves.
        world_idx: World to record.
        **meta: Entries of :attr:`Rollout.meta` beside seed, configuration, traffic and source, such
            as ``planner="idm"``.

    Raises:
        ConfigError: If the worlds hold actions for several steps.

    Notes:
        An ego that is drawn is ``"ego"`` in the recording, and ``meta["ego"]`` its id in the scene.

        In autoreset mode SAME_STEP the last state of an episode is never seen from outside, so that
        it is missing; NEXT_STEP and DISABLED show it.

    Examples:
        >>> import ccdiff_env
        >>> env = ccdiff_env.EgoEnv(traffic="idm", driver="idm")
        >>> _ = env.reset(seed=0)
        >>> recorder = Recorder(env, planner="idm")
        >>> done = False
        >>> while not done:
        ...     _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        ...     _ = recorder.step()
        ...     done = terminated or truncated
        >>> rollout = recorder.rollout()
    """

    def __init__(self, env: HasWorlds | Worlds, *, world_idx: int = 0, **meta: Any) -> None:
        unwrapped: Any = getattr(env, "unwrapped", env)
        self._worlds = worlds_of(env)
        self._worlds.check_world(world_idx)
        held = self._worlds.config.decision_steps
        if held != 1:
            raise ConfigError(f"recorder: decision_steps is {held}, expected 1: it records steps")
        self._world_idx = world_idx
        self._meta = meta
        self._episode: tuple[int, int, int] | None = None
        self._elapsed = 0
        steps_itself = getattr(unwrapped, "vector", unwrapped)
        if hasattr(steps_itself, "on_step"):
            steps_itself.on_step = self.step
        if self._worlds.native.begun(world_idx):
            self.start()

    def start(self) -> None:
        """Begin a recording at the present state, usually after a reset; drops the one before."""
        native, world = self._worlds.native, self._world_idx
        status = native.status(world)
        self._scene = self._worlds.scenes[status.scene_idx]
        self._drawn = {}
        if self._worlds.config.controlled == "any" and status.ego_idx is not None:
            self._drawn["ego"] = self._scene.agent_ids[status.ego_idx]
            self._scene = self._scene.with_ego(self._drawn["ego"])
        if self._worlds.config.randomization.size:
            sizes = self._scene.sizes.copy()
            for agent, drawn in zip(native.slot_agents(world), native.drawn(world), strict=True):
                if agent is not None:
                    sizes[agent, :2] *= np.float32(drawn["size"])
            self._scene = with_tracks(self._scene, self._scene.tracks(), sizes=sizes)
        self._episode = (status.scene_idx, status.seed, status.episode)
        self._elapsed, self._start_step = status.elapsed_steps, status.step_idx
        self._states: list[dict[str, Any]] = [{**native.states(world)}]
        self._columns: list[npt.NDArray[np.float32]] = []
        self._events: list[RolloutEvent] = []
        self._plans: list[TrafficPlan] = []
        self._intentions: list[Intention] = []
        self._kept: dict[str, int] = {}  #: Step of the newest plan of each driver that plans.
        self._ids = tuple(self._scene.agent_ids)
        self._types = self._scene.agent_types
        agents = native.slot_agents(world)
        ego = self._ids.index("ego") if "ego" in self._ids else None
        self._slot = agents.index(ego) if ego is not None and ego in agents else 0
        self._touching = {(i, j) for i, j, *_ in native.contacts(world)}
        self._off_road = native.off_road(world)[0].copy()
        self._drivers = native.drivers(world)
        self._seed = status.seed
        self._start_elapsed = status.elapsed_steps

    def intend(self, trajectories: npt.NDArray[np.float32], costs: npt.NDArray[np.float32]) -> None:
        """Record what the ego's planner means to do from the present step on, before it is taken:
        see :class:`~ccdiff_env.record.rollout.Intention`.
        """
        if self._episode is not None:
            at = self._elapsed - self._start_elapsed
            self._intentions.append(Intention(at, trajectories, costs))

    def step(self) -> bool:
        """Record the state after a step; returns whether the world still plays the same episode.

        Once the world has begun another episode, nothing more is recorded.

        Raises:
            ResetNeededError: Before :meth:`start`, and where a step was left out.
        """
        if self._episode is None:
            raise ResetNeededError("recorder: step before start(), which comes after a reset")
        native, world = self._worlds.native, self._world_idx
        status = native.status(world)
        elapsed, episode = status.elapsed_steps, (status.scene_idx, status.seed, status.episode)
        if episode != self._episode or elapsed < self._elapsed:
            return False
        if elapsed == self._elapsed:
            return True
        if elapsed > self._elapsed + 1:
            raise ResetNeededError(
                f"recorder: step {elapsed} comes after {self._elapsed}: call its step() after each "
                "of the environment, or start()"
            )
        self._elapsed = elapsed
        at = status.step_idx - self._start_step
        if self._worlds.last is not None:
            self._columns.append(self._worlds.last.columns[world, self._slot].copy())
        self._drivers = native.drivers(world)
        for driver in native.planners:
            self._keep_plan(driver)
        self._contact_events(at)
        self._road_events(at)
        self._end_events(at)
        self._states.append({**native.states(world)})
        return True

    def _keep_plan(self, driver: str) -> None:
        plan = self._worlds.explain(self._world_idx, driver)
        if plan is None:
            return
        step = plan.made_at - self._start_elapsed
        if self._kept.get(driver) == step:
            return
        self._kept[driver] = step
        self._plans.append(dataclasses.replace(plan, made_at=step, moment=None))

    def _contact_events(self, at: int) -> None:
        touching = set()
        for i, j, side, _, at_fault in self._worlds.native.contacts(self._world_idx):
            touching.add((i, j))
            if (i, j) in self._touching:
                continue
            kind = "static" if self._types[j] == "static" else f"collision_{side}"
            self._events.append(RolloutEvent(at, self._ids[i], self._ids[j], kind, at_fault))
        for i, j, side, at_fault in self._told_contacts():
            if not touching & {(i, j), (j, i)}:  # who is removed by a contact touches nobody now
                touching |= {(i, j), (j, i)}
                kind = "static" if self._types[j] == "static" else f"collision_{side}"
                self._events.append(RolloutEvent(at, self._ids[i], self._ids[j], kind, at_fault))
        self._touching = touching

    def _told_contacts(self) -> Iterator[tuple[int, int, str, bool]]:
        """Contacts that the columns of the step tell: agent, partner, side, whether at fault."""
        if self._worlds.last is None:
            return
        at = [self._worlds.column_names.index(name) for name in _CONTACT]
        rows = self._worlds.last.columns[self._world_idx][:, at].astype(int).tolist()
        agents = self._worlds.native.slot_agents(self._world_idx)
        for agent, (side, partner, at_fault) in zip(agents, rows, strict=True):
            if agent is not None and partner > 0:
                yield agent, partner - 1, ("front", "rear", "side")[side - 1], at_fault > 0

    def _road_events(self, at: int) -> None:
        off_road = self._worlds.native.off_road(self._world_idx)[0]
        for i in np.flatnonzero(off_road & ~self._off_road):
            if self._types[i] == "vehicle":
                self._events.append(RolloutEvent(at, self._ids[i], None, "off_road"))
        self._off_road = off_road.copy()

    def _end_events(self, at: int) -> None:
        agent = self._worlds.native.slot_agents(self._world_idx)[self._slot]
        if not self._columns or agent is None:
            return
        names = self._worlds.column_names
        for kind, column in (("goal", "goal_reached"), ("time_limit", "time_limit")):
            if self._columns[-1][names.index(column)] > 0.5:
                self._events.append(RolloutEvent(at, self._ids[agent], None, kind))

    def rollout(self) -> Rollout:
        """Return what was recorded so far.

        Raises:
            ResetNeededError: Before :meth:`start`, or if no step has been recorded since.
        """
        if self._episode is None:
            raise ResetNeededError("recorder: rollout before start")
        if not self._columns:
            raise ResetNeededError(
                "recorder: no step is recorded; call its step() after each of the environment"
            )
        stacked: dict[str, Any] = {
            name: np.stack([s[name] for s in self._states], axis=1)
            for name in _STATES
            if name in self._states[0]
        }
        columns = np.array(self._columns, np.float32).reshape(len(self._states) - 1, -1)
        names = self._worlds.column_names if columns.size else ()
        config = self._worlds.config
        table = (("external", "external"), *self._worlds.native.driver_table)
        if "towed" in self._drivers:
            table += (("towed", "towed"),)
        drivers = [name for name, _ in table]
        return Rollout(
            scene=self._scene,
            start_step=self._start_step,
            dt_s=config.dt_s,
            agent_ids=self._ids,
            valid=stacked.pop("active"),
            **stacked,
            drivers=np.array([drivers.index(name) for name in self._drivers], np.int64),
            driver_table=table,
            events=tuple(self._events),
            info={name: columns[:, i].copy() for i, name in enumerate(names)},
            plans=tuple(self._plans),
            intentions=tuple(self._intentions),
            meta={
                "seed": self._seed,
                "config": json.loads(config.to_json()),
                "traffic": _in_words(config.traffic),
                "source": self._scene.source,
                **self._drawn,
                **self._meta,
            },
        )
