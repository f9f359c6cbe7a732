"""Doors of the package: what is no file, costs far more than its size, or is no number."""

from __future__ import annotations

import csv
import json
import os
import pickle
import re
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import EgoEnv, Rollout, Scene, errors, policies
from ccdiff_env.bench.leaderboard import write_leaderboard
from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.scenario_sets import load_scenario_set
from ccdiff_env.cli import main
from ccdiff_env.metrics import Motion
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.policies.planners import load_sb3
from ccdiff_env.record.bank import load_bank
from ccdiff_env.record.certificate import Certificate
from ccdiff_env.scenes.embedded import VERSION, unpack
from ccdiff_env.system import files
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.traffic import read_ranking
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.live import read_curves
from ccdiff_env.view.page import page_html
from ccdiff_env.view.play import _moves
from ccdiff_env.view.sources import log_rollout

ROOT = Path(__file__).resolve().parents[1]


def scene():
    return ccdiff_env.embedded_scenes()[0]


# What is no file


def bank(path):
    (path.parent / "bank.json").write_text("{}")
    return load_bank(path.parent)


def board(path):
    (path.parent / "scores.csv").write_text("planner,traffic,scene,score\nidm,idm,a,0.5\n")
    return write_leaderboard([path.parent], path.parent / "page.html")


def data_set(table):
    def load(path):
        folder = path.parents[len(Path(table).parts) - 1]
        kept = path.parent / "kept"
        path.rename(kept)
        unpack(folder)
        path.unlink()
        kept.rename(path)
        return ccdiff_env.load_nuscenes(folder, VERSION, cache=folder / "cache")

    return load


DOORS = {
    "scenario": (ccdiff_env.load_scenarionet, "a.pkl"),
    "scenarios of a folder": (lambda path: ccdiff_env.load_scenarionet(path.parent), "a.pkl"),
    "rollout": (Rollout.load, "a.npz"),
    "pages": (lambda path: write_pages(path.parent, path.parent / "out"), "a.npz"),
    "certificate": (Certificate.load, "a.json"),
    "ranking": (read_ranking, "a.json"),
    "scenario set": (load_scenario_set, "manifest.json"),
    "leaderboard": (board, "run.json"),
    "bank": (bank, "0.scenes"),
    "policy": (policies.load, "a.safetensors"),
    "policy of stable-baselines3": (load_sb3, "a.zip"),
    "weights": (TrajectoryModel, "a.safetensors"),
    "weights of traffic": (
        lambda path: EgoEnv(traffic="ccdiff", ccdiff={"weights": str(path)}),
        "a.safetensors",
    ),
    "table": (data_set(f"{VERSION}/sample.json"), f"{VERSION}/sample.json"),
    "map": (data_set("maps/expansion/ccdiff-town.json"), "maps/expansion/ccdiff-town.json"),
}


@pytest.mark.timeout(30)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize("name", DOORS)
@pytest.mark.filterwarnings("ignore:left out")
def test_what_is_no_file_is_refused_at_once(tmp_path, name, kind):
    read, file = DOORS[name]
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        os.symlink("/dev/zero", path)
    else:
        path.mkdir()
    start = time.process_time()
    with pytest.raises(errors.CcdiffError):
        read(path)
    assert time.process_time() - start < 5.0


@pytest.mark.timeout(30)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_caches_and_curves_go_on_without_what_is_no_file(tmp_path, kind):
    unpack(tmp_path)
    cache, names = tmp_path / "cache", [scene().name]
    load = lambda: ccdiff_env.load_nuscenes(tmp_path, VERSION, scenes=names, cache=cache)  # noqa: E731
    before = load()
    (kept,) = [path for path in cache.rglob("*") if path.parent.name == "scene"]
    kept.unlink()
    curves = tmp_path / "run" / "a.csv"
    curves.parent.mkdir()
    for path in (kept, curves):
        os.mkfifo(path) if kind == "pipe" else os.symlink("/dev/zero", path)
    again = load()
    assert again[0] == before[0]
    assert "damaged" in again.report.cache.notes[0]
    assert read_curves(curves.parent) == []


def test_files_are_read_by_one_function_and_written_aside():
    """But for the files of the package itself, and curves, which are appended to."""
    opens = r"\.(?:read|write)_(?:bytes|text)\(|\bopen\(|np\.load\((?!io\.)|ZipFile\((?!io\.)"
    own = r"webbrowser|resources|as_file|style\.read_text|in files\)|path\.open\(\"a\""
    own += r"|ZipFile\(packed|file\.open\(info\)"
    for path in (ROOT / "ccdiff_env").rglob("*.py"):
        if path.name != "files.py":
            lines = path.read_text(encoding="utf-8").splitlines()
            found = [line for line in lines if re.search(opens, line) and not re.search(own, line)]
            assert not found, f"{path}: {found}"


