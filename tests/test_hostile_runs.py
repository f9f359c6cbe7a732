"""Run folders of strangers: every door refuses every damage in words, and runs no code."""

import base64
import copy
import json
import pickle
import tracemalloc
import zipfile

import pytest

from ccdiff_env import cli, errors
from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.bench.record import Record
from ccdiff_env.bench.verify import verify

PLANNER = """
import numpy as np

class Still:
    def __call__(self, obs):
        return np.zeros((len(obs), 2), np.float32)
"""
PARTS = [*PROTOCOL.fields["score"]["gates"], *PROTOCOL.fields["score"]["weights"]]


@pytest.fixture(scope="module")
def members(tmp_path_factory):
    """What a sound run holds, by name: custom planners and of the package."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "attack_planner.py").write_text(PLANNER)
    words = ["--planners", "attack_planner:Still,pdm,idm", "--traffic", "replay,idm"]
    words += ["--limit", "2", "--seeds", "0", "--quiet", "--out", str(folder / "run")]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        assert cli.main(["bench", "planners", *words]) == 0
    raw = {f"raw/{p.name}": json.loads(p.read_text()) for p in (folder / "run/raw").iterdir()}
    made_with = json.loads((folder / "run/run.json").read_text())
    return {"run.json": made_with, **dict(sorted(raw.items()))}


def unpacked(folder, members):
    """Write members as a run folder."""
    (folder / "raw").mkdir(parents=True)
    for name, fields in members.items():
        (folder / name).write_text(json.dumps(fields))
    return folder


def entries_of(members, planner="attack_planner:Still"):
    found = [m for name, m in members.items() if name.startswith("raw/")]
    return [m for m in found if m["arguments"]["planner"] == planner]


def each(change, planner="attack_planner:Still"):
    """A damage to all raw results of a planner."""

    def damage(members):
        for entry in entries_of(members, planner):
            change(entry)

    return damage


def named(planner, source=None, *, recorded=False):
    """Another planner's name, without a source; without actions, so that it would be played."""

    def change(entry):
        entry["arguments"].update(planner=planner, sources={"planner": source, "traffic": None})
        for row in entry["result"]:
            if not recorded:
                del row["actions"], row["action"]

    return each(change)


def rows(**values):
    return each(lambda entry: [row.update(values) for row in entry["result"]])


def made_from(**values):
    return each(lambda entry: entry["made_from"].update(values))


def arguments(**values):
    return each(lambda entry: entry["arguments"].update(values))


def alone(**values):
    """The same to one of them, without the others."""

    def damage(members):
        for name in [name for name, m in members.items() if name.startswith("raw/")][1:]:
            del members[name]
        arguments(**values)(members)

    return damage


def perfect(entry):
    for row in entry["result"]:
        row.update(dict.fromkeys(PARTS, 1.0), success=1.0, collision=0.0)
        row["score"] = score_of(row)


#: What is changed in a sound run, and what the refusal says.
DAMAGES = {
    "a file of pickles": (named("evil.zip"), "source"),
    "a file of pickles, with a source": (named("evil.zip", "0" * 64), "without its actions"),
    "a policy": (named("evil.safetensors", "0" * 64), "without its actions"),
    "a module": (named("attack_evil:Planner"), "source"),
    "a module, with a source": (named("attack_evil:Planner", "0" * 64), "without its actions"),
    "a module as an option": (named("ego?x=attack_evil:Planner"), "source"),
    "a name of nobody": (named("pdm2"), "source"),
    "no source": (named("attack_planner:Still", recorded=True), "source"),
    "a name of the package with a source": (named("pdm", "0" * 64, recorded=True), "source"),
    "traffic of a module": (alone(traffic="attack_evil:Model"), "--own-code"),
    "traffic of a file": (alone(traffic="adversary:evil.zip"), "--own-code"),
    "lines in the version": (made_from(version="0.2\n\n| mine | 1.00 |"), "text"),
    "a long version": (made_from(version="1" * 41), "version"),
    "lines in the weights": (made_from(weights="\n# x"), "text"),
    "letters of a terminal": (arguments(planner="m:\x1b[2J"), "text"),
    "another run": (lambda members: members["run.json"].update(benchmark="traffic"), "planners"),
    "no source of scenes": (arguments(source=None), "source"),
    "scenes of an older form": (arguments(source={"embedded": "val"}), "source"),
    "a seed of text": (arguments(seed="<script>"), "seed"),
    "options of its own": (arguments(options={"horizon_steps": 5}), "no result"),
    "half a window": (arguments(window={"horizon_steps": 5}), "window"),
    "a window of no step": (arguments(window={"history_steps": 30, "horizon_steps": 0}), "window"),
    "made from a list": (each(lambda e: e.update(made_from=[])), "made_from|version|scenes"),
    "a function of others": (each(lambda e: e.update(function="os:system")), "no result"),
    "a scene of a list": (rows(scene=[]), "scene"),
    "one row less": (each(lambda e: e["result"].pop()), "scenes"),
    "names of others": (arguments(names=["other"]), "hashes"),
    "a score that is no number": (rows(score=float("nan")), "NaN"),
    "a part as text": (rows(ttc="1.0"), "ttc"),
    "a part as a truth": (rows(ttc=True), "ttc"),
    "a part beyond 1": (rows(progress=1e308), "progress"),
    "a score of its own": (rows(score=0.123), "its parts make"),
    "damaged actions": (rows(actions="A"), "damaged actions"),
    "a source of 6,000 letters": (arguments(source="nuscenes:" + "a/" * 3000), "a/a"),
    "no scenes": (arguments(names=[], source="embedded/val?limit=0"), "damaged"),
    "other hashes": (each(lambda e: e["made_from"].update(
        scenes=dict.fromkeys(e["made_from"]["scenes"], "0"))), "has hash"),
    "another protocol": (made_from(protocol="0"), "another protocol"),
    "no run": (lambda members: members.pop("run.json"), "run.json"),
    "no results": (lambda m: [m.pop(n) for n in [*m] if n.startswith("raw/")], "no raw results"),
}  # fmt: skip


