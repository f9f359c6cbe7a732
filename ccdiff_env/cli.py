"""The command line: ``ccdiff-env <verb>``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ccdiff_env.bench.cli import add_bench
from ccdiff_env.errors import CcdiffError, ConfigError
from ccdiff_env.version import __version__


class _Help(argparse.HelpFormatter):
    """Help that shows defaults, where there are any to show."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        shown = action.default not in (None, False, [], argparse.SUPPRESS) and action.option_strings
        return f"{action.help or ''} (default: %(default)s)" if shown else action.help


def _show_defaults(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = _Help
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                _show_defaults(verb)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; return the exit status."""
    parser = argparse.ArgumentParser(prog="ccdiff-env", description=__doc__)
    parser.add_argument("--version", action="version", version=f"ccdiff-env {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    _add_train(verbs)
    add_bench(verbs)
    _add_rollout(verbs)
    _add_view(verbs)
    _add_scenes(verbs)
    _add_play(verbs)
    _add_live(verbs)
    _show_defaults(parser)
    args = parser.parse_args(argv)
    try:
        status: int = args.run(args)
    except (CcdiffError, OSError) as error:
        print(f"ccdiff-env {args.verb}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return status


def _add_train(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = verbs.add_parser(
        "train", help="train a planning network on nuScenes (resumes a run in --out)"
    )
    parser.add_argument("--dataroot", required=True, type=Path, help="folder of nuScenes")
    parser.add_argument("--version", default="v1.0-trainval", help="folder of the tables")
    parser.add_argument(
        "--split", nargs="+", default=["train", "train_val"], help="splits to train on"
    )
    parser.add_argument("--model", default="ccdiff", help="ccdiff or one of its rivals")
    parser.add_argument("--preset", default="fast", choices=["fast", "paper"])
    parser.add_argument("--out", required=True, type=Path, help="folder of the run")
    length = parser.add_mutually_exclusive_group(required=True)
    length.add_argument("--steps", type=int, help="training steps in all")
    length.add_argument("--minutes", type=float, help="minutes of this call")
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--batch-scenes", type=int, help="scenes per step")
    parser.add_argument("--learning-rate", type=float)
    parser.add_argument("--seed", type=int)
    parser.add_argument(
        "--hold-out-every", type=int, default=16, help="keep every n-th scene for validation"
    )
    parser.add_argument("--threads", type=int, default=1, help="threads of torch on the CPU")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=_train)


def _train(args: argparse.Namespace) -> int:
    import torch

    from ccdiff_env.models import train
    from ccdiff_env.scenes import load_nuscenes, splits

    kept_out = {*splits()["val"], *splits()["mini_val"]}
    if args.hold_out_every < 2:
        raise ConfigError(f"--hold-out-every is {args.hold_out_every}, expected at least 2")
    torch.set_num_threads(args.threads)
    scenes = [
        scene
        for scene in load_nuscenes(args.dataroot, args.version, args.split, kinds=["vehicle"])
        if scene.name not in kept_out
    ]
    held_out = scenes[args.hold_out_every // 2 :: args.hold_out_every]
    names = {scene.name for scene in held_out}
    settings = {
        "batch_scenes": args.batch_scenes,
        "learning_rate": args.learning_rate,
        "seed": args.seed,
    }
    weights = train(
        [scene for scene in scenes if scene.name not in names],
        out=args.out,
        held_out=held_out,
        model=args.model,
        preset=args.preset,
        steps=args.steps,
        minutes=args.minutes,
        device=args.device,
        settings={key: value for key, value in settings.items() if value is not None},
        notes={"data": f"nuScenes {args.version}", "splits": list(args.split)},
        progress=not args.quiet,
    )
    print(weights)
    return 0


def _add_rollout(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from ccdiff_env.view import rollouts

    parser = verbs.add_parser("rollout", help="draw closed-loop samples of scenes and render them")
    rollouts.add_arguments(parser)
    parser.set_defaults(run=rollouts.run)


def _add_view(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from ccdiff_env.view import command

    parser = verbs.add_parser("view", help="write a replay page, a picture or a film")
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _add_scenes(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from ccdiff_env.view import listing

    parser = verbs.add_parser("scenes", help="list the scenes that can be played and shown")
    listing.add_arguments(parser)
    parser.set_defaults(run=listing.run)


def _add_play(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from ccdiff_env.view import play

    parser = verbs.add_parser("play", help="play scenes again with other settings, in the browser")
    play.add_arguments(parser)
    parser.set_defaults(run=play.run)


def _add_live(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from ccdiff_env.view import live

    parser = verbs.add_parser("live", help="watch a training: its curves and its newest replay")
    live.add_arguments(parser)
    parser.set_defaults(run=live.run)


if __name__ == "__main__":
    raise SystemExit(main())