def test_a_file_that_is_written_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), files.writing(path) as file:
        csv.writer(file).writerow([1, 1 / 0])
    assert path.read_text() == "before"
    os.symlink(path, tmp_path / f".b.csv.{os.getpid()}")
    with files.writing(tmp_path / "b.csv") as file:
        csv.writer(file).writerow([1, 2])
    assert (tmp_path / "b.csv").read_bytes() == b"1,2\r\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "b.csv"]
    assert path.read_text() == "before"


# What costs far more than its size


def described(**changes):
    log, path = scene(), Path("unused")
    del path
    from ccdiff_env.scenes.scenarionet_export import scenario_dict

    return scenario_dict(log) | changes


def load_pickled(folder, data):
    (folder / "a.pkl").write_bytes(data)
    start = time.process_time()
    with pytest.raises(errors.DatasetError, match=r"a\.pkl"):
        ccdiff_env.load_scenarionet(folder / "a.pkl")
    assert time.process_time() - start < 3.0


def test_lanes_that_share_a_list_of_lanes(tmp_path):
    names = [f"l{i}" for i in range(4000)]
    line = np.array([[0.0, 0.0], [9.0, 0.0]])
    lane = {"type": "LANE_SURFACE_STREET", "polyline": line, "exit_lanes": names}
    load_pickled(tmp_path, pickle.dumps(described(map_features=dict.fromkeys(names, lane)), 4))


@pytest.mark.parametrize("container", ["dict", "set"])
def test_numbers_that_share_a_hash(tmp_path, container):
    keys = b"".join(
        b"\x8a\x0a" + (i * (2**61 - 1)).to_bytes(10, "little", signed=True)
        + (b"N" if container == "dict" else b"")
        for i in range(1, 40_000)
    )  # fmt: skip
    inner = pickle.dumps(described(), 4)
    start, end = (b"}(", b"u") if container == "dict" else (b"\x8f(", b"\x90")
    load_pickled(tmp_path, inner[:2] + b"}\x8c\x01x" + start + keys + end + b"s.")


def test_sets_and_a_few_numbers_as_keys_are_read(tmp_path):
    path = tmp_path / "a.pkl"
    extra = {"a": {1, 2}, "b": frozenset("xy"), "c": dict.fromkeys(range(5000))}
    for protocol in (3, 4, 5):
        path.write_bytes(pickle.dumps(described(extra=extra), protocol))
        assert ccdiff_env.load_scenarionet(path)[0].num_agents == scene().num_agents


def test_banks_of_many_scenes_that_unpack_to_far_more(tmp_path):
    steps = 60_000
    made = Scene.from_arrays(
        "n",
        agent_ids=["ego", *map(str, range(40))],
        agent_types=["vehicle"] * 41,
        sizes=np.full((41, 3), 2, np.float32),
        position=np.zeros((41, steps, 2), np.float32),
        heading=np.zeros((41, steps), np.float32),
        velocity=np.zeros((41, steps, 2), np.float32),
        valid=np.ones((41, steps), bool),
    ).to_bytes()
    (tmp_path / "bank.json").write_text("{}")
    parts = [zlib.compress(made.replace(b"\1n", bytes([1, 65 + i]), 1), 9) for i in range(4)]
    data = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    assert len(data) < 1e6 < 1e8 < 4 * len(made)
    (tmp_path / "0.scenes").write_bytes(data)
    with pytest.raises(errors.DatasetError, match=r"far more.*0\.scenes"):
        load_bank(tmp_path)


# What is no number, and other untyped ends


