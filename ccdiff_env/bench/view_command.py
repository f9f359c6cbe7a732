"""``ccdiff-env view``: what the verb does."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from ccdiff_env.bench.methods import titled
from ccdiff_env.bench.planners import TRAFFIC, TRAFFIC_HELP, drive, usual_window
from ccdiff_env.bench.run import add_weights, weights_from
from ccdiff_env.bench.verify import replayed
from ccdiff_env.errors import ConfigError
from ccdiff_env.planners.built_in import EGO_HELP
from ccdiff_env.record.counterfactual import with_rescue
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.system.files import file_name, write_aside, writing
from ccdiff_env.system.terminal import say_page
from ccdiff_env.traffic import NETWORKS
from ccdiff_env.view import render
from ccdiff_env.view.captions import DRIVER_TITLES, planner_title
from ccdiff_env.view.graph import graph_svg
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.link import MAX_CRITICALITY, is_drive
from ccdiff_env.view.page import write_page
from ccdiff_env.view.sources import LOG, find_rollout, find_scene
from ccdiff_env.view.video import Video, save_video, side_by_side

#: Options that play a scene, and those of images and videos, with their defaults.
PLAYED: dict[str, Any] = {
    **dict.fromkeys(("driver", "seed", "criticality", "samples", "weights", "save")),
    "slider": False,
}
DRAWN: dict[str, Any] = {
    **dict.fromkeys(("step", "follow", "size", "show")),
    "span": 90.0,
    "theme": "light",
}
LEVELS = [0.25 * k for k in range(9)]  #: Criticalities under a slider.
IMAGES = ("png", "svg", "gif", "mp4")  #: Suffixes of images and videos.
Runs = tuple[list[Rollout], list[str]]  #: Runs, and their titles.


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "what",
        nargs="+",
        metavar="RUN_OR_SCENE",
        help="rollout file, folder of rollouts, run folder of bench planners (with "
        "--scene), name of a scene, or link of the playground; several are shown in a grid",
    )
    parser.add_argument(
        "--scene",
        metavar="NAME",
        help="scene of a run of bench planners, whose episodes are played again, bit for bit: "
        "those of --planner and --traffic (default: all planners, in the traffic and with the "
        "seed in which the first one scores least)",
    )
    parser.add_argument(
        "--own-code",
        action="store_true",
        help="with --scene: run the code of custom planners and traffic of a run folder, which you "
        "trust, so that planners show what they meant to do (default: recorded actions alone)",
    )
    parser.add_argument(
        "--compare",
        nargs="+",
        default=[],
        metavar="RUN_OR_SCENE",
        help='files or scenes to show beside it; "log" for the log of its scene (default: nothing)',
    )
    parser.add_argument(
        "-o", "--out", type=Path, help="page or folder to write (default: named by the scene)"
    )
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    add_scene_arguments(parser)
    play = parser.add_argument_group("simulating a scene first")
    play.add_argument(
        "--traffic",
        nargs="+",
        help=f"simulate the scene as bench planners of it alone, in this traffic: {TRAFFIC_HELP}; "
        "several are shown beside each other (default: the log is shown)",
    )
    play.add_argument(
        "--driver",
        "--planner",
        nargs="+",
        help=f"{EGO_HELP}; several are shown beside each other (default: idm; replay where "
        "--compare has the log, so that the traffic alone differs)",
    )
    add_weights(play)
    play.add_argument("--seed", type=int, help="seed of the episode (default: 0)")
    play.add_argument(
        "--criticality",
        type=float,
        nargs="+",
        help="0: realistic traffic of a network; 1: critical; several are shown beside each other "
        "(default: that of --traffic)",
    )
    play.add_argument(
        "--samples",
        type=int,
        help="futures that a network draws for each plan, all of them shown (default: 1, as the "
        "benchmark does; another number is another episode)",
    )
    play.add_argument(
        "--slider",
        action="store_true",
        help="one run at a time, chosen by a slider (criticality: 0, 0.25 ... 2 by default)",
    )
    play.add_argument(
        "--save", type=Path, help="save the episode in this file (.npz; default: not saved)"
    )
    draw = parser.add_argument_group(
        "an image or a video instead of a page, if --out ends in .png, .svg, .gif or .mp4"
    )
    draw.add_argument(
        "--step", type=int, help="step of an image (default: the accident, or the middle)"
    )
    draw.add_argument("--follow", metavar="NAME", help="agent in the middle (default: the ego)")
    draw.add_argument(
        "--show",
        choices=("graph",),
        help="draw the causal graph of the plan, ranks and moved metres too; of an SVG "
        "(default: not drawn)",
    )
    draw.add_argument("--span", type=float, help="metres across an image")
    draw.add_argument(
        "--size",
        type=int,
        help="side of each image in pixels (default: 720; of a GIF 480, and 360 side by side)",
    )
    draw.add_argument("--theme", choices=render.THEMES, help="background of an image")
    parser.set_defaults(**PLAYED, **DRAWN)


def run(args: argparse.Namespace) -> int:
    """Write what the arguments ask for; print its path."""
    args.what, *others = args.what
    if others and args.traffic is not None:
        raise ConfigError("--traffic plays one scene: show others beside it with --compare")
    args.compare = others + args.compare
    folder = Path(args.what)
    if args.scene is None and not is_drive(args.what) and folder.is_dir():
        return _folder(args, folder)
    suffix = "html" if args.out is None else args.out.suffix.lower().lstrip(".")
    if suffix not in ("html", "htm", "", *IMAGES):
        listed = ", ".join(f".{name}" for name in ("html", *IMAGES))
        raise ConfigError(f"--out is {args.out}, expected a file that ends in {listed}")
    plays = args.scene is not None or args.traffic is not None or is_drive(args.what)
    if args.scene is None and args.traffic is None:
        unfit = {name: PLAYED[name] for name in PLAYED if name != "save" or not plays}
        _refuse(args, unfit, "plays a scene: give --traffic, too")
    if suffix not in IMAGES:
        _refuse(args, DRAWN, "goes with an image: --out that ends in .png, .svg, .gif or .mp4")
    elif args.open:
        raise ConfigError("--open shows pages, not images")
    if args.slider and (suffix in IMAGES or args.compare):
        raise ConfigError("--slider is for a page of runs that are played, without --compare")
    if args.scene is not None:
        runs, titles = _of_run(args, folder)
    elif args.traffic is not None:
        runs, titles = _played(args)
    else:
        runs, titles = _found(args, args.what)
    for word in args.compare:
        found, named = _found(args, word, like=runs[0])
        runs, titles = runs + found, titles + named
    if args.save is not None:
        runs[0].save(args.save)
    if plays:
        runs = [with_rescue(run) for run in runs]
    out = args.out or Path(file_name(runs[0].scene.name, ".html"))
    if suffix in IMAGES:
        _image(args, runs, titles if len(runs) > 1 else [runs[0].scene.name], out, suffix)
        print(out)
        return 0
    shown = titles if len(runs) > 1 else None
    write_page(runs[0], out, compare=runs[1:], titles=shown, slider=args.slider)
    say_page(out, open_it=args.open)
    return 0


def _refuse(args: argparse.Namespace, options: Mapping[str, Any], why: str) -> None:
    """Refuse options that are not their defaults."""
    for name, default in options.items():
        if getattr(args, name) != default:
            raise ConfigError(f"--{name} {why}")


def _found(args: argparse.Namespace, word: str, like: Rollout | None = None) -> Runs:
    title = "your drive" if is_drive(word) else word
    if Path(word).is_file():
        title = Path(word).stem
    return [find_rollout(word, place_from(args), like=like)], [title]


def _of_run(args: argparse.Namespace, path: Path) -> Runs:
    unfit = {name: PLAYED[name] for name in ("criticality", "samples", "save", "slider")}
    _refuse(args, unfit, "simulates a scene: a run has its episodes")
    found = replayed(
        path,
        args.scene,
        planners=args.driver or (),
        traffic=args.traffic or (),
        seed=args.seed,
        dataroot=None if args.scenes is None else place_from(args).path,
        own_code=args.own_code,
    )
    return [rollout for _, rollout in found], [title for title, _ in found]


def _played(args: argparse.Namespace) -> Runs:
    weights = weights_from(args.weights or [])
    if Path(args.what).is_file():
        raise ConfigError(f"{args.what} is an episode already: --traffic plays a scene")
    drivers = titled(args.driver or ["replay" if LOG in args.compare else "idm"])
    levels = args.criticality or (LEVELS if args.slider else [])
    for level in levels:
        if not 0.0 <= level <= MAX_CRITICALITY:
            raise ConfigError(f"--criticality is {level:g}, expected 0 to {MAX_CRITICALITY:g}")
    given = {"criticality": any(levels), "samples": args.samples}
    for traffic, (name, value) in product(args.traffic, given.items()):
        if value and not {TRAFFIC[traffic].driver, *drivers} & set(NETWORKS):
            raise ConfigError(f"--{name} guides networks, but --traffic is {traffic}")
    choices = list(product(args.traffic, drivers, levels or [None]))
    if args.save is not None and len(choices) > 1:
        raise ConfigError(
            "--save keeps one episode: give one --traffic, one --driver and one --criticality"
        )
    place = place_from(args)
    scene, runs, titles = find_scene(args.what, place), [], []
    alone, window, seed = SceneSet([scene]), usual_window(scene, place.window), args.seed or 0
    for traffic, driver, level in choices:
        asked = {"criticality": level, "num_samples": args.samples}
        changed = {name: value for name, value in asked.items() if value is not None}
        chosen = TRAFFIC[traffic].with_weights(weights)
        guided = replace(chosen, ccdiff={**chosen.ccdiff, **changed})
        played = drive(alone, driver, guided, seed=seed, options=window, record=[scene.name])
        runs.append(played[1][scene.name])
        named = len(args.traffic) > 1 or len(choices) == 1
        parts = [DRIVER_TITLES.get(traffic, chosen.label)] if named else []
        parts += [f"criticality {level:g}"] if len(levels) > 1 or level else []
        parts += [f"driven by {planner_title(driver)}"] if len(drivers) > 1 else []
        titles.append(", ".join(parts))
    return runs, titles


def _folder(args: argparse.Namespace, folder: Path) -> int:
    if (folder / "run.json").is_file() and not any(folder.rglob("*.npz")):
        raise ConfigError(f"{folder} keeps no rollouts: give --scene of its episodes")
    unfit = PLAYED | DRAWN | {"traffic": None, "compare": []}
    _refuse(args, unfit, "does not go with a folder, which gives pages")
    say_page(write_pages(folder, args.out or folder / "replays"), open_it=args.open)
    return 0


def _image(
    args: argparse.Namespace, runs: list[Rollout], titles: list[str], out: Path, kind: str
) -> None:
    pixels = args.size
    if pixels is None:
        pixels = (360 if len(runs) > 1 else 480) if kind == "gif" else 720
    options: dict[str, Any] = {
        "size": (pixels, pixels),
        "span_m": args.span,
        "follow": args.follow,
        "theme": args.theme,
    }
    videos = [Video(run, title=t, **options) for run, t in zip(runs, titles, strict=True)]
    if kind in ("gif", "mp4"):
        if args.step is not None:
            raise ConfigError(f"--step is of an image, but --out is {out}")
        save_video(videos, out)
        return
    if args.show is not None and kind != "svg":
        raise ConfigError(f"--show is of an SVG, but --out is {out}")
    step = videos[0].moment if args.step is None else args.step
    if kind == "png":
        videos[0].frame(step)  # says what is wrong with the step
        image = render.pillow().fromarray(side_by_side(videos, step))
        with writing(out):
            image.save(out)
    elif len(videos) > 1:
        raise ConfigError("an SVG shows one run: write each by itself")
    elif args.show == "graph":
        options["title"] = titles[0]
        write_aside(out, graph_svg(runs[0], step, **options))
    else:
        write_aside(out, videos[0].svg(step))
