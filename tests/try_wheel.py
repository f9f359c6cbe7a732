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

WITHOUT_TORCH = """
import importlib.util

import gymnasium

import ccdiff_env

assert importlib.util.find_spec("torch") is None

from gymnasium.utils.env_checker import check_env

env = gymnasium.make("ccdiff_env/Ego-v0", traffic="idm", render_mode="rgb_array")
check_env(env.unwrapped, skip_render_check=True)
obs, info = env.reset(seed=7)
done = False
while not done:
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    done = terminated or truncated
print("an episode:", info["is_success"], env.render().shape)

planned = ccdiff_env.EgoEnv(traffic="ccdiff", criticality=1.0)
planned.reset(seed=1)
for _ in range(10):
    planned.step(planned.action_space.sample())
print("CCDiff without torch:", planned.explain().agents.shape)

try:
    ccdiff_env.EgoEnv(traffic="strive")
except ccdiff_env.errors.MissingFeatureError as error:
    print("STRIVE without its weights:", error)
    assert "ccdiff-env[rivals]" in str(error)
else:
    raise AssertionError("STRIVE traffic without its weights")
"""

WITH_TORCH = """
import sys

import ccdiff_env

assert "torch" not in sys.modules
scene = ccdiff_env.embedded_scenes("val")[0]
env = ccdiff_env.EgoEnv(traffic="idm")

from pettingzoo.test import parallel_api_test
from stable_baselines3.common.env_checker import check_env

check_env(env)
parallel_api_test(ccdiff_env.parallel_env(agents=3), num_cycles=50)
[plan] = ccdiff_env.models.TrajectoryModel(ccdiff_env.models.shipped_weights()).plan([scene], [30])
print("a plan:", plan.states.shape)
ccdiff_env.EgoEnv(traffic="strive").reset(seed=1)
critical = ccdiff_env.make_vec(4, traffic="ccdiff", criticality=1.0)
critical.reset(seed=1)
critical.action_space.seed(0)  # else an episode may have just begun, and has no plan
for _ in range(10):
    critical.step(critical.action_space.sample())
print("CCDiff traffic:", critical.worlds.explain(0).agents.shape)
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
        bare = environment_with(str(wheel), work / "bare", wheel.parent)
        run(bare / "python", "-c", WITHOUT_TORCH, cwd=work)
        run(bare / "ccdiff-env", "--help", cwd=work)
        view = ("view", "left-turn-04", "--traffic")
        run(bare / "ccdiff-env", *view, "idm", "-o", "idm.html", cwd=work)
        assert (work / "idm.html").stat().st_size > 10_000
        planners = ("bench", "planners", "--planners", "idm,constant_velocity", "--traffic", "idm")
        run(bare / "ccdiff-env", *planners, "--limit", "2", "--out", "planners", cwd=work)

        print("with torch", flush=True)
        full = environment_with(f"{wheel}[models,rivals,rl]", work / "full", wheel.parent)
        run(full / "python", "-c", WITH_TORCH, cwd=work)
        critical = ("ccdiff", "--criticality", "1", "-o", "critical.html")
        run(full / "ccdiff-env", *view, *critical, cwd=work)
        assert (work / "critical.html").stat().st_size > 10_000


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