def with_head(path, change):
    log_rollout(scene()).save(path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    head = json.loads(arrays.pop("head").tobytes())
    text = change(head)
    if not isinstance(text, str):
        text = json.dumps(head)
    np.savez(path, **arrays, head=np.frombuffer(text.encode(), np.uint8))
    return path


@pytest.mark.parametrize("number", ["Infinity", "NaN", "1e400", "1" + "0" * 400, "-1e999"])
@pytest.mark.parametrize("place", ["start_step", "dt_s", "event", "plan", "meta"])
def test_recordings_hold_numbers_that_can_be_computed_with(tmp_path, number, place):
    def change(head):
        held = {
            "event": {"events": [["#", "ego", None, "goal", 0]]},
            "plan": {"plans": [["#", []]]},
        }
        return json.dumps(head | held.get(place, {place: "#"})).replace('"#"', number)

    with pytest.raises(errors.DatasetError, match=r"a\.npz"):
        Rollout.load(with_head(tmp_path / "a.npz", change))


@pytest.mark.parametrize("config", [{"policies": 3}, {"policies": ["ccdiff"]}, [], 3], ids=str)
def test_pages_of_recordings_with_any_configuration(tmp_path, config):
    def change(head):
        head["meta"]["config"] = config

    assert "<html" in page_html(Rollout.load(with_head(tmp_path / "a.npz", change)))


def scenario(path, **changes):
    path.write_bytes(pickle.dumps(described(**changes), 4))
    return ccdiff_env.load_scenarionet(path)


def policy_with(path, shape):
    tensors, about = read_tensors(policies.SHIPPED["ego"])
    write_tensors(path, tensors, about)
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    head = json.loads(data[8 : 8 + length])
    head["mean"]["shape"] = "#"
    text = json.dumps(head).replace('"#"', shape).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
    return policies.load(path)


def weights_with(path, shape):
    data = Path(shipped_weights()).read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    head = json.loads(data[8 : 8 + length])
    last = max(part["data_offsets"][1] for name, part in head.items() if name[0] != "_")
    head["a"] = {"dtype": "F32", "shape": shape, "data_offsets": [last, last]}
    text = json.dumps(head).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
    return TrajectoryModel(path)


def run_json(path, text):
    board_of = {"benchmark": "planners", "source": {"embedded": "val"}, "seed": 0, "weights": "#"}
    path.write_text(json.dumps(board_of).replace('"#"', text))
    return board(path)


def sb3(path, text):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("data", text)
    return load_sb3(path)


UNTYPED = {
    "length": lambda p: scenario(p / "a.pkl", length=10**5000),
    "data set": lambda p: scenario(p / "a.pkl", metadata={"dataset": np.zeros(3)}),
    "metadata of a track": lambda p: scenario(
        p / "a.pkl",
        tracks={k: t | {"metadata": np.zeros(3)} for k, t in described()["tracks"].items()},
    ),
    "shape of a policy": lambda p: policy_with(p / "a.safetensors", "[Infinity]"),
    "shape of weights": lambda p: weights_with(p / "a.safetensors", [0, 2**63]),
    "shape beyond 64 bits": lambda p: weights_with(p / "a.safetensors", [0, 2**62]),
    "half a letter": lambda p: run_json(p / "run.json", '"\\ud800"'),
    "nested": lambda p: sb3(p / "a.zip", "[" * 100_000),
    "list": lambda p: sb3(p / "a.zip", "[]"),
    "class": lambda p: sb3(p / "a.zip", '{"policy_class": {"__module__": "os"}}'),
    "spaces": lambda p: sb3(p / "a.zip", json.dumps({"x": 1})),
    "no archive": lambda p: (p / "a.zip").write_bytes(b"PK") and load_sb3(p / "a.zip"),
}


@pytest.mark.parametrize("name", UNTYPED)
def test_loaders_raise_errors_of_the_package_alone(tmp_path, name):
    with pytest.raises(errors.CcdiffError, match=re.escape(str(tmp_path))):
        UNTYPED[name](tmp_path)


@pytest.mark.parametrize("text", ['{"a":' + "[" * 50_000, '{"a":[1e999,0]}', '{"a":[1]}', "3", "{"])
def test_moves_of_the_playground(text):
    with pytest.raises(errors.ConfigError, match="moves"):
        _moves(text)


def test_results_of_jobs_are_rows(tmp_path, capsys):
    words = ["bench", "planners", "--planners", "idm", "--traffic", "replay", "--limit", "1"]
    words += ["--out", str(tmp_path), "--quiet", "--replays", "1", "--seeds", "0"]
    assert main(words) == 0
    page = tmp_path / "report.html"
    whole = page.read_text()
    (job,) = (tmp_path / "raw").glob("replay-*.json")
    made = json.loads(job.read_text())
    for address in ("javascript:void(0)//", "../../x.html", "replays/other.html"):
        made["result"]["pages"] = dict.fromkeys(made["result"]["pages"], address)
        job.write_text(json.dumps(made))
        assert main(words) == 2
        assert "the page of" in capsys.readouterr().err
    job.unlink()
    (row,) = [path for path in (tmp_path / "raw").glob("*.json") if path.name[:6] != "replay"]
    kept = row.read_text()
    for result in ([], {}, [3], None, [{}]):
        row.write_text(json.dumps({**json.loads(kept), "result": result}))
        assert main(words) == 2, result
        assert row.name in capsys.readouterr().err
    row.write_text(kept)
    assert main(words) == 0
    assert page.read_text().count('class="card" href="replays/') == whole.count('class="card"') == 1


# What a browser runs


def test_pages_run_their_own_script_alone(tmp_path):
    import base64
    import hashlib

    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "a.svg").write_text("<svg onload='alert(1)'><script>alert(2)</script></svg>")
    write_report_page(
        tmp_path / "r.html", title="t", line="l", plots=[tmp_path / "a.png"], parts={"x": "y"},
        images=[(name, name, tmp_path / "none.png") for name in ADDRESSES],
    )  # fmt: skip
    report = (tmp_path / "r.html").read_text()
    assert re.findall(r'class="card" href="([^"]*)"', report) == ["replays/a.html#t=1:0"]
    for page in (report, page_html(log_rollout(scene()))):
        (policy,) = re.findall(r"script-src ([^;]*);", page)
        own = page[page.rindex("<script>") + 8 : page.rindex("</script>")]
        digest = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
        assert policy == f"'sha256-{digest}'"


