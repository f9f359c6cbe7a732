"""Experiments of the traffic benchmark: conflict of gradients, own weights."""

import csv
import json
import re
from dataclasses import replace
from hashlib import sha256

from ccdiff_env import cli, models
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.traffic import episodes


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


def test_weights_of_ones_own_drive_the_methods_of_their_network(tmp_path, capsys):
    routes, tokens = models.shipped_weights(routes=True), models.shipped_weights("tokens")
    command = ["bench", "traffic", "--quiet", "--k", "2", "--limit", "2"]

    def rows(folder, *more):
        given = ["--out", str(tmp_path / folder), "--methods", "ccdiff,tokens", *more]
        assert cli.main([*command, *given]) == 0
        raw = (tmp_path / folder / "raw").glob("*-K2-*.json")
        return {f.name.split("-")[0]: json.loads(f.read_text())["result"] for f in raw}

    shipped = rows("shipped")
    own = rows("own", "--weights", f"ccdiff={routes}")
    assert own["ccdiff"] != shipped["ccdiff"]
    assert own["tokens"] == shipped["tokens"]
    digest = sha256(routes.read_bytes()).hexdigest()
    for folder, name in (("shipped", "CCDiff"), ("own", f"CCDiff, own weights {digest[:8]}")):
        folder = tmp_path / folder
        table, page = ((folder / file).read_text() for file in ("table.md", "report.html"))
        assert f"| {name} | 2 |" in table
        assert "| Tokens | 2 |" in table
        assert (f"own ccdiff {digest[:12]}" in page) == (name != "CCDiff")
        for file in ("episodes.csv", "figures.csv"):
            lines = list(csv.DictReader((folder / file).open()))
            found = {row["own_weights"] for row in lines if row["method"] == "ccdiff"}
            assert found == {digest if name != "CCDiff" else ""}
            assert {row["own_weights"] for row in lines if row["method"] == "tokens"} == {""}
    capsys.readouterr()
    for text, said in (
        (f"ccdiff={tokens}", "another run|other settings: own_weights"),
        ("ccdiff", "NETWORK=FILE"),
        (f"idm={tokens}", "NETWORK=FILE"),
        (f"ccdiff={tmp_path}/no", "no weights for ccdiff"),
    ):
        given = ["--out", str(tmp_path / "own"), "--methods", "ccdiff", "--weights", text]
        assert cli.main([*command, *given]) == 2
        assert re.search(said, capsys.readouterr().err), text
    given = ["--out", str(tmp_path / "kind"), "--methods", "ccdiff"]
    assert cli.main([*command, *given, "--weights", f"ccdiff={tokens}"]) == 2
    assert "tokens" in capsys.readouterr().err


def test_rows_without_guidance_say_how_many_samples_they_choose_from():
    assert METHODS["ccdiff_unguided"].label == "CCDiff, no guidance, safest of 5"
    assert METHODS["ccdiff_one_sample"].label == "CCDiff, no guidance, N=1"
    assert METHODS["simnet_unguided"].label == "SimNet, no guidance"
    for name, method in METHODS.items():
        chooses = name.endswith("_unguided") and method.ccdiff["num_samples"] > 1
        assert ("safest of" in method.label) == chooses
