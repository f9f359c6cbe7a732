"""Build backend of the package: cargo makes `_models`, maturin everything else.

maturin puts one extension module into a wheel: `_native`, which needs Rust alone. `_models`, the
networks, is made before, with libtorch of LIBTORCH, of the link .libtorch that `make setup` makes,
or of the torch that pip installs for the time of the build, and lies beside the Python sources,
from where maturin takes it along. ``CCDIFF_MODELS=0`` leaves it out, and with it gigabytes of
torch. ``python tools/build_backend.py`` makes `_models` alone.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TORCH_GB = 2.7  #: What is fetched with torch.
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


def _say() -> None:
    """Say on the terminal, as pip keeps the output, what is made and how long it takes."""
    networks = f", with {_torch()} ({TORCH_GB} GB, fetched once for the build)" if _wanted() else ""
    try:
        with open("/dev/tty", "w", encoding="utf-8") as terminal:
            print(f"\nccdiff-env: compiling Rust, 3 to 13 minutes{networks}", file=terminal)
            if _wanted():
                print("  CCDIFF_MODELS=0 leaves out what needs torch: 2 minutes", file=terminal)
    except OSError:  # no terminal
        return


def _requirements(maturins: list[str]) -> list[str]:
    return [*maturins, _torch()] if _wanted() and _libtorch() is None else maturins


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """Return what pip installs before it builds: torch only where nobody says where libtorch is."""
    import maturin

    return _requirements(maturin.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: Any = None) -> list[str]:
    """As for a wheel."""
    import maturin

    return _requirements(maturin.get_requires_for_build_editable(config_settings))


def build_wheel(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Make both modules and a wheel of them."""
    import maturin

    _say()
    make_models()
    return str(maturin.build_wheel(folder, config_settings, metadata))


def build_editable(folder: str, config_settings: Any = None, metadata: str | None = None) -> str:
    """Make both modules where the sources are."""
    import maturin

    make_models()
    return str(maturin.build_editable(folder, config_settings, metadata))


def __getattr__(name: str) -> Any:
    """Return maturin's hooks of source distributions: the files that git tracks."""
    if name not in ("build_sdist", "get_requires_for_build_sdist"):
        raise AttributeError(name)
    import maturin

    return getattr(maturin, name)


if __name__ == "__main__":
    make_models()
