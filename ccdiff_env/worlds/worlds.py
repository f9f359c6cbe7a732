"""The native worlds with their scenes, schemas and arrays: what every environment class sits on."""

from __future__ import annotations

import json
import operator
import os
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from ccdiff_env import _native
from ccdiff_env.config import EgosConfig, WorldConfig
from ccdiff_env.errors import (
    ActionError,
    ConfigError,
    ShapeError,
    UnknownNameError,
    hint_of,
)
from ccdiff_env.models import needs_torch, require_networks, weights_path
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.traffic import EGOS, KINDS, PythonTraffic, TrafficPlan
from ccdiff_env.traffic.options import Autoreset
from ccdiff_env.traffic.python import BoundTraffic
from ccdiff_env.worlds.configured import SceneChoice
from ccdiff_env.worlds.curriculum import Criticality, Curriculum
from ccdiff_env.worlds.fit import Fit
from ccdiff_env.worlds.policy_file import adversary_policy_path, egos_parts
from ccdiff_env.worlds.spaces import F32, U8, Form, Layout, StepArrays, read_columns

PARALLEL_FROM = 64  #: Batches from here on use all processors by default.


def _hander(config: WorldConfig, scenes: SceneSet) -> Callable[[str, str, str, int], object]:
    """Return what hands native worlds what a driver of a configuration is made of: a model of the
    user's own, the parts of an ego, a file of weights and options, or a network of torch.

    It raises :class:`MissingFeatureError` where a network needs torch, :class:`UnknownNameError`
    where no scene has an agent that contacts shall be aimed at, and errors that name settings that
    do not fit.
    """

    def hand(name: str, kind: str, options: str, num_threads: int) -> object:
        if KINDS[kind].options is PythonTraffic:
            own: Any = config.named_drivers[name].options
            return BoundTraffic(name, own, scenes, config.dt_s)
        settings = json.loads(options)
        if kind == EGOS:
            return egos_parts(EgosConfig(**settings), config.dt_s)
        if targets := set(settings.get("targets", ())):
            for nobody in sorted(targets.difference(*(scene.agent_ids for scene in scenes))):
                raise UnknownNameError(f"{name}.targets: no scene has an agent {nobody!r}")
        weights = weights_path(
            settings["weights"], kind, settings["denoising_steps"], settings["follow_route"]
        )
        if settings.get("adversary_policy") is not None:
            policy = adversary_policy_path(settings["adversary_policy"])
            options = json.dumps({**settings, "adversary_policy": str(policy)})
        if not needs_torch(weights, settings["device"]):
            return weights, options
        require_networks()
        from ccdiff_env import _models

        return _models.network_driver(
            name, kind, options, weights, config.dt_s, num_threads, list(scenes)
        )

    return hand


def _vehicles(scene: Scene) -> dict[str, int]:
    """Return the indices of the vehicles of a scene by id."""
    who = enumerate(zip(scene.agent_ids, scene.agent_types, strict=True))
    return {agent: place for place, (agent, kind) in who if kind == "vehicle"}


def _integer(name: str, value: Any, expected: str) -> int:
    if isinstance(value, (bool, np.bool_)) or not hasattr(value, "__index__"):
        raise ConfigError(f"{name} is {value!r}, expected {expected}")
    return operator.index(value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, (int, float, np.number)) and np.isfinite(value):
        return float(value)
    raise ConfigError(f"{name} is {value!r}, expected a number")


