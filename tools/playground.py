"""Compiles the world to WebAssembly for the playground, and writes the page of the site.

``python -m tools.playground docs/site/playground.html`` keeps the module in
``ccdiff_env/data/playground.wasm``, which ``ccdiff-env play`` puts into its pages.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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


if __name__ == "__main__":
    if not target_is_installed():
        raise SystemExit(f"no playground: rustup target add {TARGET}")
    MODULE.write_bytes(compiled())
    page = Path(sys.argv[1])
    page.parent.mkdir(parents=True, exist_ok=True)
    write_playground(page)
    print(page)
