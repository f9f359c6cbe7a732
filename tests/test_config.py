"""Configuration: defaults, JSON, keywords, messages; all of them come from the tables of Rust."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import _native
from ccdiff_env.config import (
    ActionConfig,
    BicycleLimits,
    DeltaPoseLimits,
    RewardConfig,
    UnicycleLimits,
    WorldConfig,
)
from ccdiff_env.errors import CcdiffError, ConfigError
from ccdiff_env.traffic import TrafficPlan
from tools.configuration import OPTIONS, classes, tables


def test_json_holds_the_options_of_drivers_that_drive_alone():
    def held(**options):
        made = json.loads(WorldConfig().with_options(**options).to_json())
        return {*made["named_drivers"], *({"idm"} & set(made))}

    assert held() == set()
    assert held(traffic="idm") == held(driver="idm") == held(dynamics="assisted") == {"idm"}
    assert held(traffic="ccdiff") == held(traffic="ctg") == {"ccdiff"}
    assert held(traffic={"ctg": 0.5, "idm": 0.5}) == {"ccdiff", "idm"}
    assert held(traffic="simnet", simnet={"criticality": 1.0}) == {"simnet"}
    assert held(traffic="ccdiff", ccdiff={"background_driver": "idm"}) == {"ccdiff", "idm"}
    assert held(idm={"headway_s": 2.0}) == {"idm"}  # vehicles may be assigned to it later


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"traffic": "idm", "horizon_steps": 7},
        {"traffic": {"idm": 0.5, "ccdiff": 0.3, "replay": 0.2}, "ccdiff": {"criticality": 1.0}},
        {
            "named_drivers": {"calm": {"idm": {"headway_s": 2.0}}},
            "traffic": "calm",
            "driver": "calm",
        },
        {"simnet": {"weights": "mine.safetensors"}, "drivers": {"ego": "simnet"}},
        {"controlled": ("a", "b"), "num_slots": 2},
        {"controlled": {"scene-1": ["a"], "scene-2": ["ego", "b"]}, "num_slots": 2},
        {"dynamics": "bicycle", "discrete": True},
        {"dynamics": {"delta_pose": {"dx_m": [0, 3]}}},
        {"dynamics": UnicycleLimits(speed_mps=(-5.0, 20.0))},
        {"grid": {"first": [-1, 0, 1], "second": [0.0]}, "discrete": True},
        {"observation": {"ego_columns": ["speed"], "masks": False}},
    ],
)
def test_json_keeps_every_field(options):
    config = WorldConfig().with_options(**options)
    assert WorldConfig.from_json(config.to_json()) == config


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("idm?headway_s=2", {"idm": {"headway_s": 2.0}}),
        ("ctg?criticality=1&weights=own", {"ctg": {"criticality": 1.0, "weights": "own"}}),
        (
            "ccdiff?follow_route=true&guidance.gradient_steps=0",
            {"ccdiff": {"follow_route": True, "guidance": {"gradient_steps": 0}}},
        ),
        ("swift?title=Ours", {}),
    ],
)
def test_options_may_follow_the_name_of_a_driver(text, options):
    name = text.partition("?")[0]
    for role in ("traffic", "driver"):
        found = WorldConfig().with_options(**{role: text})
        assert found == WorldConfig().with_options(**{role: name}, **options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ccdiff?criticalty=1", "unknown option 'ccdiff.criticalty'; did you mean"),
        ("ccdiff?criticality", "expected option=value, each option once"),
        ("ccdiff?careful=true&careful.x=1", "careful.x"),
        ("replay?headway_s=1", "options are for idm, "),
        ("nobody?headway_s=1", "options are for idm, "),
    ],
)
def test_options_that_a_driver_does_not_have_are_refused(text, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        WorldConfig().with_options(traffic=text)
    with pytest.raises(ConfigError, match="options of its own beside it"):
        WorldConfig().with_options(traffic="idm?headway_s=2", idm={"headway_s": 1.0})


@pytest.mark.parametrize(
    ("options", "fields"),
    [
        ({"reward": {"goal": 5}}, {"reward": RewardConfig(goal=5.0)}),
        ({"action": {"dynamics": "bicycle"}}, {"action": ActionConfig(dynamics=BicycleLimits())}),
        (
            {"dynamics": "delta_pose", "discrete": True},
            {"action": ActionConfig(dynamics=DeltaPoseLimits(), discrete=True)},
        ),
        ({"reward": "product"}, {"reward": RewardConfig(form="product")}),
        (
            {"horizon_steps": np.int64(9), "dt_s": np.float32(0.5)},
            {"horizon_steps": 9, "dt_s": 0.5},
        ),
    ],
)
def test_short_forms_are_fields(options, fields):
    assert WorldConfig().with_options(**options) == WorldConfig(**fields)
    assert type(WorldConfig().with_options(**options).horizon_steps) is int


def test_dictionaries_change_only_the_fields_they_name():
    config = WorldConfig(reward={"goal": 5.0}).with_options(reward={"comfort": 0.0})
    assert config.reward == RewardConfig(goal=5.0, comfort=0.0)
    for wrong in ({"colision": -3.0}, 5):
        with pytest.raises(ConfigError, match="reward"):
            WorldConfig(reward=wrong)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trafic": "idm"}, "did you mean 'traffic'"),
        ({"ego_columns": ("speed",)}, "did you mean .observation.ego_columns"),
        ({"reward": {"gaol": 1.0}}, "did you mean 'reward.goal'"),
        ({"dynamics": "bicicle"}, "did you mean 'bicycle'"),
        ({"dynamics": {"bicycle": {"speed": 1}}}, "speed_mps"),
        ({"dynamics": 3}, "unicycle, bicycle, delta_pose"),
        (
            {"traffic": "crazy"},
            "there are bits, ccdiff, constant_velocity, ctg, ctgpp, egos, idm, replay",
        ),
        ({"traffic": ["idm"]}, "expected values by name"),
        ({"traffic": {"idm": "half"}}, 'traffic.idm is "half", expected a number'),
        ({"traffic": {"idn": 1.0}}, "did you mean 'idm'"),
        ({"drivers": {"ego": "calm"}}, "unknown driver 'calm'"),
        ({"drivers": "idm"}, "values by name"),
        ({"named_drivers": {"calm": {"idm": {"headway": 2.0}}}}, "headway_s"),
        ({"named_drivers": {"calm": {"crazy": {}}}}, "unknown named_drivers.calm 'crazy'"),
        ({"named_drivers": {"calm": "idm"}}, "expected {kind: options}"),
        ({"named_drivers": {"replay": {"idm": {}}}}, "'replay' is a driver already"),
        ({"traffic": "nowhere:Model"}, "nowhere"),
        ({"dt_s": float("nan")}, "expected a number"),
        ({"dt_s": 10**400}, "number"),
        ({"horizon_steps": True}, "expected a whole number"),
        ({"late_arrivals": 1}, "expected true or false"),
        ({"reward": 3}, "RewardConfig or a dictionary"),
        ({"grid": {"first": [1.0]}}, "second is missing"),
        ({"grid": {"first": [1.0], "secnd": [1.0]}}, "did you mean"),
        ({"dynamics": {"unicycle": {"speed_mps": [1.0]}}}, "lowest and highest"),
        ({"controlled": "trucks"}, "ego, any, vehicles"),
        ({"controlled": {"scene-1": "a"}}, "a list"),
        ({"observation": {"ego_columns": "speed"}}, "a list"),
        ({"reward": "produkt"}, r"reward\.form"),
        ({"adversaries": "others"}, "adversaries"),
        ({"on_traffic_collision": "remove"}, "on_traffic_collision"),
        ({"traffic": "IDM"}, "did you mean 'idm'"),
        ({"traffic": lambda world: 0}, "expected PythonTraffic"),
    ],
)
def test_mistakes_are_named(options, message):
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")):
        WorldConfig().with_options(**options)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"colour": 1}', '{"reward": null}', "null"])
def test_bad_json_is_refused(text):
    with pytest.raises(ConfigError):
        WorldConfig.from_json(text)


def test_options_follow_the_names_of_a_mixture():
    shares = {"idm?headway_s=2.5": 0.5, "swift?criticality=1": 0.3, "ccdiff?num_guided=2": 0.2}
    config = WorldConfig().with_options(traffic=shares)
    assert list(config.traffic.items()) == [("idm", 0.5), ("swift", 0.3), ("ccdiff", 0.2)]
    assert (config.idm.headway_s, config.ccdiff.num_guided) == (2.5, 2)
    assert [n.criticality for n in config.networks_in_traffic()] == [1.0, config.ccdiff.criticality]
    for wrong, said in (
        ({"ccdiff?num_guided=1": 0.5, "ccdiff": 0.5}, "ccdiff has options of its own beside it"),
        ({"idm?headway_s=1": 0.5, "idm?headway_s=2": 0.5}, "idm has options of its own beside it"),
        ({"replay?x=1": 0.5, "idm": 0.5}, "options are for idm"),
    ):
        with pytest.raises(ConfigError, match=said):
            WorldConfig().with_options(traffic=wrong)


def test_numbers_of_a_dataclass_are_checked_as_those_of_options():
    with pytest.raises(ConfigError, match='dt_s is "nan", expected a number'):
        ccdiff_env.EgoEnv(config=WorldConfig(dt_s=float("nan")))


def test_rules_between_options_are_checked_by_rust():
    for change in (
        {"num_slots": 3},
        {"named_drivers": {"calm": {"idm": {"headway_s": 0.0}}}},
        {"traffic": {"idm": 0.5, "replay": 0.6}},
    ):
        with pytest.raises(CcdiffError):
            _native.VecWorld([], WorldConfig().with_options(**change).to_json(), 1, 1)


def test_fields_of_a_plan_are_those_of_rust():
    rust = [entry["name"] for entry in json.loads(_native.schema("plan_fields"))]
    # the last one, the moment at which it was made, is Python's
    assert [field.name for field in dataclasses.fields(TrafficPlan)] == [*rust, "moment"]


def test_classes_are_those_of_the_tables():
    assert OPTIONS.read_text(encoding="utf-8") == classes(tables())


def parsed(text):
    """Ends of a range such as "in (0, 1]", each with whether it belongs to it."""
    found = re.fullmatch(r"in ([\[(])(\S+), (\S+)([\])])", text)
    return (float(found[2]), found[1] == "["), (float(found[3]), found[4] == "]")


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
        ({"replan_steps": 53}, "ccdiff.replan_steps is 53, expected 1 to 52, the steps of a plan"),
        ({"cfg_weight": 2.0}, "ccdiff.cfg_weight is 2.0, expected a number in [1, 2)"),
        ({"criticality": 50.0}, "ccdiff.criticality is 50.0, expected a number in [0, 10]"),
        ({"num_guided": 10_000}, "ccdiff.num_guided is 10000, expected a whole number in [0, 512]"),
        ({"num_samples": 10**6}, "num_samples is 1000000, expected a whole number in [1, 1024]"),
        ({"ranking": "nearest"}, "ranking"),
        ({"wieghts": "fast"}, "weights"),
        ({"guidance": "hard"}, "preset"),
        ({"guidance": {"discont": 1.0}}, "ccdiff.guidance.discont is no option"),
        (
            {"guidance": {"objectives": [{"kind": "agent_collision", "buffer_m": -1.0}]}},
            "ccdiff.guidance.objectives[0].buffer_m is -1.0, expected a number in [0, 100]",
        ),
    ],
)
def test_options_of_networks_are_checked_by_the_same_walker(options, named):
    scenes = ccdiff_env.embedded_scenes("val")[:1]
    with pytest.raises(ConfigError, match=re.escape(named)):
        ccdiff_env.EgoEnv(scenes=scenes, traffic="ccdiff", ccdiff=options)


def test_every_field_says_what_it_is():
    for table in tables():
        assert table["doc"].strip()
        for field in table["fields"]:
            assert field["doc"].strip().endswith("."), (table["name"], field["name"])
