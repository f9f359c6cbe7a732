"""``ccdiff-env live``: the curves and the newest replay of a run while it goes on."""

from __future__ import annotations

import argparse
import csv
import html
import io
import itertools
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ccdiff_env.errors import DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import DEFAULT, load
from ccdiff_env.system.files import read_text
from ccdiff_env.view.page import local_html, page_html
from ccdiff_env.view.server import LocalServer
from ccdiff_env.view.sources import find_scene, play_scene

__all__ = ["LiveRun", "read_curves"]

MAX_POINTS = 400
MAX_CURVES = 16
MAX_BYTES = 20_000_000
#: Columns that count along; the first of them that a file has is the horizontal axis.
ALONG = ("step", "steps", "time/total_timesteps", "timesteps", "epoch")
#: Suffixes of episodes, networks and egos.
PLAYED = ("npz", "safetensors", "zip")
#: What is looked at first, by a part of the name.
FIRST = ("success", "return", "rew", "collision", "loss", "ade", "entropy")
#: Column of words: where they change, curves of its file have a mark.
PHASE = "phase"
#: Columns that say nothing.
DULL = ("second", "time/", "fps", "iteration", "n_updates", "learning_rate", "clip_range")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("folder", metavar="RUN", type=Path, help="folder that a training writes")
    parser.add_argument(
        "--scene", help="scene that saved networks and policies play (default: the first)"
    )
    add_scene_arguments(parser)
    parser.add_argument("--port", type=int, default=0, help="port of 127.0.0.1; 0: a free one")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")


def run(args: argparse.Namespace) -> int:
    """Serve the page until interrupted."""
    if not args.folder.is_dir():
        raise DatasetNotFoundError(f"no folder of a run at {args.folder}")
    place = place_from(args)
    scene = load(place)[0] if args.scene is None else find_scene(args.scene, place)
    LocalServer(LiveRun(args.folder, scene).answers, args.port).run(open_it=args.open)
    return 0


@dataclass
class LiveRun:
    """A folder that a training writes.

    Its newest replay is the newest of the recorded episodes (``.npz``), and of saved networks
    (``weights.safetensors`` of ``ccdiff-env train``) and egos (other ``.safetensors``, ``.zip`` of
    stable-baselines3), which play the scene.

    Parameters
    ----------
    folder
        Where.
    scene
        What saved networks and egos play.
    """

    folder: Path
    scene: Scene = field(default_factory=lambda: load(DEFAULT)[0])

    @property
    def answers(self) -> dict[str, Any]:
        """Answers by path, for :class:`~ccdiff_env.view.server.LocalServer`."""
        return {"/": self.page, "/state": self.state, "/replay": self.replay}

    def page(self, words: Mapping[str, str]) -> str:
        """Return the page around curves and replay."""
        return local_html("live", {"name": html.escape(self.folder.name or str(self.folder))})

    def state(self, words: Mapping[str, str]) -> dict[str, Any]:
        """Return curves, the key of the newest replay, and a line on both."""
        newest = self._newest()
        times = [_changed(path) for path in self.folder.rglob("*") if path.is_file()]
        ago = f"written {time.time() - max(times):.0f} s ago" if times else "nothing is written yet"
        name, key = "no replay yet", None
        if newest is not None:
            name = str(newest.relative_to(self.folder))
            key = f"{name}@{_changed(newest):.3f}"
        return {"curves": read_curves(self.folder), "replay": key, "line": f"{name} · {ago}"}

    def replay(self, words: Mapping[str, str]) -> str:
        """Return the page of the newest replay."""
        newest = self._newest()
        if newest is None:
            raise DatasetNotFoundError(f"no episode and no weights in {self.folder} yet")
        name = str(newest.relative_to(self.folder))
        return page_html(self._rollout(newest), titles=(name,))

    def _rollout(self, path: Path) -> Rollout:
        if path.suffix == ".npz":
            return Rollout.load(path)
        if path.name == "weights.safetensors":
            return play_scene(self.scene, ccdiff={"weights": str(path)})
        return play_scene(self.scene, driver=str(path))

    def _newest(self) -> Path | None:
        found = [path for kind in PLAYED for path in self.folder.rglob(f"*.{kind}")]
        kept = [path for path in found if path.name != "state.safetensors" and path.is_file()]
        return max(kept, key=_changed, default=None)


def _changed(path: Path) -> float:
    """When a file was written last; files that have gone are old."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def read_curves(folder: Path) -> list[dict[str, Any]]:
    """Return the curves of a run from its CSV files, those that matter first.

    Returns
    -------
    list of dict
        ``name``, ``along`` (name of the axis), ``x``, ``y``: at most 400 points, means of
        neighbours; ``marks``: places on the axis where the column ``phase`` changes, and to what.
    """
    curves = []
    for path in sorted(folder.rglob("*.csv")):
        texts = _columns(path)
        columns = {name: [_value(text) for text in column] for name, column in texts.items()}
        along = next((name for name in ALONG if name in columns), None)
        if along is None or _falls(columns[along]):  # a table of episodes is no curve
            continue
        marks = _changes(columns[along], texts.get(PHASE, []))
        for name, values in columns.items():
            if name == along or any(part in name for part in DULL):
                continue
            pairs = [
                (x, y)
                for x, y in zip(columns[along], values, strict=True)
                if math.isfinite(x) and math.isfinite(y)
            ]
            if len(pairs) > 1:
                x, y = _thinned(pairs)
                title = f"{path.stem}: {name}"
                unit = along.rpartition("/")[2].replace("_", " ")
                curves.append({"name": title, "along": unit, "x": x, "y": y, "marks": marks})
    curves.sort(key=lambda curve: _rank(str(curve["name"])))
    return curves[:MAX_CURVES]


def _falls(values: list[float]) -> bool:
    known = [value for value in values if math.isfinite(value)]
    return any(later < sooner for sooner, later in itertools.pairwise(known))


def _rank(name: str) -> tuple[int, str]:
    places = [i for i, part in enumerate(FIRST) if part in name]
    return min(places, default=len(FIRST)), name


def _changes(places: list[float], words: list[str]) -> list[tuple[float, str]]:
    """Where words change, and to what."""
    said = [(x, word) for x, word in zip(places, words, strict=False) if word]
    return [later for sooner, later in itertools.pairwise(said) if later[1] != sooner[1]]


def _columns(path: Path) -> dict[str, list[str]]:
    """Columns of a CSV file. A last line may be incomplete."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path, MAX_BYTES))))
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    if not rows:
        return {}
    head, body = rows[0], [row for row in rows[1:] if len(row) == len(rows[0])]
    return {name: [row[i] for row in body] for i, name in enumerate(head)}


def _value(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _thinned(pairs: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    size = math.ceil(len(pairs) / MAX_POINTS)
    groups = [pairs[i : i + size] for i in range(0, len(pairs), size)]
    return (
        [sum(x for x, _ in group) / len(group) for group in groups],
        [sum(y for _, y in group) / len(group) for group in groups],
    )
