"""Options: classes, page and checks all come from the tables of Rust."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.errors import ConfigError
from tools.configuration import FILES, tables

ROOT = Path(__file__).resolve().parents[1]

#: Where a table stands in the configuration of worlds.
PLACES = {
    "WorldConfig": (),
    "ActionConfig": ("action",),
    "UnicycleLimits": ("action", "dynamics", "unicycle"),
    "BicycleLimits": ("action", "dynamics", "bicycle"),
    "DeltaPoseLimits": ("action", "dynamics", "delta_pose"),
    "AssistedLimits": ("action", "dynamics", "assisted"),
    "ObservationConfig": ("observation",),
    "BevConfig": ("observation", "bev"),
    "RewardConfig": ("reward",),
    "Randomization": ("randomization",),
    "IdmConfig": ("idm",),
}


@pytest.mark.parametrize("name", FILES)
def test_classes_keywords_and_page_are_those_of_the_tables(name):
    assert (ROOT / name).read_text(encoding="utf-8") == FILES[name]()


def parsed(text):
    """Ends of a range such as "in (0, 1]", each with whether it belongs to it."""
    found = re.fullmatch(r"in ([\[(])(\S+), (\S+)([\])])", text)
    return (float(found[2]), found[1] == "["), (float(found[3]), found[4] == "]")


def tries(text, whole):
    """Numbers at and beside the ends of a range, each with whether it is inside."""
    (low, low_in), (high, high_in) = parsed(text)
    for end in (low, high):
        step = 1 if whole else max(1e-3 * abs(end), 1e-6)
        for value in (end - step, end, end + step):
            inside = low < value < high or (low_in and value == low) or (high_in and value == high)
            yield (int(value) if whole else value), inside


def spanning(value):
    return [min(value, 0.0), max(value, 0.0)]


def checked(table, name, form, value):
    """Whether Rust takes a configuration with a value in a field; its message if not."""
    if form == "span":
        value = spanning(value)
    elif form == {"by_name": "span"}:
        value = {"progress": spanning(value)}
    fields = {name: value}
    for key in reversed(PLACES[table]):
        fields = {key: fields}
    if name == "num_slots":
        fields["controlled"] = "vehicles"
    try:
        _native.networks_wanted(json.dumps(fields))
    except ConfigError as error:
        return str(error)
    return None


def test_ranges_are_those_that_are_checked():
    tried = 0
    for table in (t for t in tables() if t["name"] in PLACES):
        for field in (f for f in table["fields"] if f["range"]):
            path = ".".join((*PLACES[table["name"]], field["name"]))
            for value, inside in tries(field["range"], field["form"] == "count"):
                tried += 1
                message = checked(table["name"], field["name"], field["form"], value)
                if inside:
                    assert message is None, (path, value)
                else:
                    assert message is not None, (path, value)
                    assert message.startswith(f"config: {path}"), message
    assert tried > 100


def numeric(form):
    """Whether there are numbers in a form itself, not in tables of its own."""
    if isinstance(form, dict):
        kind, inner = next(iter(form.items()))
        return kind == "numbers" or (kind in ("optional", "list", "by_name") and numeric(inner))
    return form in ("count", "number", "span")


def test_every_number_has_a_range_with_two_ends():
    """What is larger would hang, fill the memory or mean nothing."""
    found = 0
    for table in tables():
        for field in table["fields"]:
            if not numeric(field["form"]) or (table["name"], field["name"]) == (
                "TrainConfig",
                "seed",
            ):
                continue
            found += 1
            (low, _), (high, _) = parsed(field["range"])
            assert low < high, (table["name"], field["name"])
            assert math.isfinite(low), (table["name"], field["name"])
            assert math.isfinite(high), (table["name"], field["name"])
    assert found > 120


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"replan_steps": 0}, "ccdiff.replan_steps is 0, expected a whole number in [1, 1000]"),
        ({"cfg_weight": 2.0}, "ccdiff.cfg_weight is 2.0, expected a number in [1, 2)"),
        ({"criticality": -1.0}, "ccdiff.criticality is -1.0, expected a number in [0, 10]"),
        ({"criticality": 50.0}, "ccdiff.criticality is 50.0, expected a number in [0, 10]"),
        ({"criticality": 1e30}, "ccdiff.criticality is 1e+30, expected a number in [0, 10]"),
        ({"num_guided": 10_000}, "ccdiff.num_guided is 10000, expected a whole number in [0, 512]"),
        ({"num_samples": 10**6}, "num_samples is 1000000, expected a whole number in [1, 1024]"),
        ({"denoising_steps": 10**6}, "steps is 1000000, expected a whole number in [1, 1000]"),
        ({"guidance": {"discont": 1.0}}, "ccdiff.guidance.discont is no option"),
        (
            {"guidance": {"objectives": [{"kind": "approach", "reach_m": 0.0}]}},
            "ccdiff.guidance.objectives[0].reach_m is 0.0, expected a number in (0, 1000]",
        ),
    ],
)
def test_options_of_networks_are_checked_by_the_same_walker(options, named):
    scenes = ccdiff_env.embedded_scenes("val")[:1]
    with pytest.raises(ConfigError, match=re.escape(named)):
        ccdiff_env.EgoEnv(scenes=scenes, traffic="ccdiff", ccdiff=options)


def test_vehicles_do_not_reverse_by_default_in_any_model_of_motion():
    for table in tables():
        if "speed_mps" in (table["defaults"] or {}) and table["name"].endswith("Limits"):
            assert table["defaults"]["speed_mps"] == [0.0, 30.0]


def test_every_field_says_what_it_is():
    for table in tables():
        assert table["doc"].strip()
        for field in table["fields"]:
            assert field["doc"].strip().endswith("."), (table["name"], field["name"])
