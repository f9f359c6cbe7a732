"""Experiments of the traffic benchmark: conflict of gradients, own weights."""

import csv
from dataclasses import replace
from hashlib import sha256

import pytest

from ccdiff_env import cli, models
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.planners import TRAFFIC
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.traffic import episodes, traffic_jobs
from ccdiff_env.errors import ConfigError, UnknownNameError


def test_plans_say_how_gradients_agree_where_asked_and_are_the_same_plans():
    method, scenes = METHODS["ccdiff"], scenes_of("embedded/val", ["cut-in-03", "left-turn-04"])
    explains = replace(method, ccdiff={**method.ccdiff, "explain": True})
    both = (episodes(scenes, of, num_controlled=2) for of in (method, explains))
    for one, other in zip(*both, strict=True):
        assert one.motion.position.tobytes() == other.motion.position.tobytes()
        for plan, told in zip(one.plans, other.plans, strict=True):
            assert plan.realism_cosine is None
            assert plan.conflict_share is None
            assert plan.samples.tobytes() == told.samples.tobytes()
            if told.guided.any():
                assert len(told.realism_cosine) == len(told.agents)
                cosine, share = told.realism_cosine, told.conflict_share
                assert (cosine[share == 1.0] < 0.0).all()
                assert (cosine[share == 0.0] >= 0.0).all()


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ("ccdiff", "NAME=FILE"),
        ("my-net={tokens}", "NAME=FILE"),
        ("idm={tokens}", "idm is method already"),
        ("ccdiff=no", "no weights for ccdiff"),
        ("ccdiff={tokens}", "tokens"),
    ],
)
def test_weights_that_fit_no_name_are_refused(tmp_path, capsys, weights, said):
    weights = weights.format(tokens=models.shipped_weights("tokens"))
    command = ["bench", "traffic", "--quiet", "--k", "2", "--limit", "2", "--methods", "ccdiff"]
    assert cli.main([*command, "--out", str(tmp_path / "own"), "--weights", weights]) == 2
    assert said in capsys.readouterr().err


def test_rows_without_guidance_say_how_many_samples_they_choose_from():
    assert METHODS["ccdiff_unguided"].label == "CCDiff, no guidance, safest of 5"
    assert METHODS["ccdiff_one_sample"].label == "CCDiff, no guidance, N=1"
    assert METHODS["simnet_unguided"].label == "SimNet, no guidance"
    for name, method in METHODS.items():
        chooses = name.endswith("_unguided") and method.ccdiff["num_samples"] > 1
        assert ("safest of" in method.label) == chooses


def test_weights_under_names_of_their_own_stand_beside_the_shipped_ones(tmp_path, capsys):
    routes = models.shipped_weights(routes=True)
    digest = sha256(routes.read_bytes()).hexdigest()
    common = ["--quiet", "--limit", "2", "--weights", f"mine={routes}"]

    def episodes(kind, *words):
        assert cli.main(["bench", kind, *common, "--out", str(tmp_path / kind), *words]) == 0
        return list(csv.DictReader((tmp_path / kind / "episodes.csv").open()))

    methods = "mine_careful,ccdiff_careful"
    rows = episodes("realism", "--methods", methods, "--samples", "2")
    found = {row["method"]: row for row in rows}
    assert found["mine_careful"]["own_weights"] == digest
    assert found["ccdiff_careful"]["own_weights"] == ""
    assert found["mine_careful"]["realism"] != found["ccdiff_careful"]["realism"]
    table = (tmp_path / "realism/table.md").read_text()
    assert f"| mine, careful, N=1, own weights {digest[:8]} |" in table
    # the same figures as where they replace those of the network, and of no other
    beside = ["--weights", f"ccdiff={routes}", "--methods", "ccdiff_careful,tokens_careful"]
    again = ["bench", "realism", *common[:3], *beside, "--samples", "2"]
    assert cli.main([*again, "--out", str(tmp_path / "instead")]) == 0
    (first, *others) = csv.DictReader((tmp_path / "instead/episodes.csv").open())
    assert first["realism"] == next(r["realism"] for r in rows if r["method"] == "mine_careful")
    assert first["own_weights"] == digest
    assert {row["own_weights"] for row in others if row["method"] == "tokens_careful"} == {""}
    page = (tmp_path / "instead/report.html").read_text()
    assert f"own ccdiff {digest[:12]}" in page
    # as traffic of planners, in two processes, and on pages
    words = ["--planners", "idm", "--traffic", "mine-1,ccdiff-1", "--seeds", "0", "--workers", "2"]
    rows = episodes("planners", *words)
    assert {row["traffic"]: row["own_weights"] for row in rows} == {
        "mine-1": digest,
        "ccdiff-1": "",
    }
    assert "mine, criticality 1" in (tmp_path / "planners/table.md").read_text()
    assert cli.main(["bench", "verify", str(tmp_path / "planners")]) == 0
    page = ["view", "left-turn-00", "--traffic", "mine-1", "-o", str(tmp_path / "page.html")]
    assert cli.main([*page, "--weights", f"mine={routes}"]) == 0
    capsys.readouterr()
    protocol = ["bench", "planners", *common[3:], "--protocol", "planner-1.4"]
    assert cli.main([*protocol, "--out", str(tmp_path / "p")]) == 2
    assert "--weights: planner-1.4 fixes it" in capsys.readouterr().err


