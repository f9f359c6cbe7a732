"""Images of running worlds, seen from above."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import UnknownNameError
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.scene_types import AGENT_KINDS
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.spaces import F32, U8

Centre: TypeAlias = str | tuple[float, float] | None

#: Number in images and title of drivers and kinds of drivers, by name.
_STYLES = {name: (number, title) for name, title, number in _native.drivers()}
_STANDS_MPS = 0.1  #: A vehicle that is parked in the log and no faster than this is drawn parked.


@lru_cache(maxsize=32)
def _parked(scene: Scene) -> npt.NDArray[np.bool_]:
    """Which agents [A] are vehicles that stay where the log has them first; never the ego."""
    log = scene.tracks()
    first = log["position"][np.arange(scene.num_agents), log["valid"].argmax(axis=1)]
    away_m = np.linalg.norm(log["position"] - first[:, None], axis=2) * log["valid"]
    is_vehicle = np.array(scene.agent_types) == "vehicle"
    stays = away_m.max(axis=1) <= dict(_native.render_look())["PARKED_M"]
    parked: npt.NDArray[np.bool_] = stays & is_vehicle & (np.array(scene.agent_ids) != "ego")
    return parked


def _styles(native: _native.VecWorld, world_idx: int, ego: int | None) -> list[tuple[int, str]]:
    """Number in images and title of each agent [A]: guided, the ego, else by its driver's kind."""
    kinds, drivers = dict(native.driver_table), native.drivers(world_idx)
    found = [_STYLES.get(kinds.get(name, name), _STYLES["other"]) for name in drivers]
    if ego is not None:
        found[ego] = _STYLES["ego"]
    for name in native.planners:
        plan = native.explain(world_idx, name)
        for agent in () if plan is None else plan["agents"][plan["guided"]]:
            if drivers[agent] == name:
                found[agent] = _STYLES["adversary"]
    return found


def _pose(scene: Scene, states: Any, step: int, agent: int) -> tuple[F32, float]:
    """Position [2] and heading of an agent; of one that is away, at the nearest step of the log."""
    if states["active"][agent]:
        return states["position"][agent], float(states["heading"][agent])
    log = scene.tracks()
    logged = np.flatnonzero(log["valid"][agent])
    nearest = logged[np.abs(logged - step).argmin()]
    return log["position"][agent, nearest], float(log["heading"][agent, nearest])


def _ahead(route: tuple[F32, tuple[float, float]] | None, at: F32) -> F32:
    """The part of a route from where its agent is to its goal [P, 2]."""
    if route is None:
        return np.zeros((0, 2), np.float32)
    points, goal = route
    ahead = points[((points - at) ** 2).sum(axis=1).argmin() :]
    return ahead[: ((ahead - np.array(goal, np.float32)) ** 2).sum(axis=1).argmin() + 1]


def image(
    worlds: Worlds,
    world_idx: int,
    *,
    size: tuple[int, int],
    span_m: float,
    centre: Centre,
    heading_up: bool,
    route: bool,
    labels: bool,
    theme: str,
) -> U8:
    """Draw a world as it is now, [H, W, 3]; see :data:`~ccdiff_env.envs.drawing.RENDER_OPTIONS`.

    The agent of the first slot is in the middle by default. Agents with a slot that touch others
    have a red outline.

    Raises:
        UnknownNameError: If the scene has no agent of the name ``centre``.
        ConfigError: If a number is out of its range.
    """
    native = worlds.native
    status, states = native.status(world_idx), native.states(world_idx)
    scene, slots = worlds.scenes[status.scene_idx], native.slot_agents(world_idx)
    there, position = np.flatnonzero(states["active"]), states["position"]
    styles = _styles(native, world_idx, status.ego_idx)
    slot, agent = next(((c, a) for c, a in enumerate(slots) if a is not None), (0, None))
    middle, heading = np.zeros(2, np.float32), math.pi / 2
    way = native.route(world_idx, slot)
    if agent is not None:
        middle, heading = _pose(scene, states, status.step_idx, agent)
        if way is not None and not states["active"][agent]:  # it has reached its goal
            middle = np.array(way[1], np.float32)
    ahead = _ahead(way if route else None, middle)
    if isinstance(centre, str):
        if centre not in scene.agent_ids:
            raise UnknownNameError(f"scene {scene.name!r} has no agent {centre!r}")
        followed = scene.agent_ids.index(centre)
        middle, heading = _pose(scene, states, status.step_idx, followed)
    elif centre is not None:
        middle, heading = np.array(centre, np.float32), math.pi / 2
    touching = {(a, b) for a, b, *_ in native.contacts(world_idx) if a < b and {a, b} & {*slots}}
    marks = [position[a] + 0.5 * (position[b] - position[a]) for a, b in sorted(touching)]
    kinds = [AGENT_KINDS.index(kind) for kind in scene.agent_types]
    static = AGENT_KINDS.index("static")
    legend = sorted({styles[a] for a, kind in enumerate(kinds) if kind != static})
    colours = _native.render_legend(theme)
    rows = [(colours[number][1], title) for number, title in legend]
    rows += [(dict(colours)["static obstacle"], "obstacle")] * (static in kinds)
    caption = f"{scene.name}  {scene.dt * status.elapsed_steps:.1f} s"
    if agent in there:
        caption += f"  {states['speed'][agent]:.1f} m/s"
    elif agent is not None and way is not None:
        caption += "  reached its goal"
    if met := [b if a == agent else a for a, b in sorted(touching) if agent in (a, b)]:
        caption += f"  collided with {met[0]}"
    drawn = _native.render_arrays(
        position[there],
        states["heading"][there],
        scene.sizes[there, :2].copy(),
        np.array(kinds, np.uint8)[there],
        np.array([number for number, _ in styles], np.uint8)[there],
        np.isin(there, [*sum(touching, ())]),
        (_parked(scene) & (states["speed"] < _STANDS_MPS))[there],
        np.zeros(len(there), bool),
        scene=scene,
        step_idx=status.step_idx,
        size=size,
        span_m=span_m,
        centre_m=(float(middle[0]), float(middle[1])),
        up_rad=heading if heading_up else math.pi / 2,
        route_m=ahead,
        collisions_m=np.array(marks, np.float32).reshape(-1, 2),
        names=["ego" if a == status.ego_idx else str(a) for a in there] if labels else [],
        caption=caption if labels else "",
        scale_bar=labels,
        legend=rows if labels else [],
        theme=theme,
    )
    assert isinstance(drawn, np.ndarray)
    return drawn
