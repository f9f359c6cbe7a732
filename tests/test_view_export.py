"""Episodes for other viewers, read back by their own libraries."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from view_rollouts import planned_rollout

from ccdiff_env.errors import ConfigError
from ccdiff_env.view.export import export


def test_an_mcap_file_has_the_agents_of_each_step(tmp_path):
    reader = pytest.importorskip("mcap.reader")
    run = planned_rollout()
    export(run, tmp_path / "run.mcap")
    with (tmp_path / "run.mcap").open("rb") as file:
        found = list(reader.make_reader(file).iter_messages())
    assert len(found) == run.num_steps
    for step, (schema, channel, message) in enumerate(found):
        assert (schema.name, channel.topic) == ("foxglove.SceneUpdate", "/agents")
        assert message.log_time == round(step * run.dt_s * 1e9)
        entities = {e["id"]: e["cubes"][0] for e in json.loads(message.data)["entities"]}
        assert set(entities) == {run.agent_ids[i] for i in np.flatnonzero(run.valid[:, step])}
        ego = entities["ego"]
        place, turn = ego["pose"]["position"], ego["pose"]["orientation"]
        assert [place["x"], place["y"]] == pytest.approx(run.position[0, step].tolist())
        heading = 2.0 * np.arctan2(turn["z"], turn["w"])
        assert np.cos(heading - run.heading[0, step]) == pytest.approx(1.0)
        assert ego["size"]["x"] == pytest.approx(float(run.scene.sizes[0, 0]))


def test_a_rerun_file_has_the_agents_of_each_step(tmp_path):
    pytest.importorskip("rerun")
    run = planned_rollout()
    export(run, tmp_path / "run.rrd")
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(tmp_path / "run.rrd")]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    (agents,) = [line for line in shown.splitlines() if "- /agents -" in line]
    assert f"with {run.num_steps} rows" in agents
    assert "Boxes3D:centers" in agents


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"expected \.rrd or \.mcap"):
        export(planned_rollout(), tmp_path / "run.bag")
