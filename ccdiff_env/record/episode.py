"""Episodes in batches of worlds: one loop for benchmarks, banks, counterfactuals and pages."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import Seat
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.scenes import SceneSet
from ccdiff_env.worlds import StepArrays, Worlds
from ccdiff_env.worlds.configured import normalize_seed

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]

#: Options that a planner may choose where all others are fixed.
CHOICES = ("action", "observation", "decision_steps")
#: Limits of models of motion of which less is more, and what actions mean: others limit that.
_LEAST, _MEANINGS = ("wheelbase_share",), ("delta_mps2", "offset_m")


class Step(NamedTuple):
    """One step of a batch of E worlds."""

    running: Bool  #: Worlds that took it [E]; those that the caller clears take no further one.
    actions: F32  #: Actions that led to it [E, C, W].
    out: StepArrays  #: What came of it; the next step overwrites the arrays.


def world_of_seat(
    world: WorldConfig, seat: Seat | None, who: str, *, fixed_by: str, dt_s: float
) -> WorldConfig:
    """Return the configuration of an episode: what ``world`` fixes, and what a planner chooses.

    ``who`` and ``fixed_by`` are what errors call the planner, and what fixes the rest. A
    :class:`ConfigError` refuses a planner that asks for anything else, or for wider limits of its
    model of motion than the default ones.
    """
    world = world.with_options(dt_s=dt_s)
    if seat is None:
        return world
    free = (*CHOICES, "dt_s") if seat.trained_in(dt_s) else CHOICES
    for name in (f.name for f in dataclasses.fields(WorldConfig) if f.name not in free):
        asked = getattr(seat.config, name)
        if asked != getattr(WorldConfig(), name):
            raise ConfigError(
                f"{who}: env_options changes {name} to {asked!r}, which {fixed_by} fixes at "
                f"{getattr(world, name)!r}; a planner may choose action, observation, "
                "decision_steps and dynamics"
            )
    _check_limits(seat.config.action.dynamics, who, fixed_by)
    return world.with_options(action=seat.config.action, observation=seat.config.observation)


def _check_limits(limits: Any, who: str, fixed_by: str) -> None:
    """Refuse a model of motion that can do more than by default."""
    usual = type(limits)()
    for name in (f.name for f in dataclasses.fields(limits)):
        asked, most = getattr(limits, name), getattr(usual, name)
        if isinstance(most, str) or name in _MEANINGS:
            continue
        if isinstance(most, tuple):
            holds, words = most[0] <= asked[0] <= asked[1] <= most[1], f"a part of {list(most)}"
        elif name in _LEAST:
            holds, words = asked >= most, f"at least {most:g}"
        else:
            holds, words = asked <= most, f"at most {most:g}"
        if not holds:
            raise ConfigError(
                f"{who}: env_options sets {name} of {type(limits).__name__} to {asked!r}, "
                f"{fixed_by} lets a planner choose {words}"
            )


def begin(scenes: SceneSet, config: WorldConfig, seed: int) -> Worlds:
    """Return worlds, one of each scene, at the beginning of episodes of a seed."""
    worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=1)
    seed = normalize_seed(seed)
    worlds.native.reset([seed] * len(scenes), list(range(len(scenes))), None, worlds.arrays())
    return worlds


def recorders_of(worlds: Worlds, names: Collection[str], **meta: Any) -> dict[int, Recorder]:
    """Return recorders, by world, of the worlds that :func:`begin` made of scenes of some names.

    ``meta`` are entries of :attr:`~ccdiff_env.Rollout.meta`.
    """
    chosen = (i for i, scene in enumerate(worlds.scenes) if scene.name in names)
    return {i: Recorder(worlds, world_idx=i, **meta) for i in chosen}


def play(
    worlds: Worlds,
    act: Callable[[F32, Bool], npt.NDArray[Any]] | None = None,
    *,
    recorders: Mapping[int, Recorder] = MappingProxyType({}),
    most: int | None = None,
) -> Iterator[Step]:
    """Play the present episodes of all worlds to their ends; yields after every step.

    Args:
        worlds: Worlds in episodes, without autoreset.
        act: From the observations of the first slots [E, D] and the worlds that go on [E] to
            actions of E·C·W numbers, or indices; for example a
            :class:`~ccdiff_env.planners.built_in.Seat` that has begun. ``None``: nobody is driven
            from outside.
        recorders: Recorders by world, which are stepped here.
        most: Steps at most.
    """
    native, out = worlds.native, worlds.last
    if out is None:  # the worlds were restored
        out = worlds.arrays()
        for i in range(worlds.num_worlds):
            native.observe(i, out.obs[i], None if out.bev is None else out.bev[i])
    shape = (worlds.num_worlds, worlds.num_slots, native.action_width)
    actions: F32 = np.zeros(shape, np.float32)
    running = np.ones(worlds.num_worlds, np.bool_)
    taken = 0
    while running.any() and (most is None or taken < most):
        if act is not None:
            actions = act(out.obs[:, 0], running).astype(np.float32).reshape(shape)
        if isinstance(act, Seat):
            for i, recorder in recorders.items():
                if running[i] and (meant := act.intention(i)) is not None:
                    recorder.intend(*meant)
        native.step(actions, out, running)
        for i, recorder in recorders.items():
            if running[i]:
                recorder.step()
        yield Step(running, actions, out)
        running &= ~out.done
        taken += 1
