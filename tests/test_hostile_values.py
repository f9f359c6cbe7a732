"""Values, names, folders and bytes made to harm are refused in words, or do nothing."""

import base64
import dataclasses
import hashlib
import json
import os
import re
import resource
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from array_scenes import STEPS, agent, array_scene, begun

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv, Scene, WorldConfig, _native, embedded_scenes, errors
from ccdiff_env.bench import scenarios
from ccdiff_env.bench.page import write_report_page
from ccdiff_env.bench.replays import write_replay
from ccdiff_env.cli import main
from ccdiff_env.config import BevConfig, ObservationConfig
from ccdiff_env.metrics import Motion
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack
from ccdiff_env.system import files
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.page import page_html
from ccdiff_env.view.sources import log_rollout

ROOT = Path(__file__).resolve().parents[1]


def rollout():
    return log_rollout(ccdiff_env.embedded_scenes()[0])


# names and folders

NAMES = ("../../pwned", "/pwned", "..", "", ".", "a/b", "a\\b", "con\0x", "x" * 5000, "\x1b[2J")


def test_names_of_files_stay_in_their_folder(tmp_path):
    found = [files.file_name(name, ".html") for name in NAMES]
    for name in found:
        assert (tmp_path / name).resolve().parent == tmp_path.resolve()
        (tmp_path / name).write_text("")
    assert len(set(found)) == len(NAMES)
    assert files.file_name("scene-0061") == "scene-0061"


def test_names_of_scenes_are_no_paths(tmp_path, monkeypatch):
    deep = tmp_path / "one" / "two"
    deep.mkdir(parents=True)
    monkeypatch.chdir(deep)
    for name in ("../../pwned", str(tmp_path / "pwned")):
        scene = rollout().to_scene(name)
        log_rollout(scene).save("evil.npz")
        assert main(["view", "evil.npz"]) == 0
        page = deep / "replays" / files.file_name(f"x-{name}", ".html")
        write_replay(log_rollout(scene), page)
        monkeypatch.setattr(scenarios, "scenes_of", lambda *_, scene=scene: [scene])
        scenarios.generate(
            source="embedded/val", names=[name], generator="replay", traffic="replay", seed=0,
            folder="set", num_plans=1,
        )  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    assert [path.name for path in deep.parent.iterdir()] == ["two"]


def test_pages_of_a_folder_do_not_replace_each_other_and_a_foreign_file_is_left_out(tmp_path):
    (tmp_path / "a").mkdir()
    rollout().save(tmp_path / "a-b.npz")
    rollout().save(tmp_path / "a" / "b.npz")
    np.savez(tmp_path / "c.npz", x=np.zeros(3))
    with pytest.warns(UserWarning, match=r"c\.npz"):
        index = write_pages(tmp_path, tmp_path / "pages")
    assert len([*index.parent.glob("*.html")]) == 3


