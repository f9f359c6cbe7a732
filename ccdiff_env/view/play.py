"""``ccdiff-env play``: one HTML file in which one drives the ego by keys, without a server."""

from __future__ import annotations

import argparse
import base64
import html
import json
import os
import zlib
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from ccdiff_env import _native, planners
from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.models import shipped_weights
from ccdiff_env.planners import EgoPolicy
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import DEFAULT, load
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.tensors import tensor_bytes
from ccdiff_env.system.terminal import say_page
from ccdiff_env.traffic import KINDS, NETWORKS
from ccdiff_env.view import page
from ccdiff_env.view.contact import AHEAD_M, BLOCKED_S, WAITS_MPS
from ccdiff_env.view.link import HORIZON_STEPS, LIT, TRAFFIC, top_speed_mps, way, world_config
from ccdiff_env.view.outcome import PASSES_MPS, WAITED_M, WORDS
from ccdiff_env.view.pack import pack
from ccdiff_env.view.page import look, part
from ccdiff_env.view.sources import log_rollout, play_scene

#: Embedded scenes of the page: the first nine that ``python -m tools.playground`` lists, in which
#: criticality decides for a driver who only steers. In the first one the ego is hit.
SCENES = (
    "double-left-00", "double-left-02", "hard-brake-04", "double-left-01", "cut-in-02",
    "cut-in-00", "free-curve-00", "queue-01", "queue-00",
)  # fmt: skip
#: Simulator and networks as WebAssembly, which `make playground` compiles.
MODULE = Path(str(files("ccdiff_env").joinpath("data/playground.wasm")))
#: Scripts of the replay page that this one uses: all but its start.
SCRIPTS = (*(name for name in page.SCRIPTS if name != "main.js"), "contact.js", "drive.js")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument(
        "names",
        nargs="*",
        metavar="SCENE",
        help="scenes to drive in (default: ten embedded ones, or all of --scenes)",
    )
    add_scene_arguments(parser)
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("playground.html"), help="page to write"
    )
    parser.add_argument("--open", action="store_true", help="open the page in the browser")


def run(args: argparse.Namespace) -> int:
    """Write the page; print its path."""
    place = place_from(args)
    own = args.names or args.scenes is not None or args.limit is not None
    write_playground(args.out, load(place, names=args.names or None) if own else None)
    say_page(args.out, open_it=args.open)
    return 0


def write_playground(path: Path, scenes: Sequence[Scene] | None = None) -> None:
    """Write the page of some scenes, :data:`SCENES` by default.

    A module that was not compiled is a :class:`MissingFeatureError`.
    """
    if not MODULE.exists():
        raise MissingFeatureError(
            "the playground needs the world as WebAssembly, which this installation does not have: "
            "in a clone, `make playground` compiles it"
        )
    write_aside(path, playground_html(MODULE.read_bytes(), scenes))


def playground_html(module: bytes, scenes: Sequence[Scene] | None = None) -> str:
    """Return the page of some scenes, :data:`SCENES` and :data:`LIT` by default, as HTML that needs
    nothing else; the module is WebAssembly, as ``tools.playground`` compiles it.
    """
    if scenes is None:
        scenes = [*load(DEFAULT, names=SCENES), *load(f"{DEFAULT}/city-lights", names=[LIT])]
    ego = planners.load_ego("ego")
    settings = {
        **look(),
        # places of the drivers that every world has; the next is that of the network
        "policies": [name for name, kind in KINDS.items() if kind.always],
        "columns": [column["name"] for column in json.loads(_native.schema("columns"))],
        "words": WORDS,
        "most": {
            "steps": HORIZON_STEPS,
            "waits": WAITS_MPS,
            "passes": PASSES_MPS,
            "ahead": AHEAD_M,
            "blocked": BLOCKED_S,
            "waited": WAITED_M,
        },
        "traffic": TRAFFIC,
        "configs": _configs(ego),
        "held": ego.config.decision_steps,
    }
    site = os.environ.get("SITE_URL", "").removesuffix("/")
    parts = {
        "title": "ccdiff-env playground",
        "site": html.escape(f"{site}/" if site else "", quote=True),
        "style": part("page.css") + part("drive.css"),
        "settings": page.as_json(settings),
        "module": _packed(module),
        "weights": "\n".join(
            f'<script class="weights" type="text/plain">{_packed(each.read_bytes())}</script>'
            # of one step where they denoise
            for name in TRAFFIC
            if name in NETWORKS
            for each in [shipped_weights(name, one_step=KINDS[name].denoises)]
        ),
        "ego": _packed(tensor_bytes(ego.tensors, {})),
        "engine": part("wheel.js") + part("engine.js"),
        "scenes": "\n".join(map(_scene, scenes)),
        "script": "\n".join(map(part, SCRIPTS)),
    }
    return page.filled_page("drive.html", parts, " 'wasm-unsafe-eval'; worker-src blob:")


def _configs(ego: EgoPolicy) -> dict[str, Any]:
    """Configurations by traffic, and those of the trained ego; no network but that of traffic."""
    found = {}
    for traffic in TRAFFIC:
        config = world_config(traffic, 1.0)
        fitting = ego.config.with_options(decision_steps=1)
        trained = replace(config, observation=fitting.observation, action=fitting.action)
        for suffix, each in {"": config, "_trained": trained}.items():
            options = json.loads(each.to_json())
            networks = {n: p for n, p in options["named_drivers"].items() if n == traffic}
            found[traffic + suffix] = {**options, "named_drivers": networks}
    return found


def _scene(scene: Scene) -> str:
    """Elements of a scene: its recording, and its bytes."""
    config = world_config("replay").with_options(terminate_at_goal=False, on_collision="ignore")
    played = play_scene(scene, traffic="replay", driver="replay", config=config)
    return "\n".join(
        f'<script class="{kind}" data-scene="{html.escape(scene.name, quote=True)}" '
        f'data-top="{top_speed_mps(scene)}" data-way="{page.as_json(way(scene))}" '
        f'type="text/plain">{text}</script>'
        for kind, text in (
            ("run", pack(log_rollout(scene, like=played), scene.name)),
            ("bytes", _packed(scene.to_bytes())),
        )
    )


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()
