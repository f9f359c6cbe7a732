"""``ccdiff-env view``: what the verb does."""

from __future__ import annotations

import argparse
from pathlib import Path

from ccdiff_env import render
from ccdiff_env.errors import ConfigError
from ccdiff_env.rollout import Rollout
from ccdiff_env.scenes import file_name
from ccdiff_env.view.facts import DRIVER_TITLES
from ccdiff_env.view.film import Film, save_film
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.page import write_page
from ccdiff_env.view.sources import LOG, SAMPLES, find_rollout, find_scene, play_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "what", metavar="RUN_OR_SCENE", help="file of a rollout, folder of them, or name of a scene"
    )
    parser.add_argument(
        "--compare", help='file or scene to show beside it; "log" for the log of its scene'
    )
    parser.add_argument("-o", "--out", type=Path, help="page to write, or folder of pages")
    parser.add_argument("--dataroot", type=Path, help="folder of nuScenes; else embedded scenes")
    parser.add_argument("--version", default="v1.0-mini", help="folder of the tables")
    parser.add_argument(
        "--traffic", help="play the scene first, with this traffic: ccdiff, idm, replay, ..."
    )
    parser.add_argument("--driver", default="idm", help="who drives the ego then")
    parser.add_argument("--seed", type=int, default=0, help="seed of that episode")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="samples per plan of CCDiff")
    parser.add_argument(
        "--criticality", type=float, default=0.0, help="0: realistic CCDiff traffic; 1: guided"
    )
    parser.add_argument("--save", type=Path, help="keep that episode in this file (.npz)")
    parser.add_argument("--png", type=int, metavar="STEP", help="write a picture of a step instead")
    parser.add_argument("--gif", action="store_true", help="write a GIF instead of a page")
    parser.add_argument("--mp4", action="store_true", help="write an MP4 instead of a page")
    parser.add_argument("--follow", metavar="ID", help="agent in the middle of pictures")
    parser.add_argument("--span", type=float, default=90.0, help="metres across a picture")
    parser.add_argument("--size", type=int, default=720, help="pixels of a picture's sides")
    parser.add_argument("--speed", type=float, default=1.0, help="pace of a film")
    parser.add_argument("--graph", action="store_true", help="draw the causal graph in pictures")


def run(args: argparse.Namespace) -> int:
    """Write what the arguments ask for; print its path."""
    asked = {"png": args.png is not None, "gif": args.gif, "mp4": args.mp4}
    kinds = [name for name, wanted in asked.items() if wanted]
    if len(kinds) > 1:
        raise ConfigError("give one of --png, --gif and --mp4")
    folder = Path(args.what)
    if folder.is_dir():
        return _folder(args, folder, kinds)
    rollout = _rollout(args)
    suffix = kinds[0] if kinds else "html"
    out = args.out or Path(file_name(rollout.scene.name, f".{suffix}"))
    if kinds:
        _picture(args, rollout, out)
    else:
        other = args.compare and find_rollout(
            args.compare, dataroot=args.dataroot, version=args.version, like=rollout
        )
        titles = (_title(args.traffic or args.what), _title(args.compare or ""))
        write_page(rollout, out, compare=other or None, titles=titles)
    print(out)
    return 0


def _rollout(args: argparse.Namespace) -> Rollout:
    if args.traffic is None:
        if args.save is not None:
            raise ConfigError("--save keeps an episode that is played: give --traffic too")
        return find_rollout(args.what, dataroot=args.dataroot, version=args.version)
    if Path(args.what).is_file():
        raise ConfigError(f"{args.what} is an episode already: --traffic plays a scene")
    scene = find_scene(args.what, dataroot=args.dataroot, version=args.version)
    rollout = play_scene(
        scene,
        traffic=args.traffic,
        driver=args.driver,
        seed=args.seed,
        ccdiff={"num_samples": args.samples, "criticality": args.criticality},
    )
    if args.save is not None:
        rollout.save(args.save)
    return rollout


def _title(word: str) -> str:
    """Short name of a run: its file's name without the suffix, the traffic's, else the word."""
    if word in DRIVER_TITLES:
        return DRIVER_TITLES[word]
    return Path(word).stem if Path(word).is_file() else word


def _folder(args: argparse.Namespace, folder: Path, kinds: list[str]) -> int:
    if kinds or args.traffic or args.compare not in (None, LOG):
        raise ConfigError('a folder gives pages; of the options only --compare "log" goes with it')
    out = args.out or folder / "replays"
    print(write_pages(folder, out, compare_log=args.compare == LOG)[0])
    return 0


def _picture(args: argparse.Namespace, rollout: Rollout, out: Path) -> None:
    size = (args.size, args.size)
    if args.png is not None:
        film = Film(rollout, size=size, span_m=args.span, follow=args.follow, graph=args.graph)
        render.save(film.frame(args.png), out)
        return
    save_film(
        rollout,
        out,
        speed=args.speed,
        size=size,
        span_m=args.span,
        follow=args.follow,
        graph=args.graph,
    )
