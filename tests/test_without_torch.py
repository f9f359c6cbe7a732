"""What runs where there is neither torch nor the module that needs it, in processes of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Files that README names; nuScenes stands for the embedded scenes.
DESK = """
import ccdiff_env
from ccdiff_env.view.sources import play_scene
play_scene(ccdiff_env.embedded_scenes("val")[0]).to_scenarionet("scenario.pkl")
ccdiff_env.load_nuscenes = lambda *_, **__: ccdiff_env.embedded_scenes("val")
"""
NETWORKS = "ccdiff_one_step,ccdiff,simnet,trafficsim,strive,bits,ctg,ctgpp,tokens"


def without_torch(code: str, folder: Path) -> str:
    """Last line that a fresh process prints."""
    head = f"import sys\nsys.path[0] = {str(ROOT)!r}\n"
    head += "sys.modules['torch'] = sys.modules['ccdiff_env._models'] = None\n"
    command = [sys.executable, "-c", head + code + "\nprint('done')"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.splitlines()[-1]


NETWORK_OPTIONS = [
    {"traffic": "ccdiff", "ccdiff": {"criticality": 1.0, "denoising_steps": 1}},
    {"traffic": "ccdiff", "ccdiff": {"follow_route": True, "num_samples": 3, "cfg_weight": 1.3}},
    {"traffic": "tokens", "tokens": {"follow_route": True, "careful": True}},
    {"traffic": "ctgpp"},
    *({"traffic": name, "criticality": 1.0} for name in ("simnet", "ctg", "bits")),
    *({"traffic": name, "criticality": 1.0} for name in ("trafficsim", "strive")),
]


def test_networks_drive(tmp_path):
    code = f"""
import ccdiff_env
for options in {NETWORK_OPTIONS}:
    env = ccdiff_env.EgoEnv(**options)
    env.reset(seed=3)
    for _ in range(12):
        env.step([0.5, 0.0])
    assert env.explain() is not None, options
"""
    assert without_torch(code, tmp_path) == "done"


def test_what_the_readme_shows_runs(tmp_path):
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("make_vec(64", "make_vec(2")
    found = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    kept = [block for block in found if "stable_baselines3" not in block]
    assert len(kept) == len(found) - 1
    assert without_torch(DESK + "".join(kept), tmp_path) == "done"


@pytest.mark.parametrize(
    "words",
    [
        ["planners", "--planners", "idm", "--traffic", "ccdiff"],
        ["traffic", "--methods", NETWORKS, "--k", "1", "--t", "1"],
    ],
    ids=lambda words: words[0],
)
def test_benchmarks_run(words, tmp_path):
    command = ["bench", *words, "--limit", "1", "--out", str(tmp_path / "run")]
    code = f"from ccdiff_env_cli import main\nassert main({command}) == 0"
    assert without_torch(code, tmp_path) == "done"


def test_banks_are_recorded(tmp_path):
    code = """
import pathlib
import ccdiff_env
from ccdiff_env.record.bank import _record
packed = [ccdiff_env.embedded_scenes("val")[0].to_bytes()]
_record((pathlib.Path("a.scenes"), packed, "ccdiff", 1.0, 0, "", False))
"""
    assert without_torch(code, tmp_path) == "done"
    assert (tmp_path / "a.scenes").stat().st_size > 1000
