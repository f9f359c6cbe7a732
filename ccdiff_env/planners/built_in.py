"""Planners of the ego: one protocol for functions, classes, modules and files of policies.

docs/planners.md shows the protocol with examples.
"""

from __future__ import annotations

import inspect
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import BevConfig, WorldConfig
from ccdiff_env.errors import CcdiffError, ConfigError, ShapeError, raised_by, unknown
from ccdiff_env.interop.nuplan import PREFIX, nuplan_planner
from ccdiff_env.planners import SHIPPED, load
from ccdiff_env.planners.planning import FRAMES, Tracker
from ccdiff_env.planners.rules import LaneIdm, NoOp, PdmClosed
from ccdiff_env.planners.sb3_policy import Sb3Policy
from ccdiff_env.system.named_objects import named_object, strip_title
from ccdiff_env.traffic import KINDS, driver_names
from ccdiff_env.traffic.python import PythonTraffic
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.fit import Fit
from ccdiff_env.worlds.spaces import F32, U8, Form, StepArrays
from ccdiff_env.worlds.worlds_view import worlds_view

__all__ = [
    "EGO_HELP", "Act", "Ego", "Planner", "Seat", "ego_driver", "is_of_package", "seat_driver",
]  # fmt: skip

#: Planners of the package by name, without weights of their own.
BUILT_IN: dict[str, type] = {"pdm": PdmClosed, "lane_idm": LaneIdm, "noop": NoOp}
#: From observations of N worlds to actions [N, W], or indices [N].
Act: TypeAlias = Callable[[Any], npt.NDArray[Any]]
#: Help of an option that says who drives the ego.
EGO_HELP = (
    f"driver of the ego, of: {', '.join((*driver_names(), *BUILT_IN, *SHIPPED))}, module:name of a "
    "planner, module:name?option=value with options, nuplan:package.module.Class of nuPlan, "
    "the file of a policy (.safetensors, or .zip, which runs the code in it: trust whoever made it)"
)


@runtime_checkable
class Planner(Protocol):
    """What drives egos, one in each of E worlds.

    Attributes are optional: ``observation`` (``"flat"``, the default, ``"dict"`` or ``"bev"``) is
    the form in which observations come, ``frame`` that of trajectories: ``"scene"``, the default as
    with nuPlan's planners, or ``"ego"``, x ahead and y left of it. ``env_options`` are fields of
    :class:`~ccdiff_env.WorldConfig` that the planner needs; benchmarks take actions, observations,
    dynamics and decision steps, nothing else. ``files`` are paths that it reads: a benchmark plays
    again where one of them has changed. ``privileged = True`` says that it uses what a vehicle
    cannot know, as the log or forks.
    """

    def reset(self, worlds: Worlds, indices: npt.NDArray[np.int64]) -> None:
        """Forget the episodes of some worlds: new ones begin there. Optional."""

    def explain(self) -> Sequence[tuple[Any, Any]]:
        """Return what was weighed at the last call, for each world: trajectories [C, T, 3] as in
        ``frame``, and their costs [C]; the cheapest is driven. Optional; pages draw it.
        """

    def __call__(self, obs: Any) -> npt.NDArray[Any]:
        """Return actions [E, W] in [-1, 1], or indices [E], for observations of all worlds.

        Trajectories [E, T, 3] are followed: x, y (m) and heading (rad) after every step of the
        worlds, in the planner's ``frame``. ``obs`` is [E, D] float32, a dictionary of arrays
        [E, ...], or uint8 [E, channels, S, S].
        """


class _Predicts(Protocol):
    """A policy of stable-baselines3."""

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        """Return actions and states."""


#: A driver of the world by name, a planner, a function, a policy with ``predict``, the file of one,
#: or ``module:name``.
Ego: TypeAlias = str | os.PathLike[str] | Act | _Predicts

_WORLD_DRIVERS = driver_names()


