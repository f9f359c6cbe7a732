"""Control sets that lists name, and what is not played twice."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import cli
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.scenes import scene_names, scenes_of
from ccdiff_env.bench.traffic import control_set, episodes, evaluate, traffic_jobs
from ccdiff_env.bench.traffic_report import conditions
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.traffic import read_ranking

VAL = "embedded/val?limit=2"
ONE = "embedded/val?limit=1"


def everybody(source):
    """All vehicles of each scene by name, the least important first."""
    return {
        scene.name: [scene.agent_ids[i] for i in reversed(control_set(scene, "cliques", None))]
        for scene in scenes_of(source)
    }


def test_the_controlled_vehicles_are_those_of_the_list_in_its_order():
    lists = {name: ids[:2] for name, ids in everybody(VAL).items()}
    scenes = scenes_of(VAL)
    played = episodes(scenes, METHODS["ccdiff_listed"], num_controlled=2, lists=lists)
    for scene, episode in zip(scenes, played, strict=True):
        assert [scene.agent_ids[i] for i in episode.chosen] == lists[scene.name]
        assert {int(i) for p in episode.plans for i in p.agents[p.guided]} <= set(episode.chosen)
        rest = ~episode.controlled
        log = scene.tracks()["position"][episode.agents[rest], 31:132]
        there = episode.motion.valid[rest]
        assert there.any()
        np.testing.assert_allclose(episode.position[rest][there], log[there], atol=1e-3)


def test_a_short_list_is_filled_up_and_always_in_the_same_way():
    scene = ccdiff_env.embedded_scenes("val")[0]
    listed = everybody(ONE)[scene.name][:1]
    first = control_set(scene, "listed", 3, listed=listed)
    assert len(set(first)) == 3
    assert scene.agent_ids[first[0]] == listed[0]
    assert first == control_set(scene, "listed", 3, 7, listed=listed)
    assert set(control_set(scene, "listed", None)) == set(control_set(scene, "cliques", None))


def test_a_list_goes_into_the_jobs_of_its_scenes_alone():
    lists = {**everybody(VAL), "another scene": ["x"]}
    jobs = traffic_jobs(VAL, ["ccdiff", "ccdiff_listed"], num_controlled=(2,), listed=lists)
    told = {job.arguments["method"]: job.arguments.get("lists") for job in jobs}
    assert told == {"replay": None, "ccdiff": None, "ccdiff_listed": everybody(VAL)}


def test_lists_that_do_not_fit_the_scenes_are_refused():
    lists = everybody(VAL)
    a, b = lists
    with pytest.raises(ConfigError, match="needs lists of vehicles"):
        traffic_jobs(VAL, ["ccdiff_listed"])
    with pytest.raises(DatasetError, match=f"none for {a}, {b}"):
        traffic_jobs(VAL, ["ccdiff_listed"], listed={})
    with pytest.raises(DatasetError, match=f"{b}: 'nobody', expected a vehicle .* step 31: "):
        traffic_jobs(VAL, ["ccdiff_listed"], listed={**lists, b: ["nobody"]})
    with pytest.raises(DatasetError, match=f"{a}: '{lists[a][0]}' twice"):
        traffic_jobs(VAL, ["ccdiff_listed"], listed={**lists, a: [lists[a][0]] * 2})


@pytest.mark.parametrize(
    "text",
    [
        b"", b"null", b"[]", b"3", b'{"a": "ego"}', b'{"a": [1]}', b'{"a": [["ego"]]}', b'{"a": nu',
        b"\xff\xfe\x00", b"[" * 100_000, b'{"a": {"ego": 1}}',
    ],
)  # fmt: skip
def test_files_that_hold_no_lists_are_refused(text, tmp_path):
    path = tmp_path / "people.json"
    path.write_bytes(text)
    with pytest.raises(DatasetError, match=r"people\.json"):
        read_ranking(path)
    with pytest.raises(DatasetNotFoundError):
        read_ranking(tmp_path / "absent.json")
    with pytest.raises(DatasetError):
        read_ranking(tmp_path)


def test_the_command_plays_the_lists_of_a_file_and_only_those(tmp_path, capsys):
    lists = {name: ids[:1] for name, ids in everybody(ONE).items()}
    path, out = tmp_path / "people.json", tmp_path / "run"
    path.write_text(json.dumps(lists))
    command = ["bench", "traffic", "--out", str(out), "--limit", "1", "--k", "1", "--quiet"]
    command += ["--t", "5"]
    assert cli.main([*command, "--methods", "idm", "--listed", str(path)]) == 0
    assert "CCDiff, listed by a person" in (out / "table.md").read_text(encoding="utf-8")
    assert json.loads((out / "run.json").read_text(encoding="utf-8"))["listed"] == lists
    # other methods go on in the same folder, other lists do not
    assert cli.main([*command, "--methods", "idm"]) == 0
    path.write_text(json.dumps(everybody(ONE)))
    assert cli.main([*command, "--methods", "idm", "--listed", str(path)]) == 2
    assert "other settings: listed" in capsys.readouterr().err
    assert cli.main([*command[:-1], "abc", "--methods", "idm"]) == 2
    assert "--t is 'abc'" in capsys.readouterr().err


def test_what_cannot_differ_is_not_played_twice():
    jobs = traffic_jobs(
        ONE, ["idm", "ccdiff", "ccdiff_random", "ccdiff_no_enc"],
        num_controlled=(2, 5, None), replan_steps=(5, 10), replan_controlled=(5,),
    )  # fmt: skip
    found = conditions({**job.arguments, "k": job.arguments["num_controlled"]} for job in jobs)
    by_method: dict[str, set[tuple[int | None, int]]] = {}
    for c in found:
        by_method.setdefault(c.method, set()).add((c.num_controlled, c.replan_steps))
    assert by_method == {
        "replay": {(0, 5)},
        "idm": {(2, 5), (5, 5), (None, 5)},
        "ccdiff": {(2, 5), (5, 5), (5, 10), (None, 5)},
        "ccdiff_random": {(2, 5), (5, 5), (5, 10)},
        "ccdiff_no_enc": {(2, 5), (5, 5), (5, 10), (None, 5)},
    }
    alone = traffic_jobs(ONE, ["ccdiff_random"], num_controlled=(None,))
    assert [job.arguments["method"] for job in alone] == ["replay", "ccdiff_random"]


def test_the_order_of_vehicles_does_not_matter_where_all_are_controlled():
    lists = everybody(ONE)
    rows = [
        evaluate(
            source=ONE, names=scene_names(ONE), method=method, num_controlled=None,
            replan_steps=10, seed=0, lists=lists,
        )
        for method in ("ccdiff", "ccdiff_listed", "ccdiff_random", "ccdiff_greedy")
    ]  # fmt: skip
    assert rows[1:] == [rows[0]] * 3