ADDRESSES = ("javascript:alert(1)", "JaVaScript:x", "data:text/html,x", "replays/a.html#t=1:0")


# Snapshots


@pytest.mark.parametrize("order", ["random", "sequential"])
def test_snapshots_of_others_give_worlds_that_go_on(order):
    scenes = ccdiff_env.embedded_scenes()[:3]
    env = EgoEnv(scenes=scenes, traffic="idm", scene_order=order)
    env.reset(seed=5)
    action = np.zeros(2, np.float32)
    for _ in range(5):
        env.step(action)
    good = env.snapshot()
    name = env.scenes[env.worlds.native.status(0).scene_idx].name.encode()
    start = good.rindex(name) + len(name)
    nan, taken = struct.pack("<f", float("nan")), 0
    changed = [good[:at] + nan + good[at + 4 :] for at in range(start, len(good) - 4, 3)]
    numbers = (b"\3", b"\xe8\7", b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\1")
    changed += [good[:at] + n + good[at + 1 :] for at in range(start, start + 60) for n in numbers]
    for bytes_ in changed:
        try:
            env.restore(bytes_)
        except errors.SnapshotError:
            continue
        taken += 1
        try:
            obs, reward, _, _, info = env.step(action)
        except errors.ResetNeededError:
            pass
        else:
            assert np.isfinite(obs).all()
            assert np.isfinite([reward, *(v for v in info.values() if isinstance(v, float))]).all()
        env.reset()
    assert taken > 0
    env.restore(good)
    assert env.snapshot() == good


# What is said


def test_terminals_of_ascii():
    code = "import sys; from ccdiff_env_cli import main; sys.exit(main(['scenes']))"
    plain = {**os.environ, "PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert b"----" in done.stdout


@pytest.mark.parametrize("verb", [["view"], ["bench", "planners"], ["rollout"]])
def test_help_says_which_policies_run_code(verb, capsys):
    with pytest.raises(SystemExit):
        main([*verb, "--help"])
    assert "runs the code in it" in " ".join(capsys.readouterr().out.split())


def test_a_foreign_file_does_not_end_a_folder_of_pages(tmp_path):
    log_rollout(scene()).save(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", x=np.zeros(3))
    with pytest.warns(UserWarning, match=r"b\.npz"):
        pages = write_pages(tmp_path, tmp_path / "out", thumbnails=False)
    assert [page.name for page in pages] == ["index.html", "a.html"]


@pytest.mark.parametrize("size", [-1.0, float("nan"), float("inf")])
def test_sizes_of_recorded_scenes(size):
    arrays = np.zeros((1, 5, 2)), np.zeros((1, 5))
    with pytest.raises(errors.SceneError, match="size"):
        Motion(*arrays, np.full((1, 2), size))


@pytest.mark.parametrize(
    "change",
    [{"dt": 1e-30}, {"dt": 1e3}, {"height": np.nan}, {"name": "\x1b[2J"}, {"ids": ["a\nb"]}],
    ids=str,
)
def test_scenes_of_absurd_values(change):
    with pytest.raises(errors.SceneError):
        Scene.from_arrays(
            change.get("name", "x"),
            agent_ids=change.get("ids", ["ego"]),
            agent_types=["vehicle"],
            sizes=np.array([[4.0, 2.0, change.get("height", 1.5)]], np.float32),
            position=np.zeros((1, 60, 2), np.float32),
            heading=np.zeros((1, 60), np.float32),
            velocity=np.zeros((1, 60, 2), np.float32),
            valid=np.ones((1, 60), bool),
            dt=change.get("dt", 0.1),
        )