def test_a_method_is_put_together_from_a_network_a_form_and_a_mode():
    made = METHODS["ctg_careful"]
    assert (made.driver, made.ccdiff) == ("ctg", {"careful": True})
    assert METHODS["tokens_routes_calibrated"].ccdiff["follow_route"]
    assert METHODS["ctg_routes-0.5"].ccdiff == {**METHODS["ctg_routes"].ccdiff, "criticality": 0.5}
    assert "ctg_carefull" not in METHODS
    with pytest.raises(UnknownNameError, match="did you mean 'ccdiff_careful'"):
        METHODS["ccdif_careful"]


def test_options_follow_names_of_methods_and_of_traffic():
    for table in (METHODS, TRAFFIC):
        made = table["ccdiff?criticality=0.5&follow_route=true"]
        assert made.ccdiff == {
            **table["ccdiff"].ccdiff,
            "criticality": 0.5,
            "follow_route": True,
        }
        assert made.label == "CCDiff, criticality=0.5, follow_route=true"
        assert table["idm?headway_s=2"].driver == "idm?headway_s=2"
        assert table["idm?headway_s=2&title=Timid"].label == "Timid"
        assert "idm?headway_s=2" in table
        assert "idmm?headway_s=2" not in table
        with pytest.raises(ConfigError, match="unknown option 'ccdiff"):
            table["ccdiff?headway_s=2"]


def test_criticality_stands_before_the_options_of_a_method():
    text = "ctg?denoising_steps=1"
    jobs = traffic_jobs("embedded/val", [text], num_controlled=[1], strengths=[0.5, 3.0])
    played = {job.arguments["method"] for job in jobs} - {"replay"}
    assert played == {"ctg-0.5?denoising_steps=1", "ctg-3?denoising_steps=1"}
    for name in played:
        stem, strength = METHODS.without_strength(name)
        assert (stem, METHODS.with_strength(stem, strength)) == (text, name)
        options = METHODS[name].ccdiff
        assert (options["criticality"], options["denoising_steps"]) == (strength, 1)
    assert METHODS.without_strength("idm?headway_s=0.5-1") is None


def test_benches_play_drivers_with_options(tmp_path, capsys):
    text = "idm?headway_s=4"
    scene = ["--scenes", "embedded/val", "--limit", "1", "--workers", "1", "--out"]
    assert (
        cli.main(["bench", "traffic", "--methods", f"{text},idm", *scene, str(tmp_path / "a")]) == 0
    )
    words = ["bench", "planners", "--planners", "idm", "--traffic", f"{text},idm", "--seeds", "0"]
    assert cli.main([*words, *scene, str(tmp_path / "b")]) == 0
    assert "IDM, headway_s=4" in capsys.readouterr().out
