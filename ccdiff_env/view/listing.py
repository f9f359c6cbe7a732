"""``ccdiff-env scenes``: which scenes there are to play and to look at."""

from __future__ import annotations

import argparse
from pathlib import Path

from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.scenes import load_nuscenes
from ccdiff_env.terminal import align
from ccdiff_env.view.notebook import scene_row


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("--dataroot", type=Path, help="folder of nuScenes; else embedded scenes")
    parser.add_argument("--version", default="v1.0-mini", help="folder of the tables")
    parser.add_argument(
        "--split", help="split (mini_val; of the embedded scenes: val); all without"
    )


def run(args: argparse.Namespace) -> int:
    """Print a table of the scenes."""
    if args.dataroot is None:
        scenes = embedded_scenes(args.split) if args.split else embedded_scenes()
    else:
        scenes = load_nuscenes(args.dataroot, args.version, args.split)
    rows = [f"| {' | '.join(scene_row(scene))} |" for scene in scenes]
    head = ["| scene | location | seconds | agents | vehicles |", "|---|---|---|---|---|"]
    print(align("\n".join(head + rows)), end="")
    return 0
