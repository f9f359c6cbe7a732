"""``ccdiff-env scenes``: which scenes there are to play and to look at."""

from __future__ import annotations

import argparse

import numpy as np

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from, sources_help
from ccdiff_env.scenes.signals import recorded_passes
from ccdiff_env.system.table import Table
from ccdiff_env.system.terminal import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser)
    parser.add_argument("source", nargs="?", metavar="SOURCE", help="the same as --scenes SOURCE")
    parser.epilog = sources_help()


def run(args: argparse.Namespace) -> int:
    """Print a table of the scenes, and how their recorded vehicles obey traffic lights."""
    if args.source is not None:
        if args.scenes is not None:
            raise ConfigError(f"scenes of {args.source} and --scenes {args.scenes}: give one")
        args.scenes = args.source
    heads, scenes = ("scene", "location", "seconds", "agents", "vehicles"), scenes_from(args)
    say(str(Table(heads, [_row(scene) for scene in scenes])))
    passes, red = np.sum([recorded_passes(scene) for scene in scenes], axis=0)
    if passes:
        say(f"recorded vehicles pass {passes} stop lines of lights, {red / passes:.1%} in red")
    return 0


def _row(scene: Scene) -> tuple[str, str, str, int, int]:
    seconds = f"{(scene.num_steps - 1) * scene.dt:.1f}"
    vehicles = scene.agent_types.count("vehicle")
    return scene.name, scene.location, seconds, scene.num_agents, vehicles
