"""Files made to harm are refused in words, or do nothing; ``attacks/README.md`` lists them."""

from __future__ import annotations

import runpy
import time
from pathlib import Path

import pytest

import ccdiff_env
from ccdiff_env import errors

FOLDER = Path(__file__).parent / "attacks"

#: Pickles that hold nothing which is looked at: they cost no more than their size.
HARMLESS = {"memo_of_64_gib", "nested_50000_deep"}


def test_the_folder_holds_what_its_script_makes():
    kept = {path.name: path.read_bytes() for path in FOLDER.iterdir() if path.suffix != ".py"}
    readme = kept.pop("README.md").decode()
    assert kept == runpy.run_path(str(FOLDER / "make.py"))["files"]()
    assert all(f"`{Path(name).stem}" in readme for name in kept)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.pkl")), ids=lambda path: path.stem)
def test_scenario_pickles(path, capfd):
    start = time.process_time()
    if path.stem in HARMLESS:
        assert ccdiff_env.load_scenarionet(path)[0].num_steps == 11
    else:
        with pytest.raises(errors.DatasetError, match=path.name):
            ccdiff_env.load_scenarionet(path)
    assert time.process_time() - start < 2.0
    assert "attacked" not in capfd.readouterr().out
