"""``ccdiff-env scenes``: which scenes there are to play and to look at."""

from __future__ import annotations

import argparse
from pathlib import Path

from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.scenes import load_nuscenes
from ccdiff_env.terminal import DATAROOT_HELP, align, split_help
from ccdiff_env.view.notebook import scene_row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("--dataroot", type=Path, help=DATAROOT_HELP)
    parser.add_argument("--version", default="v1.0-mini", help="folder of the tables")
    parser.add_argument("--split", help=split_help("all", "all"))


def run(args: argparse.Namespace) -> int:
    """Print a table of the scenes."""
    if args.dataroot is None:
        scenes = embedded_scenes(args.split)
    else:
        scenes = load_nuscenes(args.dataroot, args.version, args.split)
    rows = [f"| {' | '.join(scene_row(scene))} |" for scene in scenes]
    head = ["| scene | location | seconds | agents | vehicles |", "|---|---|---|---|---|"]
    print(align("\n".join(head + rows)), end="")
    return 0
