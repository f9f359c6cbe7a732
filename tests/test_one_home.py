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


def test_limits_of_reward_and_of_pdm_are_those_of_the_score():
    file = "sim/src/world/reward.rs"
    limits = [COMFORT[name] for name in ("acceleration", "lateral_acceleration", "jerk")]
    assert numbers(file, "COMFORT_BOUNDS") == [bound for pair in limits for bound in pair]
    assert numbers(file, "LEAST_TTC_S") == [TTC_BOUND_S]
    # PDM-Closed: braking, acceleration, sideways, jerk; and jerk ahead, which is its own
    expected = [*limits[0], limits[1][1], limits[2][1]]
    assert numbers("sim/src/pdm/comfort.rs", "COMFORT")[:4] == expected


def test_ways_out_of_guidance_are_the_steady_plans_of_the_search():
    file = "nets/src/traffic/way_out.rs"
    accelerations, offsets = numbers(file, "ACCELERATIONS_MPS2"), numbers(file, "OFFSETS_M")
    steady = ego_plans(len(accelerations) * len(offsets))
    assert [(p.acceleration_mps2, p.offset_m) for p in steady] == [
        ((a, a), d) for d in offsets for a in accelerations
    ]
