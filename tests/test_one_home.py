"""Facts that Rust and Python must both hold are the same in both."""

from __future__ import annotations

import re
from pathlib import Path

from ccdiff_env.bench.planner_score import COMFORT, TTC_BOUND_S
from ccdiff_env.record.counterfactual import ego_plans

RUST = Path(__file__).resolve().parents[1] / "rust"


def numbers(file: str, constant: str) -> list[float]:
    """Numbers in the value of a constant of a Rust file."""
    text = (RUST / file).read_text(encoding="utf-8")
    found = re.search(rf"const {constant}: [^=]*=([^;]*);", text)
    assert found, constant
    return [float(number) for number in re.findall(r"-?\d+\.\d+", found[1])]


def test_limits_of_rewards_and_of_pdm_are_those_of_the_score():
    file = "sim/src/events/limits.rs"
    units = ("_MPS2", "_MPS2", "_MPS3", "_MPS3", "_RADPS", "_RADPS2")
    for (name, (low, high)), unit in zip(COMFORT.items(), units, strict=True):
        found = numbers(file, name.upper() + unit)
        assert found in ([low, high], [high])
        assert len(found) == 2 or low == -high
    assert numbers(file, "TTC_S") == [TTC_BOUND_S]


def test_ways_out_of_guidance_are_the_steady_plans_of_the_search():
    file = "nets/src/traffic/way_out.rs"
    accelerations, offsets = numbers(file, "ACCELERATIONS_MPS2"), numbers(file, "OFFSETS_M")
    steady = ego_plans(len(accelerations) * len(offsets))
    assert [(p.acceleration_mps2, p.offset_m) for p in steady] == [
        ((a, a), d) for d in offsets for a in accelerations
    ]
