"""``ccdiff-env scenes``: which scenes there are to play and to look at."""

from __future__ import annotations

import argparse

from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from, sources_help
from ccdiff_env.system.table import Table
from ccdiff_env.system.terminal import say
from ccdiff_env.view.notebook import HEADS, scene_row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser)
    parser.epilog = sources_help()


def run(args: argparse.Namespace) -> int:
    """Print a table of the scenes."""
    say(str(Table(HEADS, [scene_row(scene) for scene in scenes_from(args)])))
    return 0
