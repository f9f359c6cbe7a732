"""Installs a wheel into empty environments, without torch and with it, and uses it there.

``python tests/try_wheel.py dist/ccdiff_env-*.whl``; `make wheel` does it. The rivals' wheel lies
beside it. Prints what was tried.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

WITH_TORCH = """
import ccdiff_env
from pettingzoo.test import parallel_api_test
from stable_baselines3.common.env_checker import check_env

check_env(ccdiff_env.EgoEnv(traffic="strive"))
parallel_api_test(ccdiff_env.parallel_env(agents=3), num_cycles=50)
ccdiff_env.models.require_networks()
"""


def run(*command: str | Path, cwd: Path, **environment: str) -> None:
    """Run a command in a folder; end with it where it fails."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    words = [str(word) for word in command]
    result = subprocess.run(words, cwd=cwd, env={**clean, **environment}, check=False)
    if result.returncode != 0:
        sys.exit(f"{' '.join(words)[:200]} ended with {result.returncode}")


def environment_with(what: str, folder: Path, links: Path) -> Path:
    """Make an empty environment, install into it, return its folder of commands."""
    uv = shutil.which("uv", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if uv is None:
        sys.exit("uv is not there: make setup")
    run(uv, "venv", "-q", "--python", sys.executable, folder, cwd=folder.parent)
    begin = time.monotonic()
    install = ("pip", "install", "-q", "--python", folder / "bin/python")
    run(uv, *install, "--find-links", links, what, cwd=folder.parent)
    size = sum(f.lstat().st_size for f in folder.rglob("*") if not f.is_symlink()) / 1e6
    print(f"installed in {time.monotonic() - begin:.0f} s, {size:.0f} MB", flush=True)
    return folder / "bin"


def main(wheel: Path) -> None:
    """Try a wheel."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, without torch", flush=True)
        assert wheel.stat().st_size < 15e6, "README says 14 MB"
        bare = environment_with(str(wheel), work / "bare", wheel.parent)
        run(bare / "ccdiff-env", "doctor", cwd=work)
        view = ("view", "left-turn-04", "--traffic", "ccdiff", "--criticality", "1", "-o", "a.html")
        run(bare / "ccdiff-env", *view, cwd=work)
        assert (work / "a.html").stat().st_size > 10_000
        planners = ("bench", "planners", "--planners", "idm,constant_velocity", "--traffic", "idm")
        run(bare / "ccdiff-env", *planners, "--limit", "2", "--out", "planners", cwd=work)

        print("with torch", flush=True)
        full = environment_with(f"{wheel}[models,rivals,rl]", work / "full", wheel.parent)
        run(full / "python", "-c", WITH_TORCH, cwd=work)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
