"""The README's moving picture: small, and of what its titles say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ccdiff_env.view.outcome import outcome
from tools import readme_film

PICTURE = Path(__file__).resolve().parents[1] / "docs/hero.gif"


def test_the_picture_moves_and_loads_fast():
    assert PICTURE.stat().st_size < 500_000
    with Image.open(PICTURE) as film:
        assert film.n_frames > 30


def test_criticality_alone_makes_the_collision_of_the_picture():
    log, realistic, critical = readme_film.runs()
    assert {run.scene.name for run in (log, realistic, critical)} == {readme_film.SCENE}
    last = critical.num_steps - 1
    assert "hit" not in outcome(realistic).text
    assert outcome(critical).text.startswith("ego hit")
    assert "not at fault" in outcome(critical).text
    assert [e.step for e in critical.collisions() if e.agent_id == "ego"] == [last]
    # the ego is on its recorded path in all three
    for run in (realistic, critical):
        assert np.allclose(run.position[0, :last], log.position[0, :last], atol=0.01)
