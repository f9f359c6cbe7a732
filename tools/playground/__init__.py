"""The playground: one HTML file in which one drives the ego by keys.

``python -m tools.playground docs/site/playground.html`` compiles `rust/wasm` to WebAssembly and
writes the page.
"""

from __future__ import annotations

import base64
import html
import json
import os
import subprocess
import zlib
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env import _native
from ccdiff_env.models import shipped_weights
from ccdiff_env.policies.ego import EgoPolicy, load_ego
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view import page
from ccdiff_env.view.captions import DRIVER_TITLES
from ccdiff_env.view.link import TRAFFIC, world_config
from ccdiff_env.view.outcome import AT_FAULT, COLLISIONS, STOPPED
from ccdiff_env.view.pack import pack
from ccdiff_env.view.page import colours, part
from ccdiff_env.view.sources import log_rollout, play_scene

TARGET = "wasm32-unknown-unknown"
#: IDM reaches its goal in realistic traffic of each, and is hit at criticality 2 in all but the
#: first: nobody is in its way there.
SCENES = (
    "pedestrians-00",
    "left-turn-02",
    "left-turn-01",
    "tee-crossing-01",
    "hard-brake-04",
    "pedestrians-03",
    "left-turn-05",
    "tee-crossing-04",
    "double-left-01",
    "merge-in-01",
)
#: Scripts of the replay page that this one uses: all but its start.
SCRIPTS = tuple(name for name in page.SCRIPTS if name != "main.js")
HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def target_is_installed() -> bool:
    """Return whether the compiler here can make WebAssembly."""
    try:
        found = subprocess.run(
            ["rustc", "--print", "sysroot"], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return False
    return (Path(found.stdout.strip()) / "lib" / "rustlib" / TARGET / "lib").is_dir()


def compiled() -> bytes:
    """Compile `rust/wasm`, with vectors of four numbers; return the module."""
    quick = {"LTO": "off", "CODEGEN_UNITS": "16"}
    env = {**os.environ, **{f"CARGO_PROFILE_RELEASE_{name}": v for name, v in quick.items()}}
    env["RUSTFLAGS"] = "-C target-feature=+simd128"
    words = ["cargo", "build", "-q", "--release", "--locked", "-p", "ccdiff-wasm"]
    subprocess.run([*words, "--target", TARGET], cwd=ROOT, env=env, check=True)
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return (folder / TARGET / "release" / "ccdiff_wasm.wasm").read_bytes()


def playground_html(module: bytes, scenes: Sequence[Scene] | None = None) -> str:
    """Return the page as HTML that needs nothing else.

    Parameters
    ----------
    module
        WebAssembly, as :func:`compiled` makes it.
    scenes
        What can be played; :data:`SCENES` by default.
    """
    if scenes is None:
        scenes = [embedded_scenes()[name] for name in SCENES]
    ego = load_ego(str(files("ccdiff_env").joinpath("data/ego.safetensors")))
    places, start = {}, 0
    for name, tensor in ego.tensors.items():
        places[name] = (start, tensor.size)
        start += tensor.size
    settings = {
        "colours": colours(),
        "drivers": DRIVER_TITLES,
        # places of the drivers that every world has; the next is that of the network
        "policies": ["replay", "constant_velocity", "idm"],
        "columns": [column["name"] for column in json.loads(_native.columns_json())],
        "collisions": {
            "at fault": AT_FAULT,
            "not at fault": {**COLLISIONS, "collision_front": STOPPED},
        },
        "traffic": TRAFFIC,
        "configs": _configs(ego),
        "ego": {
            "size": ego.size,
            "rows": (ego.rows.start, *ego.shape),
            "mask": ego.mask.start,
            "held": ego.config.decision_steps,
            "places": places,
        },
    }
    site = os.environ.get("SITE_URL", "").removesuffix("/")
    parts = {
        "site": html.escape(f"{site}/" if site else "", quote=True),
        "style": part("page.css") + (HERE / "drive.css").read_text(encoding="utf-8"),
        "settings": json.dumps(settings, separators=(",", ":")).replace("<", "\\u003c"),
        "module": _packed(module),
        "weights": "\n".join(
            f'<script class="weights" type="text/plain">{_packed(file.read_bytes())}</script>'
            for file in (shipped_weights(one_step=True), shipped_weights("tokens"))
        ),
        "ego": _packed(b"".join(np.ascontiguousarray(t).tobytes() for t in ego.tensors.values())),
        "engine": (HERE / "engine.js").read_text(encoding="utf-8"),
        "scenes": "\n".join(_scene(scene) for scene in scenes),
        "script": "\n".join([*map(part, SCRIPTS), (HERE / "drive.js").read_text(encoding="utf-8")]),
    }
    return page.filled_page((HERE / "drive.html").read_text(encoding="utf-8"), parts)


def _configs(ego: EgoPolicy) -> dict[str, Any]:
    """Configurations by traffic, and those of the rivals, with no network but that of traffic."""
    found = {}
    for traffic in TRAFFIC:
        config = world_config(traffic, 1.0)
        fitting = ego.config.with_options(decision_steps=1)
        trained = replace(config, observation=fitting.observation, action=fitting.action)
        rivals = {"_idm": config.with_options(driver="idm"), "_trained": trained}
        for suffix, each in {"": config, **rivals}.items():
            options = json.loads(each.to_json())
            networks = {n: p for n, p in options["policies"].items() if n == traffic}
            found[traffic + suffix] = {**options, "policies": networks}
    return found


def _scene(scene: Scene) -> str:
    """Elements of a scene: its recording, and its bytes."""
    config = world_config("replay").with_options(terminate_at_goal=False, on_collision="ignore")
    played = play_scene(scene, traffic="replay", driver="replay", config=config)
    return "\n".join(
        f'<script class="{kind}" data-scene="{html.escape(scene.name, quote=True)}" '
        f'type="text/plain">{text}</script>'
        for kind, text in (
            ("run", pack(log_rollout(scene, like=played), scene.name)),
            ("bytes", _packed(scene.to_bytes())),
        )
    )


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()
