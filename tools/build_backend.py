"""Build backend of the package: cargo makes `_models`, maturin everything else.

maturin puts one extension module into a wheel: `_native`, which needs Rust alone. `_models`, the
networks, is made before, with libtorch of LIBTORCH, of the link .libtorch that `make setup` makes,
or of the torch that pip installs for the time of the build, and lies beside the Python sources,
from where maturin takes it along. ``CCDIFF_MODELS=0`` leaves it out, and with it gigabytes of
torch. ``python tools/build_backend.py`` makes `_models` alone.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
MODULE = ROOT / "ccdiff_env" / "_models.abi3.so"


def _torch() -> str:
    """Return the requirement of the release that networks are built with."""
    match = re.search(r"torch==[\d.]+", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert match is not None
    return match[0]


def _wanted() -> bool:
    return os.environ.get("CCDIFF_MODELS") != "0"


def _libtorch() -> Path | None:
    """Return the folder of libtorch that was named, if there is one."""
    named = os.environ.get("LIBTORCH")
    folder = Path(named) if named else ROOT / ".libtorch"
    return folder if named or folder.exists() else None


def make_models() -> None:
    """Compile `_models` and put it beside the Python sources, or end with a line that says why."""
    MODULE.unlink(missing_ok=True)
    for tool, cure in (("cargo", "install Rust, https://rustup.rs"), ("c++", "install g++")):
        if shutil.which(tool) is None and (_wanted() or tool == "cargo"):
            sys.exit(f"ccdiff-env: building needs {tool}, which is not there: {cure}")
    if not _wanted():
        return
    folder, spec = _libtorch(), find_spec("torch")
    if folder is None and spec is not None and spec.origin is not None:
        folder = Path(spec.origin).parent
    if folder is None or not (folder / "include").is_dir():
        sys.exit(
            f"ccdiff-env: networks are built with {_torch()}, which is not "
            f"{'there' if folder is None else f'in {folder}'}: pip install {_torch()}, or leave "
            "networks out with CCDIFF_MODELS=0"
        )
    environment = dict(os.environ)
    # the link is where .cargo/config.toml looks, too: one spelling, one build
    if folder != ROOT / ".libtorch":
        environment["LIBTORCH"] = str(folder)
    # with ccdiff-render the dependencies of ccdiff-sim have the same features as under maturin: one
    # build of it serves both modules, as they ask of each other
    packages = ["-p", "ccdiff-py-models", "-p", "ccdiff-render"]
    call = ["cargo", "build", "--release", "--locked", *packages]
    if subprocess.run(call, cwd=ROOT, env=environment, check=False).returncode != 0:
        sys.exit(f"ccdiff-env: {' '.join(call)} failed, see above")
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
    # written aside: a process that has the old module loaded keeps it
    aside = MODULE.with_suffix(".new")
    shutil.copyfile(target / "lib_models.so", aside)
    aside.replace(MODULE)


def __getattr__(name: str) -> Any:
    """Return maturin's hooks; those of wheels make `_models` as well, and want torch for it where
    nobody says where libtorch is.
    """
    if not re.fullmatch(r"(get_requires_for_)?build_(wheel|editable|sdist)", name):
        raise AttributeError(name)
    import maturin

    hook = getattr(maturin, name)
    if name.endswith("sdist"):  # the files that git tracks
        return hook
    if name.startswith("get_requires"):
        torch = [_torch()] if _wanted() and _libtorch() is None else []
        return lambda *given, **named: [*hook(*given, **named), *torch]

    def build(*given: Any, **named: Any) -> Any:
        make_models()
        return hook(*given, **named)

    return build


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    make_models()
