"""The playground: one HTML file in which one drives the ego by keys.

``python -m tools.playground docs/site/playground.html`` compiles `rust/wasm` to WebAssembly and
writes the page.
"""

from __future__ import annotations

import base64
import html
import json
import os
import re
import subprocess
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view import page
from ccdiff_env.view.captions import DRIVER_TITLES
from ccdiff_env.view.outcome import COLLISIONS
from ccdiff_env.view.pack import pack
from ccdiff_env.view.page import colours, part
from ccdiff_env.view.sources import log_rollout, play_scene

TARGET = "wasm32-unknown-unknown"
#: One of each kind in which the ego has far to go.
SCENES = (
    "left-turn-05",
    "tee-crossing-01",
    "cut-in-04",
    "hard-brake-03",
    "double-left-01",
    "merge-in-00",
    "free-curve-02",
    "pedestrians-00",
)
HORIZON_STEPS = 150
#: Traffic by name, as the page offers it.
TRAFFIC = {"idm": "IDM", "replay": "as recorded"}
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
    """Compile `rust/wasm`; return the module.

    One world is fast enough however it is compiled, so that this takes little time.
    """
    quick = {"OPT_LEVEL": "1", "LTO": "off", "CODEGEN_UNITS": "16"}
    env = {**os.environ, **{f"CARGO_PROFILE_RELEASE_{name}": v for name, v in quick.items()}}
    words = ["cargo", "build", "-q", "--release", "--locked", "-p", "ccdiff-wasm"]
    subprocess.run([*words, "--target", TARGET], cwd=ROOT, env=env, check=True)
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return (folder / TARGET / "release" / "ccdiff_wasm.wasm").read_bytes()


def world_config(traffic: str) -> WorldConfig:
    """Return the configuration that the page plays with."""
    return WorldConfig().with_options(
        traffic=traffic, horizon_steps=HORIZON_STEPS, autoreset="disabled"
    )


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
    settings = {
        "colours": colours(),
        "drivers": DRIVER_TITLES,
        # places of the drivers that every world has
        "policies": ["replay", "constant_velocity", "idm"],
        "columns": [column["name"] for column in json.loads(_native.columns_json())],
        "collisions": COLLISIONS,
        "traffic": TRAFFIC,
        "configs": {name: _for_the_page(world_config(name)) for name in TRAFFIC},
    }
    parts = {
        "style": part("page.css") + (HERE / "drive.css").read_text(encoding="utf-8"),
        "settings": json.dumps(settings, separators=(",", ":")).replace("<", "\\u003c"),
        "module": _packed(module),
        "scenes": "\n".join(_scene(scene) for scene in scenes),
        "script": "\n".join([*map(part, SCRIPTS), (HERE / "drive.js").read_text(encoding="utf-8")]),
    }
    return _filled((HERE / "drive.html").read_text(encoding="utf-8"), parts)


def _for_the_page(config: WorldConfig) -> str:
    """A configuration without the options of networks, which the page does not have."""
    options = json.loads(config.to_json())
    return json.dumps({**options, "policies": {}})


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


def _filled(template: str, parts: Mapping[str, str]) -> str:
    return re.sub(r"\{\{(\w+)\}\}", lambda hole: parts[hole[1]], template)
