"""``ccdiff-env train``: training of a planning network."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import SOURCES, coverage, load, title
from ccdiff_env.system.settings import check_least
from ccdiff_env.system.terminal import counted
from ccdiff_env.traffic import KINDS, NETWORKS

#: Places on a route that a network sees, metres ahead: as far as a plan of 5 s may lead in a town.
ROUTE_POINTS_M = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser, "train")
    names = ", ".join(name for name in NETWORKS if not KINDS[name].distilled)
    parser.add_argument("--model", default="ccdiff", help=f"network, of: {names}")
    parser.add_argument(
        "--preset", default="fast", choices=["fast", "paper"], help="size of the network"
    )
    parser.add_argument("--out", required=True, type=Path, help="folder of the run")
    parser.add_argument(
        "--teacher",
        type=Path,
        help="weights of a teacher, to be distilled into one step (default: learn from the data)",
    )
    parser.add_argument("--start", type=Path, help="initial weights (default: random ones)")
    parser.add_argument(
        "--routes",
        action="store_true",
        help="give CCDiff the routes of vehicles, in training with probability 0.5",
    )
    length = parser.add_mutually_exclusive_group(required=True)
    length.add_argument(
        "--steps",
        type=int,
        help="training steps in total; a finished run with fewer continues, with a new cycle of "
        "the learning rate",
    )
    length.add_argument("--minutes", type=float, help="minutes to train in this call")
    parser.add_argument("--device", default="cpu", help="where torch computes: cpu, cuda, cuda:N")
    parser.add_argument("--batch-scenes", type=int, help="scenes per step (default: the preset's)")
    parser.add_argument(
        "--learning-rate", type=float, help="peak learning rate of Adam (default: the preset's)"
    )
    parser.add_argument("--seed", type=int, help="seed of weights and batches (default: 0)")
    parser.add_argument(
        "--hold-out-every", type=int, default=16, help="keep every n-th scene for validation"
    )
    parser.add_argument("--threads", type=int, default=1, help="threads of torch on the CPU")
    parser.add_argument("--quiet", action="store_true", help="print no progress")


def run(args: argparse.Namespace) -> int:
    """Train, and print where the weights are."""
    from ccdiff_env.models import require_networks
    from ccdiff_env.training.networks import train

    place = place_from(args)
    source = SOURCES[place.source]
    known = {} if source.splits is None else source.splits()
    kept_out = {name for split in source.kept_out for name in known[split]}
    check_least(args, hold_out_every=2, threads=1)
    require_networks()
    import torch

    torch.set_num_threads(args.threads)
    loaded = load(place, kinds=["vehicle"])
    scenes = [scene for scene in loaded if scene.name not in kept_out]
    if left := len(loaded) - len(scenes):
        splits = " and ".join(source.kept_out)
        said = f"{counted(left, 'scene')} of {splits} kept out of training, {len(scenes)} remain"
        if not scenes:
            raise ConfigError(said)
        print(said, file=sys.stderr)
    held_out = scenes[args.hold_out_every // 2 :: args.hold_out_every]
    names = {scene.name for scene in held_out}
    settings = {
        "batch_scenes": args.batch_scenes,
        "learning_rate": args.learning_rate,
        "seed": args.seed,
    }
    network: dict[str, Any] = {}
    if args.routes:
        network["route_points_m"] = ROUTE_POINTS_M
        settings["drop_route"] = 0.5
    weights = train(
        [scene for scene in scenes if scene.name not in names],
        out=args.out,
        held_out=held_out,
        model=args.model,
        preset=args.preset,
        steps=args.steps,
        minutes=args.minutes,
        device=args.device,
        teacher=args.teacher,
        start=args.start,
        network=network,
        settings={key: value for key, value in settings.items() if value is not None},
        notes={"data": title(place, coverage(place, loaded.names))},
        progress=not args.quiet,
    )
    print(weights)
    return 0