class Seat:
    """A planner of the egos: its output is checked, its actions are held as long as in training.

    Args:
        planner: See :class:`Planner`; a class is made with the worlds where it takes an argument.
        name: What errors call it.
        ego: What it was found by, for copies, which take their seats again; itself by default.
    """

    def __init__(self, planner: Any, name: str, ego: Ego | None = None) -> None:
        self.name, self._ego = name, planner if ego is None else ego
        options = dict(getattr(planner, "env_options", {}))
        #: Configuration of worlds that fit.
        self.config = (options.pop("config", None) or WorldConfig()).with_options(**options)
        #: Whether the planner says that it uses what a vehicle cannot know.
        self.privileged = bool(getattr(planner, "privileged", False))
        self._planner = planner
        self._act: Any = None if isinstance(planner, type) else planner
        self._worlds: Worlds | None = None
        self._seen: tuple[F32, U8 | None] | None = None
        self._clipped = False
        self._frame = getattr(planner, "frame", "scene")
        if self._frame not in FRAMES:
            raise ConfigError(f"{name}: frame is {self._frame!r}, expected 'scene' or 'ego'")
        self._form: Form = getattr(planner, "observation", "flat")
        if self._form not in ("flat", "dict", "bev"):
            raise ConfigError(
                f"{name}: observation is {self._form!r}, expected 'flat', 'dict' or 'bev'"
            )
        if self._form == "bev" and self.config.observation.bev is None:
            self.config = self.config.with_options(bev=BevConfig())

    def __reduce__(self) -> Any:
        """Return how a copy or a pickle makes the seat."""
        return seat_of, (self._ego,)

    def trained_in(self, dt_s: float) -> bool:
        """Return whether the planner's file says that it was trained in steps of so long."""
        fit = getattr(self._planner, "fit", None)
        return isinstance(fit, Fit) and bool(fit.options["dt_s"] == dt_s)

    def begin(self, worlds: Worlds) -> None:
        """Take the seats of worlds, all of which begin an episode.

        The planner reads the worlds alone, see :mod:`ccdiff_env.worlds.worlds_view`, unless it is
        privileged.

        Raises:
            ConfigError: If the worlds are not what the planner needs.
        """
        given_worlds = worlds if self.privileged else worlds_view(worlds, self.name)
        if isinstance(self._planner, type):
            given = inspect.signature(self._planner).parameters.values()
            takes = any(p.default is p.empty and p.kind < p.VAR_POSITIONAL for p in given)
            made = (given_worlds,) if takes else ()
            self._act = self._answer(lambda: self._planner(*made), worlds, range(worlds.num_worlds))
        if not callable(self._act):
            raise ConfigError(f"{self.name}: a {type(self._act).__name__} cannot be called")
        fit = getattr(self._act, "fit", None)
        if isinstance(fit, Fit):
            fit.check(worlds.config, worlds.native.layout_json, self.name)
            space = getattr(self._act, "space", None)
            if space is not None and space != worlds.layout.space(self._form):
                raise ConfigError(
                    f"{self.name} was trained on observations of another space than the worlds' "
                    "own, as VecNormalize makes of rasters; train it without"
                )
        self._worlds, self._given_worlds = worlds, given_worlds
        #: What the planner meant to do in a world, until it is asked for: see :meth:`intention`.
        self._meant: dict[int, tuple[F32, F32]] = {}
        self._tracker: Tracker | None = None
        #: Shape of actions: [E, W], or [E] of indices.
        self._shape = (worlds.num_worlds, worlds.native.action_width)[: 1 if worlds.discrete else 2]
        dtype = np.int64 if worlds.discrete else np.float32
        self._present: npt.NDArray[Any] = np.zeros(self._shape, dtype)
        # worlds may hold actions for the steps of a decision themselves
        self._steps = self.config.decision_steps if worlds.config.decision_steps == 1 else 1
        self._new = np.ones(worlds.num_worlds, np.bool_)
        self.reset(range(worlds.num_worlds))

    def reset(self, indices: Sequence[int] | npt.NDArray[np.int64]) -> None:
        """Tell the planner that episodes begin in some worlds."""
        self._seen = None
        if self._worlds is not None:
            which = np.asarray(indices, np.int64)
            self._new[which] = True
            if hasattr(self._act, "reset"):
                self._answer(
                    lambda: self._act.reset(self._given_worlds, which), self._worlds, which
                )

    def see(self, out: StepArrays) -> None:
        """Keep a copy of what a reset or step of all worlds wrote, for :meth:`decide`."""
        rasters = out.bev if self._form != "flat" else None
        self._seen = out.obs[:, 0].copy(), None if rasters is None else rasters[:, 0].copy()

    def decide(self, worlds: Worlds) -> npt.NDArray[Any]:
        """Return actions for the present of worlds, whose seats are taken at the first call.

        Worlds that were restored since the last :meth:`see` are observed.
        """
        seen = self._seen
        if self._worlds is None:
            self.begin(worlds)
        if seen is None:
            seen = np.stack([worlds.observe(i)[0][0] for i in range(worlds.num_worlds)]), None
        return self(seen[0], rasters=seen[1])

    def __call__(
        self, obs: F32, active: npt.NDArray[np.bool_] | None = None, rasters: U8 | None = None
    ) -> npt.NDArray[Any]:
        """Return actions for rows [E, D].

        Args:
            obs: Observations.
            active: Worlds [E] that go on; all by default. The actions of the others mean nothing.
            rasters: Rasters [E, P, S, S] where the planner sees them; drawn by default.

        Raises:
            ShapeError: If the planner returns another shape, or numbers that are not finite.
            ActionError: If a trajectory does not begin where its vehicle is.
            PolicyError: If the planner raises; names it, the scenes and their steps.
        """
        if self._worlds is None:  # a function by itself
            return np.asarray(self._act(obs))
        num_worlds, native = self._worlds.num_worlds, self._worlds.native
        due = np.ones(num_worlds, np.bool_) if active is None else active
        if self._steps > 1:
            elapsed = np.array([native.status(i).elapsed_steps for i in range(num_worlds)])
            due = due & ((elapsed % self._steps == 0) | self._new)
            if not due.any():
                return self._present
        self._new &= ~due
        # all worlds are decided for: products of matrices round with the number of rows
        found = self._decided(obs, rasters, due)
        self._present = self._present.copy()
        self._present[due] = found[due]
        return self._present

    def _decided(
        self, obs: F32, rasters: U8 | None, due: npt.NDArray[np.bool_]
    ) -> npt.NDArray[Any]:
        """Return what the planner decides, checked."""
        assert self._worlds is not None
        rasters = self._rasters() if rasters is None else rasters
        given = self._worlds.layout.observation(self._form, obs, rasters)
        answered = self._answer(lambda: self._act(given), self._worlds, np.flatnonzero(due))
        found, shape = np.asarray(answered), self._shape
        is_number = found.dtype.kind in "iuf"
        if is_number and not np.isfinite(found).all():
            raise ShapeError(f"{self.name} returned numbers that are not finite")
        if is_number and found.shape[:1] + found.shape[2:] == (len(obs), 3):
            followed = self._followed(found, due)
            for i in np.flatnonzero(due).tolist():
                self._meant[i] = self._in_scene(i, found[i : i + 1]), np.zeros(1, np.float32)
            found = followed
        if hasattr(self._act, "explain"):
            told = self._answer(self._act.explain, self._worlds, np.flatnonzero(due))
            for i in np.flatnonzero(due).tolist():
                self._meant[i] = self._weigh(i, told)
        if found.shape == (*shape, 1) and len(shape) == 1:
            found = found[:, 0]
        if found.shape != shape or not is_number:
            raise ShapeError(
                f"{self.name} returned {found.dtype} {list(found.shape)} for {len(obs)} worlds, "
                f"expected actions {list(shape)} or trajectories [{len(obs)}, T, 3]"
            )
        most = np.abs(found[due]).max(initial=0.0) if len(shape) == 2 else 0.0
        if most > 1.001 and not self._clipped:
            self._clipped = True
            warnings.warn(
                f"{self.name} returned {most:.3g}: actions beyond [-1, 1] are clipped, where 1 is "
                "the limit of the dynamics, not 1 m/s²",
                stacklevel=2,
            )
        return found

    def _followed(self, trajectories: npt.NDArray[Any], due: npt.NDArray[np.bool_]) -> F32:
        """Return the actions [E, 2] that follow trajectories [E, T, 3]."""
        if 0 < trajectories.shape[1] < self.config.decision_steps:
            raise ShapeError(
                f"{self.name} returned trajectories of {trajectories.shape[1]} poses, expected "
                f"{self.config.decision_steps} (decision_steps) or more: a pose for every step"
            )
        try:
            self._tracker = self._tracker or Tracker(self._worlds, frame=self._frame)
            return self._tracker(trajectories, due)
        except CcdiffError as error:
            raise type(error)(f"{self.name} returned trajectories: {error}") from None

    def intention(self, world_idx: int) -> tuple[F32, F32] | None:
        """Return what the planner meant to do in a world since it was last asked: trajectories
        [C, T, 3] in the scene's frame, and their costs [C], the one that it drives first.

        ``None`` of one that gives actions alone and has no ``explain``.
        """
        return self._meant.pop(world_idx, None)

    def _weigh(self, world_idx: int, told: Any) -> tuple[F32, F32]:
        """What ``explain()`` says of a world, checked, the cheapest first."""
        try:
            poses, costs = (np.asarray(part, np.float32) for part in told[world_idx])
            if not (poses.ndim == 3 and poses.shape[2] == 3 and costs.shape == poses.shape[:1]):
                raise ValueError(f"shapes {poses.shape} and {costs.shape}")
            if not (len(costs) and np.isfinite(poses).all() and np.isfinite(costs).all()):
                raise ValueError("no candidate, or numbers that are not finite")
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise ShapeError(
                f"{self.name}: explain() says of world {world_idx} {error}, expected trajectories "
                "[C, T, 3] and costs [C]"
            ) from None
        order = np.argsort(costs, kind="stable")
        return self._in_scene(world_idx, poses[order]), costs[order]

    def _in_scene(self, world_idx: int, poses: npt.NDArray[Any]) -> F32:
        """Poses [C, T, 3] of the planner's frame in that of the scene."""
        assert self._worlds is not None
        poses = np.array(poses, np.float32)
        agent = self._worlds.native.slot_agents(world_idx)[0]
        if self._frame == "ego" and agent is not None:
            states = self._worlds.native.states(world_idx)
            x, y = states["position"][agent]
            turn = states["heading"][agent]
            ahead, left = poses[..., 0].copy(), poses[..., 1].copy()
            poses[..., 0] = x + ahead * np.cos(turn) - left * np.sin(turn)
            poses[..., 1] = y + ahead * np.sin(turn) + left * np.cos(turn)
            poses[..., 2] += turn
        return poses

    def _rasters(self) -> U8 | None:
        """Rasters [E, channels, S, S] of the first slots, where the planner sees them."""
        assert self._worlds is not None
        if self._form == "flat" or self._worlds.layout.raster is None:
            return None
        rasters = (self._worlds.observe(i)[1] for i in range(self._worlds.num_worlds))
        stacked: U8 = np.stack([found[0] for found in rasters if found is not None])
        return stacked

    def _answer(
        self, ask: Callable[[], Any], worlds: Worlds, indices: Sequence[int] | npt.NDArray[np.int64]
    ) -> Any:
        """Ask the planner; what it raises names it, scenes and steps."""
        found = [worlds.native.status(int(i)) for i in indices[:3]]
        where = ", ".join(
            f"{worlds.scenes[s.scene_idx].name} at step {s.elapsed_steps}" for s in found
        )
        more = f" and {len(indices) - 3} more" if len(indices) > 3 else ""
        with raised_by(self.name, where + more):
            return ask()


