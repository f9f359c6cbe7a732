"""``ccdiff-env train-ego``: the recipe of the shipped ego."""

from __future__ import annotations

import argparse
from pathlib import Path

from ccdiff_env.errors import ConfigError, MissingFeatureError
from ccdiff_env.scenes.arguments import add_scene_arguments
from ccdiff_env.system.settings import check_least
from ccdiff_env.traffic import EGOS, NETWORKS
from ccdiff_env.training.recipe import ASSISTED_NOISE, BANK, NOISE, RATE, traffic_options
from ccdiff_env.worlds.policy_file import LEARNED

#: Traffic of training; ``learned`` is CCDiff whose adversaries the shipped policy chooses.
TRAFFIC = ("replay", "idm", EGOS, LEARNED, *NETWORKS, BANK)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser, "train")
    parser.add_argument(
        "--more-scenes", metavar="SOURCE", help="further scenes, as --scenes (default: none)"
    )
    parser.add_argument(
        "--bank",
        nargs="*",
        type=Path,
        default=[],
        help="folders of recorded critical traffic (default: none)",
    )
    parser.add_argument(
        "--traffic",
        nargs="+",
        default=["replay"],
        help=f"traffic to train in, of: {', '.join(TRAFFIC)}; options as NAME?option=value",
    )
    parser.add_argument(
        "--criticality",
        type=float,
        help="maximum criticality of networks in --traffic whose options do not fix it; each "
        "episode samples one from 0 to it (default: 1)",
    )
    parser.add_argument(
        "--any-ego",
        action="store_true",
        help="sample the ego and the start of each episode, except in banks",
    )
    parser.add_argument(
        "--kl",
        type=float,
        default=0.0,
        help="weight of the KL divergence from the zero action, which is that of the base, if any",
    )
    parser.add_argument(
        "--dynamics",
        default="assisted",
        choices=("assisted", "unicycle", "bicycle"),
        help="dynamics of the ego",
    )
    parser.add_argument("--base", help="rule of assisted actions: idm or pdm (default: idm)")
    parser.add_argument("--decision-steps", type=int, default=3, help="simulation steps per action")
    parser.add_argument(
        "--worlds", type=int, default=1024, help="worlds, divided among kinds of traffic"
    )
    parser.add_argument(
        "--decisions", type=float, default=2e6, help="decisions in total, also when resumed"
    )
    parser.add_argument(
        "--learning-rate", type=float, default=RATE, help="initial learning rate of Adam"
    )
    parser.add_argument(
        "--noise",
        type=float,
        nargs=2,
        help="initial standard deviations of the two actions (default: the recipe's)",
    )
    parser.add_argument(
        "--shown",
        type=int,
        default=100_000,
        help="logged decisions that the policy first imitates, unless it is assisted",
    )
    parser.add_argument(
        "--long",
        action="store_true",
        help="for millions of decisions: a policy that drives in a mirror as without, the end of "
        "the road and how others turn and brake in sight, close calls and faults priced by speed",
    )
    parser.add_argument("--threads", type=int, default=2, help="threads of torch and worlds")
    parser.add_argument("--seed", type=int, default=0, help="seed of networks and worlds")
    parser.add_argument(
        "--start", help="checkpoint (.pt) or policy to begin with (default: random weights)"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/ego"), help="folder of the run")
    parser.add_argument("--smoke", action="store_true", help="a short test run")


def run(args: argparse.Namespace) -> int:
    """Train; print where the policy is."""
    unknown = [text for text in args.traffic if text.partition("?")[0] not in TRAFFIC]
    if unknown:
        raise ConfigError(f"--traffic is {unknown[0]!r}, expected some of {', '.join(TRAFFIC)}")
    guided = [text for text in args.traffic if "criticality" in traffic_options(text, 1.0)]
    if args.criticality is not None and not guided:
        raise ConfigError(f"--criticality: no traffic of {' '.join(args.traffic)} draws it")
    args.criticality = 1.0 if args.criticality is None else args.criticality
    if args.base is not None and args.dynamics != "assisted":
        raise ConfigError(f"--base is for assisted dynamics, not {args.dynamics}: leave it out")
    args.base = args.base or "idm"
    args.noise = args.noise or (ASSISTED_NOISE if args.dynamics == "assisted" else NOISE)
    check_least(args, threads=1, decisions=1, shown=0, learning_rate=1e-9, noise=1e-6, kl=0)
    if (BANK in args.traffic) != bool(args.bank):
        raise ConfigError(f"--traffic {BANK} and --bank FOLDER go together")
    try:
        from ccdiff_env.training.ppo import train
    except ModuleNotFoundError as error:
        raise MissingFeatureError(
            f"training needs {error.name}: pip install 'ccdiff-env[models]'"
        ) from None
    train(args)
    return 0