class Evil:
    """A pickle that leaves a trace."""

    def __init__(self, trace):
        self.trace = str(trace)

    def __reduce__(self):
        return open, (self.trace, "w")


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """A folder whose module and policy leave a trace where they are opened."""
    trace = tmp_path / "trace"
    (tmp_path / "attack_evil.py").write_text(f"open({str(trace)!r}, 'w')\n")
    serialized = base64.b64encode(pickle.dumps(Evil(trace))).decode()
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as file:
        file.writestr("data", json.dumps({"x": {":type:": "x", ":serialized:": serialized}}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    assert not trace.exists()


def through_all_doors(path):
    """Everything that reads a run, until one refuses."""
    record = Record.read(path)
    return record.tables(), verify(record)


@pytest.mark.parametrize("name", DAMAGES)
@pytest.mark.usefixtures("trap")
def test_what_is_damaged_is_refused(tmp_path, members, name):
    changed = copy.deepcopy(members)
    damage, words = DAMAGES[name]
    damage(changed)
    with pytest.raises(errors.CcdiffError, match=words):
        through_all_doors(unpacked(tmp_path / "run", changed))


def test_sound_ones_go_through_all_doors(tmp_path, members):
    ((_, table),), found = through_all_doors(unpacked(tmp_path / "a", members))
    assert (found.played, found.there, found.differing) == (12, 12, ())
    assert "attack_planner:Still" in table


def test_traffic_of_ones_own_runs_where_it_is_asked_for(tmp_path, members, monkeypatch):
    (tmp_path / "attack_own.py").write_text("def model(batch):\n    raise ZeroDivisionError\n")
    monkeypatch.syspath_prepend(tmp_path)
    changed = copy.deepcopy(members)
    alone(traffic="attack_own:model")(changed)
    folder = unpacked(tmp_path / "run", changed)
    with pytest.raises(errors.ConfigError, match="--own-code"):
        verify(Record.read(folder))
    with pytest.raises(errors.PolicyError, match="ZeroDivisionError"):
        verify(Record.read(folder), own_code=True)


@pytest.mark.parametrize(
    ("text", "count", "words"),
    [
        ('{"a":[' + "[]," * (20 << 20) + "[]]}", 1, "values"),
        ('{"a":[' + "null," * (3 << 20) + "0]}", 3, "values"),
        ('{"a":"' + "x" * (65 << 20) + '"}', 1, "bytes"),
        ('{"a":' + "[" * 100_000, 1, "nested"),
        ('{"a":1e999}', 1, "finite"),
        (b"\xff\xfe", 1, "damaged"),
    ],
    ids=["lists", "values", "bytes", "nested", "1e999", "no text"],
)
def test_costly_results_are_refused_before_they_cost(tmp_path, members, text, count, words):
    folder = unpacked(tmp_path / "run", members)
    for i in range(count):
        text = text if isinstance(text, bytes) else text.encode()
        (folder / f"raw/{i}.json").write_bytes(text)
    tracemalloc.start()
    try:
        with pytest.raises(errors.DatasetError, match=words):
            Record.read(folder)
        assert tracemalloc.get_traced_memory()[1] < 400e6
    finally:
        tracemalloc.stop()


# forged figures


def test_a_draw_is_not_known_beforehand_and_can_be_repeated(tmp_path, members, capsys):
    record = Record.read(unpacked(tmp_path / "a", members))
    drawn = [verify(record, episodes=1) for _ in range(5)]
    assert len({found.seed for found in drawn}) == 5
    assert {(found.played, found.there) for found in drawn} == {(2, 12)}
    forged = copy.deepcopy(members)
    perfect(entries_of(forged)[0])
    path = unpacked(tmp_path / "b", forged)
    caught = [bool(verify(Record.read(path), episodes=1, seed=s).differing) for s in range(12)]
    assert {False, True} == set(caught)  # one of six batches is forged
    seed = caught.index(True)
    capsys.readouterr()
    assert cli.main(["bench", "verify", str(path), "--episodes", "1", "--seed", str(seed)]) == 1
    assert f"2 of 12 were replayed (--seed {seed})" in capsys.readouterr().out
    assert verify(Record.read(path)).differing


def test_actions_under_the_name_of_the_package_are_those_that_it_chooses(tmp_path, members):
    forged = copy.deepcopy(members)
    own = entries_of(forged, "pdm")
    forged = {name: fields for name, fields in forged.items() if fields not in own}
    named("pdm", recorded=True)(forged)
    found = verify(Record.read(unpacked(tmp_path / "a", forged)))
    assert len(found.differing) == 4
    assert all(line.startswith("pdm in ") for line in found.differing)


@pytest.mark.parametrize(("planner", "dagger"), [("idm", True), ("pdm", False)])
def test_the_dagger_of_the_package_is_not_declared(tmp_path, members, planner, dagger):
    forged = copy.deepcopy(members)
    each(lambda e: e["made_from"].update(privileged=not dagger), planner)(forged)
    entries = Record.read(unpacked(tmp_path / "a", forged)).entries
    assert {e.privileged for e in entries if e.planner == planner} == {dagger}
