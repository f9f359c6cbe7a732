"""``ccdiff-env rollout``: closed-loop samples of scenes, saved, drawn, and as pages."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ccdiff_env.errors import ConfigError
from ccdiff_env.policies.planners import EGO_HELP
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.files import file_name
from ccdiff_env.traffic import NETWORKS, driver_names
from ccdiff_env.view import render
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.sources import check_criticality, play_scene
from ccdiff_env.view.video import Video, save_video

#: Shares of an episode whose states are drawn.
SHOWN = (0.0, 0.35, 0.7, 1.0)
#: Options of networks, and what they are without being given.
NETWORK: dict[str, Any] = {"criticality": 0.0, "samples": 5, "weights": "fast"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "names", nargs="*", metavar="SCENE", help="names of scenes (default: all of the split)"
    )
    add_scene_arguments(parser, "test")
    parser.add_argument(
        "--traffic", default="ccdiff", help=f"the others, of: {', '.join(driver_names())}"
    )
    parser.add_argument("--driver", default="idm", help=EGO_HELP)
    parser.add_argument("--criticality", type=float, help="0: realistic; 1: guided")
    parser.add_argument("--weights", help='"fast", the shipped ones, or a safetensors file')
    parser.add_argument("--samples", type=int, help="samples per plan")
    parser.set_defaults(**NETWORK)
    parser.add_argument("--episodes", type=int, default=1, help="episodes per scene")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first episode")
    parser.add_argument("--out", required=True, type=Path, help="folder to write")
    parser.add_argument("--gif", action="store_true", help="a video of each episode, too")


def run(args: argparse.Namespace) -> int:
    """Play the scenes; write rollouts, images and pages; print the index."""
    settings = _settings(args)
    args.out.mkdir(parents=True, exist_ok=True)
    for scene in load(place_from(args), names=args.names or None):
        for k in range(args.episodes):
            rollout = play_scene(
                scene,
                traffic=args.traffic,
                driver=args.driver,
                seed=args.seed + k,
                ccdiff=settings,
                on_collision="ignore",
                on_off_road="ignore",
                terminate_at_goal=False,
            )
            name = file_name(f"{scene.name}-{args.seed + k}")
            rollout.save(args.out / f"{name}.npz")
            video = Video(rollout, size=(640, 640))
            for share in SHOWN:
                step = round(share * (rollout.num_steps - 1))
                render.save(video.frame(step), args.out / f"{name}-{step:03d}.png")
            if args.gif:
                save_video(rollout, args.out / f"{name}.gif", size=(480, 480))
            hits = len({(e.agent_id, e.partner_id) for e in rollout.collisions()}) // 2
            print(f"{name}: {rollout.num_steps - 1} steps, {hits} collisions")
    print(write_pages(args.out, args.out / "pages")[0])
    return 0


def _settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the networks that drive; refuse those that would mean nothing."""
    check_criticality(args.criticality)
    if {args.traffic, args.driver} & set(NETWORKS):
        return {
            "criticality": args.criticality,
            "num_samples": args.samples,
            "weights": args.weights,
        }
    for name, default in NETWORK.items():
        if getattr(args, name) != default:
            raise ConfigError(f"--{name} is for networks, but --traffic is {args.traffic}")
    return {}
