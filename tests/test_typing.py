"""Keywords as a type checker sees them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

CALLS = {
    "EgoEnv(traffic='idm', dynamics='bicycle', reward={'goal': 5.0}, bev={})": "",
    "EgoVectorEnv(8, traffic={'idm': 0.5, 'replay': 0.5}, ccdiff={'num_samples': 2})": "",
    "make_vec(8, controlled='ego')": "controlled",  # environments set it themselves
    "EgoEnv(trafic='idm')": "trafic",
    "EgoEnv(horizon_steps='long')": "horizon_steps",
    "make_vec(8, dynamics='bike')": "dynamics",
    "EgoVectorEnv(8, trafic='idm')": "trafic",
    "AgentVectorEnv(8, trafic='idm')": "trafic",
    "parallel_env(trafic='idm')": "trafic",
    "AdversarySelectionEnv(trafic='idm')": "trafic",
    "AdversarySelectionVectorEnv(8, on_collision='stp')": "on_collision",
    "WorldConfig().with_options(observation={}, controlled=['a'], num_slots=2)": "",
    "WorldConfig().with_options(trafic='idm')": "trafic",
}


@pytest.mark.slow
def test_checkers_refuse_names_that_do_not_exist(tmp_path):
    api = pytest.importorskip("mypy.api")
    snippet = tmp_path / "snippet.py"
    calls = (f"ccdiff_env.{call}" for call in CALLS)
    snippet.write_text("\n".join(["import ccdiff_env", *calls]) + "\n")
    found, _, _ = api.run(
        ["--config-file", str(ROOT / "pyproject.toml"), "--follow-imports=silent", str(snippet)]
    )
    errors = {int(line): text for line, text in re.findall(r"snippet.py:(\d+): error: (.*)", found)}
    wrong = {call: errors.get(at, "") for at, call in enumerate(CALLS, start=2)}
    for call, name in CALLS.items():
        assert (f'"{name}"' in wrong[call]) if name else not wrong[call], (call, wrong[call])
