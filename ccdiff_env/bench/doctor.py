"""``ccdiff-env doctor``: what is installed, and whether it works on this machine."""

from __future__ import annotations

import argparse
import importlib
import os
import platform
import time
from importlib import metadata
from pathlib import Path

import numpy as np

from ccdiff_env.bench.provenance import processor
from ccdiff_env.envs import make_vec
from ccdiff_env.errors import CcdiffError
from ccdiff_env.scenes import cache_directory
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import coverage, load
from ccdiff_env.system.table import Table
from ccdiff_env.system.terminal import say
from ccdiff_env.system.version import __version__

#: Packages of the extras that are of interest, and what they are for.
PACKAGES = {
    "numpy": "worlds", "gymnasium": "worlds", "torch": "networks on a GPU, training",
    "stable-baselines3": "egos of PPO", "pettingzoo": "several egos", "matplotlib": "plots",
    "pillow": "images", "imageio-ffmpeg": "MP4",
}  # fmt: skip
MEASURED_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Print a table; the status is 1 where the world does not work."""
    rows = [
        ("ccdiff-env", f"{__version__}, in {Path(__file__).parents[1]}"),
        ("Python", platform.python_version()),
        ("system", f"{platform.system()} {platform.machine()}"),
        ("processor", f"{processor()}, {os.cpu_count()} cores"),
    ]
    for name, what in PACKAGES.items():
        try:
            rows.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            rows.append((name, f"not installed ({what})"))
    rows.append(("GPU", _gpu()))
    cache = cache_directory() or "none, as you have no home"
    rows.append(("cache", f"{cache} (CCDIFF_CACHE names another)"))
    status = 0
    for name, check in (("networks", _networks), ("scenes", lambda: _scenes(args)),
                        ("a world", _speed)):  # fmt: skip
        try:
            rows.append((name, check()))
        except (CcdiffError, ImportError, OSError) as error:
            rows.append((name, f"FAILS: {error}"))
            status = 1
    say(str(Table(["what", "found"], rows)))
    return status


def _gpu() -> str:
    try:
        torch = importlib.import_module("torch")
    except ImportError:
        return "none seen: torch is not installed"
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if not count:
        return f"none that torch {torch.__version__} can use"
    return ", ".join(f"cuda:{i} {torch.cuda.get_device_name(i)}" for i in range(count))


def _networks() -> str:
    from ccdiff_env.models import needs_torch, shipped_weights

    torch = "needs torch" if needs_torch(shipped_weights()) else "no torch needed"
    return f"CCDiff plans, {torch}"


def _scenes(args: argparse.Namespace) -> str:
    place = place_from(args)
    return f"{place}: {coverage(place, load(place).names)}"


def _speed() -> str:
    """Steps a second of one world with IDM traffic."""
    env = make_vec(1, traffic="idm")
    env.reset(seed=0)
    actions = np.zeros(env.action_space.shape or (), np.float32)
    steps, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < MEASURED_S:
        env.step(actions)
        steps += 1
    env.close()
    return f"{steps / passed:,.0f} steps a second in IDM traffic"