def seat_driver(
    options: Mapping[str, Any], config: WorldConfig | None, asked: Mapping[str, Any]
) -> tuple[Seat | None, WorldConfig | None, dict[str, Any]]:
    """Take a planner out of an environment's option ``driver``; ``asked``: what the scenes ask for.

    Returns who makes the ego's actions, configuration and options: ``None`` and the same as before
    for a driver of the world. A planner's own configuration stands in for none. A name of neither
    is a :class:`ConfigError`.
    """
    name = options.get("driver")
    own = options.get("named_drivers", config and config.named_drivers) or ()
    if name is None or isinstance(name, PythonTraffic) or name in ("external", *KINDS, *own):
        return None, config, dict(options)
    driver, seat = ego_driver(name)
    options = {**options, "driver": driver}
    if config is None and seat is not None:
        return seat, seat.config.with_options(decision_steps=1), {**asked, **options}
    return seat, config, options


def is_of_package(planner: str) -> bool:
    """Return whether a text names a driver of the world or a planner of the package.

    No code and no file of others is read to drive by such a name.
    """
    return planner in (*_WORLD_DRIVERS, *BUILT_IN, *SHIPPED)


def ego_driver(ego: Ego) -> tuple[str, Seat | None]:
    """Return the driver of the ego's slot, and who makes its actions if nobody of the world does.

    Args:
        ego: ``"replay"``, ``"idm"``, ``"constant_velocity"`` or ``"ccdiff"``; a name of
            :data:`BUILT_IN`; a policy of :mod:`ccdiff_env.planners` by name, or its file
            (``.safetensors``); a :class:`Planner`, a class of one, a function from observations [N,
            D] to actions [N, ...], or ``module:name`` of these (``module:name?option=value`` with
            options); ``nuplan:package.module.Class`` of a planner of nuPlan, see
            :func:`~ccdiff_env.interop.nuplan.nuplan_planner`; an object with ``predict`` as those
            of stable-baselines3; or the path of a policy that stable-baselines3 saved.

    Raises:
        ConfigError: For another name.
    """
    if isinstance(ego, str) and (name := strip_title(ego)) in _WORLD_DRIVERS:
        return name, None
    return "external", seat_of(ego)


def seat_of(ego: Ego) -> Seat:
    """Return who makes the actions of an ego that no driver of the world drives."""
    planner: Any = ego
    if not isinstance(ego, (str, os.PathLike)):
        name = getattr(ego, "__name__", type(ego).__name__)
        if hasattr(ego, "predict") and not callable(ego):
            planner = Sb3Policy(ego, name)
        return Seat(planner, name, ego)
    given = os.fspath(ego)
    name = strip_title(given)
    if name.endswith(".zip") and "?" not in name:
        return Seat(load(name), Path(given).name, ego)
    if name.startswith(PREFIX):
        planner = nuplan_planner(name)
    elif ":" in name:
        planner = named_object(name, "planner")
    elif name in SHIPPED or name.endswith(".safetensors"):
        planner = load(name)
    elif name in BUILT_IN:
        planner = BUILT_IN[name]
    else:
        raise unknown("driver of the ego", name, [*_WORLD_DRIVERS, *BUILT_IN, *SHIPPED])
    return Seat(planner, given, ego)
