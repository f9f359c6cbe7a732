"""Compiles the world to WebAssembly for the playground, and writes the page of the site.

``python -m tools.playground docs/site/playground.html`` keeps the module in
``ccdiff_env/data/playground.wasm``, which ``ccdiff-env play`` puts into its pages; ``python -m
tools.playground`` alone lists the scenes from which those of the page are taken.
"""

from __future__ import annotations

import argparse
import os
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.view.link import play_keys, world_config
from ccdiff_env.view.outcome import Outcome, outcome
from ccdiff_env.view.play import MODULE, write_playground

TARGET = "wasm32-unknown-unknown"
ROOT = Path(__file__).parents[1]


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
    # instructions of wasm32 are safe where those of other processors are not
    env["RUSTFLAGS"] = "-C target-feature=+simd128 -A unused-unsafe"
    words = ["cargo", "build", "-q", "--release", "--locked", "-p", "ccdiff-wasm"]
    subprocess.run([*words, "--target", TARGET], cwd=ROOT, env=env, check=True)
    folder = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return (folder / TARGET / "release" / "ccdiff_wasm.wasm").read_bytes()


def deciding(scenes: Iterable[Scene], criticality: float = 1.0) -> Iterator[tuple[Scene, Outcome]]:
    """Yield scenes in which criticality decides for a driver who steers along the way and avoids
    nobody: at 0 the ego reaches its goal; with the outcome at ``criticality``, an accident.
    """
    for scene in scenes:
        calm, critical = (
            outcome(play_keys(scene, (), world_config("ccdiff", level), goes_on=True))
            for level in (0.0, criticality)
        )
        if (calm.tone, critical.tone) == ("good", "bad"):
            yield scene, critical


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", nargs="?", type=Path, help="file to write")
    args = parser.parse_args()
    if args.page is None:
        # who is hit comes first, then who drives into somebody; the soonest first
        order = sorted(
            (found.fault == "at fault", found.decided_s, scene.name, found.line)
            for scene, found in deciding(embedded_scenes())
        )
        print(*(f"{name}: {line}" for *_, name, line in order), sep="\n")
        raise SystemExit
    if not target_is_installed():
        raise SystemExit(f"no playground: rustup target add {TARGET}")
    MODULE.write_bytes(compiled())
    write_playground(args.page)
    print(args.page)