class Worlds:
    """E native worlds over scenes.

    Args:
        scenes: The scenes.
        config: Their configuration.
        num_worlds: E.
        num_threads: Worker threads; ``None``: all processors for many worlds, else the calling
            thread. Results do not depend on it.
        criticality: Criticality of planned traffic by episode, see
            :class:`~ccdiff_env.worlds.curriculum.Curriculum`; ``None``: as configured.
    """

    def __init__(
        self,
        scenes: SceneSet,
        config: WorldConfig,
        *,
        num_worlds: int,
        num_threads: int | None = None,
        criticality: Criticality | None = None,
    ) -> None:
        for name, count in (("num_envs", num_worlds), ("num_threads", num_threads)):
            if count is not None and (type(count) is not int or not 1 <= count < 2**63):
                raise ConfigError(f"{name} is {count!r}, expected an integer of at least 1")
        if num_threads is None:
            may_use = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
            num_threads = len(may_use(0)) if num_worlds >= PARALLEL_FROM else 1
        config.check_networks()
        self.scenes = scenes
        self.config = config
        self.num_worlds = num_worlds
        self._num_threads = num_threads
        self.native = self._made()
        found = {one.criticality for one in config.networks_in_traffic()}
        #: That of all networks of the traffic, where it is one.
        self.configured_criticality = found.pop() if len(found) == 1 else None
        self.curriculum: Curriculum | None = None
        if criticality is not None:
            self.set_criticality(criticality)
        #: Drivers by id that the present episode of a world was given at its reset.
        self.drivers: dict[int, dict[str, str]] = {}
        self._vehicle_ids: frozenset[str] = frozenset()
        #: Criticality that the present episode of a world was given by the curriculum.
        self.criticality: dict[int, float] = {}
        #: What is known of the present episode of a world: its scene, seed, start and so on.
        self.episodes: dict[int, dict[str, Any]] = {}
        self.num_slots = config.num_slots
        self.layout = Layout.from_json(self.native.layout_json)
        self.columns = read_columns(_native.schema("columns"))
        self.column_names = tuple(column.name for column in self.columns)
        self.metrics = read_columns(_native.schema("metrics"))
        self.metric_names = tuple(metric.name for metric in self.metrics)
        self.discrete = self.native.num_actions is not None
        #: Shape of an agent's action.
        self.action_shape = () if self.discrete else (self.native.action_width,)
        self._width = self.native.action_width
        self._arrays = self.native.step_arrays()
        self._index = {scene.name: i for i, scene in enumerate(scenes)}
        self.last: StepArrays | None = None  #: Arrays of the newest reset or step.
        #: Weights by which scenes are drawn, where there are any.
        self.scene_weights: list[float] | None = None

    def _made(self) -> _native.VecWorld:
        """Return native worlds that have not begun."""
        return _native.VecWorld(
            list(self.scenes),
            self.config.to_json(),
            self.num_worlds,
            self._num_threads,
            _hander(self.config, self.scenes),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle holds: snapshots in place of the native worlds."""
        taken = [self.native.snapshot(i) for i in range(self.num_worlds)]
        return {**vars(self), "native": taken}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the native worlds anew, in the states of the snapshots."""
        vars(self).update(state)
        self.native = self._made()
        self.native.set_scene_weights(self.scene_weights)
        for i, taken in enumerate(state["native"]):
            self.native.restore(i, taken)

    def set_autoreset(self, mode: Autoreset) -> None:
        """Choose when ended worlds restart, before the first reset."""
        config = self.config.with_options(autoreset=mode)
        self.native.set_autoreset(config.to_json())
        self.config, self._arrays = config, self.native.step_arrays()

    @property
    def action_space(self) -> gymnasium.Space[Any]:
        """Space of an agent's actions, a new one each time: wrappers may change it.

        Box(-1, 1, [W]) float32 of normalised actions, or Discrete for the indices of a grid.
        """
        if self.native.num_actions is not None:
            return spaces.Discrete(self.native.num_actions)
        return spaces.Box(-1.0, 1.0, (self._width,), np.float32)

    def observation_space(self, form: Form) -> gymnasium.Space[Any]:
        """Return the space of an agent's observations in a form; it says what they are made from.

        Policies carry it with them, see :mod:`ccdiff_env.worlds.fit`.
        """
        return Fit.of(self.config, self.native.layout_json, form).mark(self.layout.space(form))

    def arrays(self) -> StepArrays:
        """Return new arrays for a reset or step, and keep them as :attr:`last`."""
        made: dict[str, Any] = {
            name: np.empty(shape, dtype) if shape else None for name, dtype, shape in self._arrays
        }
        self.last = StepArrays(**made)
        return self.last

    def actions(self, actions: Any, shape: tuple[int, ...]) -> F32:
        """Check actions of a shape and return them as float32 [E, C, W].

        Raises:
            ShapeError: If the shape is another one.
            ActionError: If they are no numbers, or no integers where actions are indices.
        """
        if type(actions) is not np.ndarray or actions.dtype != np.float32 or self.discrete:
            try:
                given = np.asarray(actions)
            except (TypeError, ValueError) as error:
                raise ShapeError(f"actions: {error}, expected an array of shape {shape}") from None
            if given.dtype.kind not in ("iu" if self.discrete else "fiu"):
                kind = "integers" if self.discrete else "numbers"
                raise ActionError(f"actions have dtype {given.dtype}, expected {kind}")
            with np.errstate(over="ignore"):  # what overflows becomes infinite, and is refused
                actions = given.astype(np.float32)
        if actions.shape != shape:
            raise ShapeError(f"actions have shape {actions.shape}, expected {shape}")
        return np.ascontiguousarray(actions).reshape(self.num_worlds, self.num_slots, self._width)

    def scene_index(self, choice: SceneChoice) -> int | None:
        """Return the index of a scene given by name or index.

        Raises:
            UnknownNameError: If there is no such scene.
        """
        if choice is None:
            return None
        if isinstance(choice, str):
            if choice not in self._index:
                hint = hint_of(choice, self._index)
                raise UnknownNameError(f"no scene {choice!r} among {len(self._index)}: {hint}")
            return self._index[choice]
        index = _integer("scene", choice, "a name or an index")
        if not 0 <= index < len(self._index):
            raise UnknownNameError(f"no scene {index}, expected an index below {len(self._index)}")
        return index

    def wanted(
        self, scene_idx: int | None, ego: Any, start: Any, style: Any
    ) -> tuple[int | None, int | None, dict[str, float]]:
        """Return the ego (index), the step of the start and the style that a reset asks for.

        Raises:
            ConfigError: If no scene is named with ego or start, or a value is of another kind.
            UnknownNameError: If the scene has no such agent.
        """
        if style is not None and not isinstance(style, Mapping):
            raise ConfigError(f"style is {style!r}, expected values by name")
        style = {name: _number(f"style.{name}", factor) for name, factor in (style or {}).items()}
        if (ego is not None or start is not None) and scene_idx is None:
            raise ConfigError("options: ego and start are given without a scene")
        if start is not None:
            start = _integer("start", start, "a step of the log")
            if not 0 <= start < 2**63:
                raise ConfigError(f"start is {start}, expected a step of the log")
        if ego is None or scene_idx is None:
            return None, start, style
        scene = self.scenes[scene_idx]
        if ego not in (ids := list(scene.agent_ids)):
            raise UnknownNameError(f"ego: {scene.name} has no agent {ego!r}")
        return ids.index(ego), start, style

    def check_world(self, world_idx: int) -> None:
        """Refuse the index of a world that does not exist."""
        if type(world_idx) is not int or not 0 <= world_idx < self.num_worlds:
            raise UnknownNameError(
                f"no world {world_idx!r}, expected an index below {self.num_worlds}"
            )

    def agent_drivers(self, choice: Any) -> dict[str, str]:
        """Return drivers by the ids of vehicles, as a reset may be given them, checked.

        Raises:
            ConfigError: If it is something else.
            UnknownNameError: If the batch has no such driver, or none of its scenes has such a
                vehicle.
        """
        if choice is None:
            return {}
        if not isinstance(choice, Mapping):
            raise ConfigError(f"drivers is {choice!r}, expected names of drivers by agent id")
        known = ("external", *(name for name, _ in self.native.driver_table))
        for agent, driver in choice.items():
            if driver not in known:
                raise UnknownNameError(
                    f"driver of {agent!r} is {driver!r}, expected one of {', '.join(known)}; name "
                    "others in traffic or named_drivers when the environment is made"
                )
        if choice and not self._vehicle_ids:
            self._vehicle_ids = frozenset(a for scene in self.scenes for a in _vehicles(scene))
        if nobody := [agent for agent in choice if agent not in self._vehicle_ids]:
            raise UnknownNameError(f"drivers: no scene has a vehicle {nobody[0]!r}")
        return dict(choice)

    def assign(
        self, world_idx: int, drivers: Mapping[str, str], *, passing_over: bool = False
    ) -> None:
        """Put drivers into vehicles of a world by id, until its episode ends.

        Args:
            world_idx, drivers: The world, and names of drivers by id.
            passing_over: Whether vehicles that the scene does not have are passed over.

        Raises:
            UnknownNameError: If the scene has no such vehicle.
            ConfigError: If the vehicle is towed: it follows who tows it.
        """
        scene = self.scenes[self.native.status(world_idx).scene_idx]
        places = _vehicles(scene) if drivers else {}
        found = {agent: driver for agent, driver in drivers.items() if agent in places}
        if not passing_over and (unknown := [agent for agent in drivers if agent not in places]):
            raise UnknownNameError(
                f"drivers: {scene.name} (world {world_idx}) has no vehicle {unknown[0]!r}"
            )
        seats = self.native.slot_agents(world_idx)
        leaders = {a: b for a, b in scene.towed if a not in seats} if found else {}
        for agent, driver in found.items():
            if (leader := leaders.get(places[agent])) is not None:
                raise ConfigError(
                    f"drivers: {agent!r} of {scene.name} is towed by {scene.agent_ids[leader]!r}, "
                    "name the driver of that one"
                )
            self.native.assign(world_idx, [places[agent]], driver)
        self.drivers[world_idx] = found

    def set_criticality(self, criticality: Criticality) -> None:
        """Set how critical traffic is in episodes that begin later; progress stays.

        Raises:
            ConfigError: If nobody can be guided, or for what :class:`Curriculum` does not take.
        """
        own = (driver.options for driver in self.config.named_drivers.values())
        if not any(isinstance(options, PythonTraffic) for options in own):
            self.config.guided_traffic("criticality")
        progress = self.curriculum.progress if self.curriculum else 0.0
        self.curriculum = Curriculum(criticality)
        self.curriculum.progress = progress

    def set_progress(self, progress: float) -> None:
        """Set the progress of training, 0 to 1; it applies from the next episodes.

        Raises:
            ConfigError: If there is no curriculum, or the number is out of range.
        """
        if self.curriculum is None:
            raise ConfigError("progress: the environment was made without criticality")
        if not 0.0 <= progress <= 1.0:
            raise ConfigError(f"progress is {progress!r}, expected 0 to 1")
        self.curriculum.progress = float(progress)

    def set_scene_weights(self, weights: Any) -> None:
        """Draw the scenes of episodes that begin later by weights [S], all alike for ``None``.

        :class:`~ccdiff_env.worlds.curriculum.SceneWeights` gives weights by how episodes went.

        Raises:
            ConfigError: If weights are no numbers, negative, not finite or all zero, or scenes are
                played in their order.
            ShapeError: If their number is another one than that of the scenes.
        """
        if weights is not None:
            try:
                weights = np.asarray(weights, np.float64)
            except (TypeError, ValueError) as error:
                raise ConfigError(f"scene weights: {error}, expected numbers [S]") from None
            if weights.shape != (len(self.scenes),):
                raise ShapeError(
                    f"scene weights have shape {weights.shape}, expected ({len(self.scenes)},)"
                )
            weights = weights.tolist()
        self.native.set_scene_weights(weights)
        self.scene_weights = weights

    def begin_episode(self, world_idx: int, level: str) -> dict[str, Any]:
        """Draw the criticality of a new episode, where there is a curriculum, and return what
        ``info`` says about it: scene, its token, seed, episode, start.

        An ego that is drawn is reported, too. Level ``"none"`` has numbers alone: some learners
        take no text.
        """
        if self.curriculum is not None:
            status = self.native.status(world_idx)
            strength = self.curriculum.draw(status.seed, status.episode - 1)
            self.native.override_plan(world_idx, guided=None, criticality=strength)
            self.criticality[world_idx] = strength
        self.note_episode(world_idx)
        known = self.episodes[world_idx].items()
        return {k: of for k, of in known if level != "none" or not isinstance(of, str)}

    def note_episode(self, world_idx: int) -> None:
        """Note in :attr:`episodes` what is known of the present episode of a world."""
        status = self.native.status(world_idx)
        scene = self.scenes[status.scene_idx]
        info = self.episodes[world_idx] = {
            "scene": scene.name,
            "scene_token": scene.token,
            "scene_idx": status.scene_idx,
            "seed": status.seed,
            "episode_idx": status.episode - 1,
            "start_step": status.step_idx - status.elapsed_steps,
        }
        if self.config.controlled == "any" and status.ego_idx is not None:
            info |= {"ego": scene.agent_ids[status.ego_idx], "ego_idx": status.ego_idx}
        strength = self.criticality.get(world_idx, self.configured_criticality)
        if strength is not None:
            info["criticality"] = strength

    def explain(self, world_idx: int, driver: str | None = None) -> TrafficPlan | None:
        """Return the plan that a world follows, of the driver or of the first that plans; ``None``
        before the first one.

        Raises:
            UnknownNameError: If the world does not exist, or no such driver plans.
        """
        self.check_world(world_idx)
        if not self.native.planners:
            raise UnknownNameError(
                f"explain: traffic is {self.config.traffic!r}, expected one that plans, as 'ccdiff'"
            )
        plan = self.native.explain(world_idx, driver)
        if plan is None:
            return None
        native, scene = self.native, self.scenes[self.native.status(world_idx).scene_idx]
        table = (("external", "external"), ("towed", "towed"), *native.driver_table)
        moment = scene, {**native.states(world_idx)}, table, native.drivers(world_idx)
        return TrafficPlan(**plan, moment=moment)

    def observe(self, world_idx: int) -> tuple[F32, U8 | None]:
        """Return the present observations [C, D] and rasters [C, P, S, S] of a world."""
        rows = np.empty((self.num_slots, self.layout.size), np.float32)
        raster = self.layout.raster
        bev = None if raster is None else np.empty((self.num_slots, *raster), np.uint8)
        self.native.observe(world_idx, rows, bev)
        return rows, bev
