"""The race of `bench learning`."""

from __future__ import annotations

import importlib

import pytest

from ccdiff_env.bench.race import race, race_table

SOURCE = "embedded/train"


@pytest.fixture(autouse=True)
def _few_episodes(monkeypatch):
    monkeypatch.setattr(importlib.import_module("ccdiff_env.bench.race"), "EPISODES", 10)
    monkeypatch.setattr(importlib.import_module("ccdiff_env.bench.race"), "NUM_ENVS", 32)


def test_a_race_ends_at_its_last_goal():
    (row,) = race(SOURCE, goals=(0.0,), max_s=1e6)
    assert row["goal"] == 0.0
    assert row["decisions"] > 0
    assert race_table([row]).splitlines()[2].startswith("| 0% |")


def test_a_race_ends_at_its_time():
    (row,) = race(SOURCE, goals=(1.1,), max_s=0.0)
    assert "goal" not in row
    assert row["clock_s"] > 0.0
    assert "ended before" in race_table([row])