@contextmanager
def files_of(most_bytes):
    """Files cannot get larger, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("view left-turn-00 -o", "a.gif"),
        ("view left-turn-00 -o", "a.mp4"),
        ("train-ego --smoke --out", "checkpoint.pt"),
    ],
)
def test_no_half_of_a_video_or_a_checkpoint_is_left(words, name, tmp_path, capsys):
    embedded_scenes("all"), embedded_scenes("train")  # unpacked before
    learns = words.startswith("train")
    (path := tmp_path / name).write_text("before")
    with files_of(20_000):
        assert main([*words.split(), str(tmp_path / "run" if learns else path)]) == 2
    assert f"{name}'" in capsys.readouterr().err
    assert path.read_text() == "before"
    assert {file.name for file in tmp_path.iterdir()} == {name, *["run"] * learns}
    assert not [*(tmp_path / "run").rglob("*checkpoint*")]


def test_a_file_that_is_written_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("before")
    os.symlink(path, tmp_path / f".b.csv.{os.getpid()}")
    files.write_aside(tmp_path / "b.csv", "1,2\r\n")
    assert (tmp_path / "b.csv").read_bytes() == b"1,2\r\n"
    with files_of(1000), pytest.raises(OSError, match=r"File too large: '.*a\.csv'$"):
        files.write_aside(path, "x" * 10**6)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "b.csv"]
    assert path.read_text() == "before"
    longest = tmp_path / ("é" * 125 + ".html")  # 255 bytes, the most that a name may have
    files.write_aside(longest, "whole")
    assert longest.read_text() == "whole"
    for folder in (tmp_path, Path("."), path / "below a file"):
        with pytest.raises(OSError, match=r"'.*'$"):
            files.write_aside(folder, "no file")
    assert len([*tmp_path.iterdir()]) == 3
    files.write_aside(tmp_path / "new" / "folder" / "a.csv", "1,2")
    assert (tmp_path / "new" / "folder" / "a.csv").read_text() == "1,2"
    os.mkfifo(pipe := tmp_path / "pipe")
    os.symlink(pipe, link := tmp_path / "link")
    for special in (pipe, link):
        with pytest.raises(OSError, match=r"Not a regular file: '.*'$"):
            files.write_aside(special, "no file")
    assert pipe.is_fifo()
    assert link.is_symlink()


# scenes

HALF = "\ud800"
LANE = {
    "id": "0", "kind": "lane", "polygon": {"exterior": np.zeros((0, 2), np.float32), "holes": []},
    "successors": [], "predecessors": [], "speed_limit_mps": None,
    "centreline": np.zeros((2, 2), np.float32),
}  # fmt: skip


def scene_with(line=None, **changes):
    """A car that stands for six seconds, with a lane and changes."""
    arrays = {
        "name": "x",
        "agent_ids": ["ego"],
        "agent_types": ["vehicle"],
        "sizes": np.array([[4.5, 1.9, 1.6]], np.float32),
        "position": np.zeros((1, 60, 2), np.float32),
        "heading": np.zeros((1, 60), np.float32),
        "velocity": np.zeros((1, 60, 2), np.float32),
        "valid": np.ones((1, 60), bool),
        "map_layers": {"lanes": [] if line is None else [{**LANE, "centreline": line}]},
    }
    return Scene.from_arrays(**arrays | changes)


def jumping(step_m):
    position = np.zeros((1, 60, 2), np.float32)
    position[0, ::2, 0] = step_m
    return position


@pytest.mark.parametrize(
    ("change", "words"),
    [
        *(({"line": np.array([[0, 0], [x, 0]], np.float32)}, "map") for x in (3e11, 2.5e11, 1e7)),
        ({"line": np.array([[i % 2 * 1e6, i] for i in range(100)], np.float32)}, "map"),
        ({"position": jumping(9e5)}, "paths"),
        ({"sizes": np.array([[1e30, 2, 1]], np.float32)}, "size"),
        ({"sizes": np.array([[4, 2, np.nan]], np.float32)}, "size"),
        ({"heading": np.full((1, 60), 1e30, np.float32)}, "heading"),
        ({"dt": 1e-30}, "dt|step"),
        ({"dt": 1e3}, "dt|step"),
        ({"name": "\x1b[2J"}, "control char"),
        ({"agent_ids": ["a\nb"]}, "control char"),
        *(({"location": f"a{mark}b"}, "control char") for mark in "\u202a\u202e\u2066\u2069"),
        *(({key: HALF}, "unpaired surrogate") for key in ("name", "token", "location", "source")),
        *(
            ({f"agent_{key}": [HALF]}, "unpaired surrogate")
            for key in ("ids", "types", "categories")
        ),
        ({"map_layers": {HALF: []}}, "unpaired surrogate"),
        *(
            ({"map_layers": {"lanes": [{**LANE, key: HALF}]}}, "surrogate")
            for key in ("id", "kind")
        ),
    ],
    ids=lambda value: ascii(value)[:30],
)
def test_scenes_of_absurd_values(change, words):
    with pytest.raises(errors.SceneError, match=words):
        scene_with(**change)


def test_a_scene_without_an_ego_says_how_to_name_one():
    scene = scene_with(agent_ids=["car"])
    with pytest.raises(errors.SceneError, match=r'agents is \["car"\].*with_ego.*step 30'):
        EgoEnv(scenes=scene)
    assert EgoEnv(scenes=scene.with_ego("car")).reset(seed=0)
    late = scene_with(valid=np.arange(60)[None] > 40)
    with pytest.raises(errors.SceneError, match=r'is \["ego"\], expected .* is there at step 30'):
        EgoEnv(scenes=late)


def test_a_line_of_a_thousand_kilometres_costs_little():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line = np.array([[0, 0], [9.9e5, 0]], np.float32)
    EgoEnv(scenes=scene_with(line), traffic="idm").reset(seed=0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


def test_a_network_plans_for_agents_a_thousand_kilometres_apart():
    scene = array_scene(agent("ego", np.arange(STEPS) * 1.0), agent("other", 9e5), name="far")
    (plan,) = TrajectoryModel(shipped_weights()).plan([scene], [40])
    assert np.isfinite(plan.samples).all()


def test_thousands_of_vehicles_in_one_place_take_a_step():
    crowd = (agent(f"n{i}", 0.4 * np.arange(40), size=(4.5, 2.0, 1.6)) for i in range(2000))
    env = EgoEnv(scenes=[array_scene(agent("ego", 0.5 * np.arange(40)), *crowd)], traffic="idm")
    env.reset(seed=0)
    assert env.step([0.0, 0.0])[4]["speed"] == 5.0


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_motions_and_episodes_of_absurd_values(value):
    with pytest.raises(errors.SceneError, match="size"):
        Motion(np.zeros((1, 5, 2)), np.zeros((1, 5)), np.full((1, 2), value))
    for dt_s in (value, 1e-30, 1e-3, 1e30):
        with pytest.raises(errors.DatasetError, match="dt_s"):
            dataclasses.replace(rollout(), dt_s=dt_s)


# data sets


@pytest.fixture
def data_set(tmp_path):
    """The embedded scenes as files; loads the first one."""
    unpack(tmp_path)
    name = embedded_splits()["val"][0]

    def load() -> Scene:
        return ccdiff_env.load_nuscenes(tmp_path, VERSION, scenes=[name], cache=False)[0]

    return tmp_path, load


def test_a_lane_of_very_many_pieces_is_refused(data_set):
    folder, load = data_set
    load()
    path = folder / "maps/expansion/ccdiff-town.json"
    town = json.loads(path.read_text())
    lane = next(iter(town["arcline_path_3"]))
    pieces = town["arcline_path_3"][lane] * 100_000
    town["arcline_path_3"][lane] = pieces[:300_000]
    path.write_text(json.dumps(town))
    with pytest.raises(errors.DatasetError, match=r"ccdiff-town\.json"):
        load()


def test_files_may_begin_with_a_byte_order_mark(data_set):
    folder, load = data_set
    plain = load()
    for path in folder.rglob("*.json"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load() == plain


@pytest.mark.parametrize(
    ("file", "name"),
    [
        (f"{VERSION}/sample_annotation.json", "translation"),
        (f"{VERSION}/scene.json", "name"),
        ("maps/expansion/ccdiff-town.json", "drivable_area"),
    ],
)
def test_names_of_fields_with_escapes_are_read(data_set, file, name):
    folder, load = data_set
    before = load().hash
    path = folder / file
    escaped = f'"\\u{ord(name[0]):04x}{name[1:]}"'
    assert json.loads(escaped) == name
    path.write_text(path.read_text().replace(f'"{name}"', escaped))
    assert load().hash == before


# worlds


@pytest.mark.parametrize("count", [0, -1, 10**5, 10**9, 2**62, 2**70, 1.0, "4", True])
def test_absurd_numbers_of_worlds_and_threads(count):
    with pytest.raises(errors.ConfigError, match="num_envs"):
        EgoVectorEnv(count)
    with pytest.raises(errors.ConfigError, match="num_threads"):
        EgoVectorEnv(1, num_threads=count)


def test_observations_that_do_not_fit():
    config = WorldConfig(observation=ObservationConfig(bev=BevConfig(size_px=1024)))
    with pytest.raises(errors.ConfigError, match="bytes"):
        EgoVectorEnv(65_536, config=config, observation="bev")


def test_long_names_are_cut_in_images():
    images = []
    for count in (1_000, 100_000):
        scene = rollout().to_scene("n" * count)
        env = begun(scenes=scene, traffic="replay", render_mode="rgb_array")
        images.append(env.render())
    assert np.array_equal(*images)


# what is said, and what a browser runs


def test_results_of_jobs_are_rows(tmp_path, capsys):
    words = ["bench", "planners", "--planners", "idm", "--traffic", "replay", "--limit", "1"]
    words += ["--out", str(tmp_path), "--quiet", "--replays", "1", "--seeds", "0"]
    assert main(words) == 0
    page = tmp_path / "report.html"
    whole = page.read_text()
    (row,) = (tmp_path / "raw").glob("*.json")
    kept = row.read_text()
    for result in ([], {}, [3], None, [{}]):
        row.write_text(json.dumps({**json.loads(kept), "result": result}))
        assert main(words) == 2, result
        assert row.name in capsys.readouterr().err
    row.write_text(kept)
    assert main(words) == 0
    assert page.read_text().count('href="replays/') == whole.count('href="replays/') > 0


def test_pages_run_their_own_script_alone(tmp_path):
    (tmp_path / "a.svg").write_text("<svg onload='alert(1)'><script>alert(2)</script></svg>")
    write_report_page(
        tmp_path / "r.html", title="t", line="l", plots=[tmp_path / "a.svg"],
        parts={"x": " ".join(f"[a]({address})" for address in ADDRESSES)},
    )  # fmt: skip
    report = (tmp_path / "r.html").read_text()
    assert re.findall(r'<a href="([^"#][^"]*)"', report) == ["replays/a.html#t=1:0"]
    for page in (report, page_html(rollout())):
        (policy,) = re.findall(r"script-src ([^;]*);", page)
        own = page[page.rindex("<script>") + 8 : page.rindex("</script>")]
        digest = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
        assert policy == f"'sha256-{digest}'"


ADDRESSES = ("javascript:alert(1)", "JaVaScript:x", "data:text/html,x", "replays/a.html#t=1:0")


def test_terminals_of_ascii():
    code = "import sys; from ccdiff_env_cli import main; sys.exit(main(['scenes']))"
    plain = {**os.environ, "PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert b"????" in done.stdout


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_daemon_has_no_terminal(closed, tmp_path):
    bench = "bench planners --scenes embedded/val --limit 2 --planners idm --traffic replay"
    short = "--horizon-steps 10 --workers 2 --out"
    for words in ("scenes", f"view left-turn-04 --out {tmp_path}/a", f"{bench} {short} {tmp_path}"):
        line = f"exec {sys.executable} -m ccdiff_env.cli {words} {closed}"
        assert subprocess.run(["sh", "-c", line], cwd=ROOT).returncode == 0
    assert (tmp_path / "report.html").exists()


@pytest.mark.parametrize("verb", [["view"], ["bench", "planners"]])
def test_help_says_which_policies_run_code(verb, capsys):
    with pytest.raises(SystemExit):
        main([*verb, "--help"])
    assert "runs the code in it" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("call", ["causal", "scene", "step"])
def test_any_byte_but_zero_is_true(call):
    """Bytes of those that are set are 2, 3, 254, 255."""
    mask = np.arange(40) % 3 > 0
    odd = np.where(mask, np.resize(np.uint8([2, 3, 254, 255]), 40), 0).astype(np.uint8).view(bool)

    def found(flags):
        if call == "causal":
            states = np.arange(160, dtype=np.float32).reshape(1, 40, 4)
            return _native.causal_pairs(False, states, np.ones((40, 2), np.float32), flags[None])
        if call == "scene":
            return scene_with(valid=np.resize(flags, (1, 60))).tracks()["valid"].view(np.uint8)
        env = EgoVectorEnv(40, traffic="idm")
        env.reset(seed=0)
        env.worlds.native.step(np.zeros((40, 1, 2), np.float32), env.worlds.arrays(), flags)
        return [env.worlds.native.status(i).elapsed_steps for i in range(40)]

    np.testing.assert_equal(found(odd), found(mask))


def test_arrays_of_bools_enter_by_one_function():
    """Bytes of a Rust ``bool`` are 0 and 1: everything else is undefined."""
    for file in (ROOT / "rust/py/src").glob("*.rs"):
        text = file.read_text(encoding="utf-8")
        given = set(re.findall(r"(\w+): &?PyReadonlyArray\w*<[^>]*\bbool\b", text)) - {"array"}
        assert all(re.search(rf"flags\(&?{name}\)", text) for name in given), (file.name, given)
