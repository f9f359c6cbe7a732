"""``ccdiff-env play``: change criticality, seed, driver, or where an agent is, and play again."""

from __future__ import annotations

import argparse
import html
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.policies import SHIPPED
from ccdiff_env.policies.planners import BUILT_IN
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet, with_tracks
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.system.files import parsed_object
from ccdiff_env.view.captions import DRIVER_TITLES, planner_title
from ccdiff_env.view.page import local_html, page_html
from ccdiff_env.view.server import LocalServer
from ccdiff_env.view.sources import log_rollout, play_scene

__all__ = ["Playground", "moved_scene"]

DRIVERS = ("ccdiff", "idm", "replay", "constant_velocity")
#: Planners that drive the ego from outside.
EGOS = (*BUILT_IN, *SHIPPED)
MAX_MOVE_M = 100.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("scene", nargs="?", help="scene to begin with (default: the first)")
    add_scene_arguments(parser)
    parser.add_argument("--port", type=int, default=0, help="port of 127.0.0.1; 0: a free one")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")


def run(args: argparse.Namespace) -> int:
    """Serve the page until interrupted."""
    scenes = scenes_from(args)
    first = args.scene or scenes.names[0]
    if first not in scenes:
        raise UnknownNameError(f"no scene {first!r}: ccdiff-env scenes lists them")
    ground = Playground(scenes, first)
    LocalServer(ground.answers, args.port).run(open_it=args.open)
    return 0


@dataclass(frozen=True)
class Playground:
    """Plays scenes as a page asks for.

    Parameters
    ----------
    scenes
        What can be played.
    first
        Name of the scene to begin with.
    """

    scenes: SceneSet
    first: str

    @property
    def answers(self) -> dict[str, Any]:
        """Answers by path, for :class:`~ccdiff_env.view.server.LocalServer`."""
        return {"/": self.page, "/replay": self.replay}

    def page(self, words: Mapping[str, str]) -> str:
        """Return the page of the controls."""
        parts = {
            "scenes": _options({name: name for name in self.scenes.names}, self.first),
            "traffic": _options({name: DRIVER_TITLES[name] for name in DRIVERS}, "ccdiff"),
            "drivers": _options({n: planner_title(n) for n in (*DRIVERS, *EGOS)}, "idm"),
        }
        return local_html("play", parts)

    def replay(self, words: Mapping[str, str]) -> str:
        """Play a scene and return its page.

        Parameters
        ----------
        words
            ``scene``, ``traffic``, ``driver``, ``criticality``, ``seed``, ``compare`` (``"log"``),
            ``moves``: JSON, metres east and north by agent id.
        """
        name = words.get("scene", self.first)
        if name not in self.scenes:
            raise UnknownNameError(f"no scene {name!r}")
        scene = self.scenes[name]
        moves = _moves(words.get("moves", "{}"))
        traffic = words.get("traffic", "ccdiff")
        level = _number("criticality", words.get("criticality", "0"), 0.0, 2.0)
        rollout = play_scene(
            moved_scene(scene, moves),
            traffic=traffic,
            driver=words.get("driver", "idm"),
            seed=int(_number("seed", words.get("seed", "0"), 0, 2**31 - 1)),
            ccdiff={"criticality": level},
        )
        other: Rollout | None = None
        if words.get("compare") == "log":
            other = log_rollout(scene, like=rollout)
        title = DRIVER_TITLES.get(traffic, traffic)
        if level > 0.0:
            title += f", criticality {level:g}"
        titles = None if other is None else (title, "log")
        return page_html(rollout, compare=other, titles=titles, edit=True)


def moved_scene(scene: Scene, moves: Mapping[str, tuple[float, float]]) -> Scene:
    """Return a scene in which agents are elsewhere, with their whole logs.

    Parameters
    ----------
    scene
        The scene.
    moves
        Metres east and north by agent id.

    Raises
    ------
    UnknownNameError
        If the scene has no such agent.
    """
    if not moves:
        return scene
    tracks = dict(scene.tracks())
    position: Any = tracks["position"]
    for name, (east_m, north_m) in moves.items():
        if name not in scene.agent_ids:
            raise UnknownNameError(f"no agent {name!r} in {scene.name}")
        agent = scene.agent_ids.index(name)
        there: Any = tracks["valid"]
        position[agent, there[agent]] += np.array([east_m, north_m], np.float32)
    return with_tracks(scene, tracks)


def _moves(text: str) -> dict[str, tuple[float, float]]:
    try:
        found = {name: (float(x), float(y)) for name, (x, y) in parsed_object(text).items()}
    except (ValueError, TypeError):
        raise ConfigError(f"moves is {text!r}, expected metres by agent id in JSON") from None
    for name, move in found.items():
        if not all(abs(value) <= MAX_MOVE_M for value in move):
            raise ConfigError(f"moves[{name!r}] is {move}, expected at most {MAX_MOVE_M:g} m")
    return found


def _number(name: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise ConfigError(f"{name} is {text!r}, expected {low:g} to {high:g}")
    return value


def _options(names: Mapping[str, str], chosen: str) -> str:
    return "".join(
        f'<option value="{html.escape(name, quote=True)}"{" selected" * (name == chosen)}>'
        f"{html.escape(title)}</option>"
        for name, title in names.items()
    )
