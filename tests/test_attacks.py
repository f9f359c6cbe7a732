"""Files made to harm are refused in words, or do nothing; ``attacks/README.md`` lists them."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import resource
import runpy
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import EgoEnv, EgoVectorEnv, Rollout, Scene, WorldConfig, errors
from ccdiff_env.bench import scenario_sets
from ccdiff_env.bench.arguments import Run, add_run_arguments
from ccdiff_env.bench.jobs import Job, results
from ccdiff_env.bench.replays import write_replay
from ccdiff_env.cli import main
from ccdiff_env.config import BevConfig, ObservationConfig
from ccdiff_env.envs.replay import replay
from ccdiff_env.record.certificate import Certificate
from ccdiff_env.scenes.embedded import VERSION, embedded_splits, unpack
from ccdiff_env.system.files import file_name, write_aside
from ccdiff_env.traffic import read_ranking
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.sources import log_rollout

FOLDER = Path(__file__).parent / "attacks"

#: Pickles that hold nothing which is looked at: they cost no more than their size.
HARMLESS = {"memo_of_64_gib", "nested_50000_deep"}


def test_the_folder_holds_what_its_script_makes():
    kept = {path.name: path.read_bytes() for path in FOLDER.iterdir() if path.suffix != ".py"}
    readme = kept.pop("README.md").decode()
    assert kept == runpy.run_path(str(FOLDER / "make.py"))["files"]()
    assert all(f"`{Path(name).stem}" in readme for name in kept)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.pkl")), ids=lambda path: path.stem)
def test_scenario_pickles(path, capfd):
    start = time.process_time()
    if path.stem in HARMLESS:
        assert ccdiff_env.load_scenarionet(path)[0].num_steps == 11
    else:
        with pytest.raises(errors.DatasetError, match=path.name):
            ccdiff_env.load_scenarionet(path)
    assert time.process_time() - start < 2.0
    assert "attacked" not in capfd.readouterr().out


NAMES = ("../../pwned", "/pwned", "..", "", ".", "a/b", "a\\b", "con\0x", "x" * 5000, "\x1b[2J")


def test_names_of_files_stay_in_their_folder(tmp_path):
    found = [file_name(name, ".html") for name in NAMES]
    for name in found:
        assert (tmp_path / name).resolve().parent == tmp_path.resolve()
        (tmp_path / name).write_text("")
    assert len(set(found)) == len(NAMES)
    assert file_name("scene-0061") == "scene-0061"


def test_names_of_scenes_are_no_paths(tmp_path, monkeypatch):
    deep = tmp_path / "one" / "two"
    deep.mkdir(parents=True)
    monkeypatch.chdir(deep)
    rollout = log_rollout(ccdiff_env.embedded_scenes()[0])
    for name in ("../../pwned", str(tmp_path / "pwned")):
        scene = rollout.to_scene(name)
        log_rollout(scene).save("evil.npz")
        assert main(["view", "evil.npz"]) == 0
        write_replay(log_rollout(scene), deep / "replays" / file_name(f"x-{name}", ".html"))
        monkeypatch.setattr(scenario_sets, "scenes_of", lambda *_, scene=scene: [scene])
        monkeypatch.setattr(scenario_sets, "scene_hashes", lambda *_, name=name: {name: "0"})
        scenario_sets.generate(
            source="embedded/val",
            names=[name],
            generator="replay",
            traffic="replay",
            seed=0,
            folder="set",
            num_plans=1,
        )
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    assert [path.name for path in deep.parent.iterdir()] == ["two"]


def test_pages_of_a_folder_do_not_replace_each_other(tmp_path):
    rollout = log_rollout(ccdiff_env.embedded_scenes()[0])
    (tmp_path / "a").mkdir()
    rollout.save(tmp_path / "a-b.npz")
    rollout.save(tmp_path / "a" / "b.npz")
    pages = write_pages(tmp_path, tmp_path / "pages", thumbnails=False)
    assert len(set(pages)) == 3
    assert all(page.is_file() for page in pages)


def test_a_full_disk_leaves_no_half_of_a_file(tmp_path):
    path = tmp_path / "run.json"
    write_aside(path, "{}")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_aside(path, "x" * 10**6)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [(found.name, found.read_text()) for found in tmp_path.iterdir()] == [("run.json", "{}")]


def certificate():
    env = EgoEnv(traffic="replay")
    env.reset(seed=1)
    for _ in range(3):
        env.step(env.action_space.sample() * 0)
    return json.loads(env.certificate().to_json())


JSON_READERS = {
    "certificate": (Certificate.load, "c.json"),
    "configuration": (lambda path: WorldConfig.from_json(path.read_text()), "c.json"),
    "scenario set": (scenario_sets.load_scenario_set, "manifest.json"),
    "result": (lambda path: results([Job("r", "", {})], path.parent), "r.json"),
    "settings of a run": (lambda path: run_in(path.parent), "run.json"),
    "ranking": (read_ranking, "r.json"),
}


def run_in(folder):
    """A run of a benchmark whose folder is there already."""
    parser = argparse.ArgumentParser()
    add_run_arguments(parser)
    return Run(parser.parse_args(["--out", str(folder)]), "planners")


@pytest.mark.parametrize("name", list(JSON_READERS))
@pytest.mark.parametrize("attack", sorted(FOLDER.glob("*.json")), ids=lambda path: path.stem)
def test_texts_that_are_no_objects(tmp_path, name, attack):
    read, file = JSON_READERS[name]
    (tmp_path / file).write_bytes(attack.read_bytes())
    with pytest.raises(errors.CcdiffError):
        read(tmp_path / file)


def test_a_manifest_names_files_by_text(tmp_path):
    fields = dict.fromkeys((f.name for f in dataclasses.fields(scenario_sets.Scenario)), "x")
    fields |= dict.fromkeys(("collision", "at_fault", "avoidable"), False)
    fields |= dict.fromkeys(("time_s", "realism_cost", "fde_m", "shift_sigmas")) | {"file": 3}
    head = dict.fromkeys(("generator", "traffic", "weights"), "x")
    head |= {"seed": 0, "source": "embedded/val", "settings": {}}
    text = {"format": scenario_sets.FORMAT, "scenarios": [fields], **head}
    (tmp_path / "manifest.json").write_text(json.dumps(text))
    with pytest.raises(errors.DatasetError, match="file 3"):
        scenario_sets.load_scenario_set(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"episode_idx": 2**63},
        {"episode_idx": -5},
        {"episode_idx": True},
        {"seed": -1},
        {"seed": 2**70},
        {"actions": {"shape": [6], "float32": "AAAA" * 8}},
        {"actions": {"shape": [2, 3], "float32": "AAAA" * 8}},
        {"actions": 3},
    ],
    ids=str,
)
def test_certificates_with_changed_numbers(change):
    with pytest.raises(errors.SnapshotError):
        replay(Certificate.from_json(json.dumps(certificate() | change)))


def changed(path, **members):
    """Write a rollout whose arrays are changed; ``head`` is changed by a function."""
    log_rollout(ccdiff_env.embedded_scenes()[0]).save(path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    head = json.loads(arrays.pop("head").tobytes())
    text = members.pop("head", lambda head: json.dumps(head).encode())(head)
    np.savez_compressed(path, **arrays | members, head=np.frombuffer(text, np.uint8))


def with_events(*events):
    return {"head": lambda head: json.dumps(head | {"events": events}).encode()}


@pytest.mark.parametrize(
    "members",
    [
        {"head": lambda head: b"[" * 100_000},
        {"head": lambda head: b"[]"},
        {"head": lambda head: json.dumps(head | {"plans": [[0, ["nobody"]]]}).encode()},
        {"head": lambda head: json.dumps(head | {"plans": 10**6}).encode()},
        {"head": lambda head: json.dumps(head | {"dt_s": -1}).encode()},
        {"head": lambda head: json.dumps(head | {"start_step": -1}).encode()},
        with_events([0, "nobody", None, "goal", False]),
        with_events([0, ["ego"], None, "goal", False]),
        with_events([0, "ego", 3, "goal", False]),
        {"position": np.zeros(9, object)},
        {"position": np.zeros((0, 10**9, 2), np.float32)},
        {"scene": np.zeros(100, np.uint8)},
    ],
    ids=str,
)
def test_rollouts_with_changed_members(tmp_path, members):
    changed(tmp_path / "a.npz", **members)
    with pytest.raises(errors.DatasetError, match=r"a\.npz"):
        Rollout.load(tmp_path / "a.npz")


def test_rollouts_with_changed_bytes(tmp_path):
    path = tmp_path / "a.npz"
    log_rollout(ccdiff_env.embedded_scenes()[0]).save(path)
    whole = path.read_bytes()
    for at in np.random.default_rng(0).integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        with contextlib.suppress(errors.DatasetError):
            Rollout.load(path)


def test_rollouts_that_unpack_to_gibibytes_or_are_locked(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in "abcde":
            archive.writestr(f"{name}.npy", bytes(2**28))
    with pytest.raises(errors.DatasetError, match="unpacked"):
        Rollout.load(path)
    log_rollout(ccdiff_env.embedded_scenes()[0]).save(path)
    locked = bytearray(path.read_bytes())
    locked[6] |= 1
    locked[locked.rfind(b"PK\1\2") + 8] |= 1
    path.write_bytes(locked)
    with pytest.raises(errors.DatasetError):
        Rollout.load(path)


def scene_with(lanes=(), *, position=None, **changes):
    t = 60
    arrays = {
        "agent_ids": ["ego"],
        "agent_types": ["vehicle"],
        "sizes": np.array([[4.5, 1.9, 1.6]], np.float32),
        "position": np.zeros((1, t, 2), np.float32) if position is None else position,
        "heading": np.zeros((1, t), np.float32),
        "velocity": np.zeros((1, t, 2), np.float32),
        "valid": np.ones((1, t), bool),
    }
    lane = {
        "id": "0",
        "kind": "lane",
        "polygon": {"exterior": np.zeros((0, 2), np.float32), "holes": []},
        "successors": [],
        "predecessors": [],
        "speed_limit_mps": None,
    }
    layers = {
        "lanes": [lane | {"centreline": np.array(line, np.float32)} for line in lanes],
    }
    return Scene.from_arrays("far", **arrays | changes, map_layers=layers)


ZIGZAG = [[float(i % 2) * 1e6, float(i)] for i in range(100)]


@pytest.mark.parametrize(
    "line", [[[0, 0], [3e11, 0]], [[0, 0], [2.5e11, 0]], [[0, 0], [1e7, 0]], ZIGZAG]
)
def test_lines_that_are_far_or_long(line):
    with pytest.raises(errors.SceneError, match="map"):
        scene_with([line])


def test_a_line_of_a_thousand_kilometres_costs_little():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    EgoEnv(scenes=scene_with([[[0, 0], [9.9e5, 0]]]), traffic="idm").reset(seed=0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KiB


def test_tracks_that_jump():
    position = np.zeros((1, 60, 2), np.float32)
    position[0, ::2, 0] = 9e5
    with pytest.raises(errors.SceneError, match="paths"):
        scene_with(position=position)
    with pytest.raises(errors.SceneError, match="size"):
        scene_with(sizes=np.array([[1e30, 2, 1]], np.float32))
    with pytest.raises(errors.SceneError, match="heading"):
        scene_with(heading=np.full((1, 60), 1e30, np.float32))


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
    scene = log_rollout(ccdiff_env.embedded_scenes()[0]).to_scene("n" * 100_000)
    env = EgoEnv(scenes=scene, traffic="replay", render_mode="rgb_array")
    env.reset(seed=0)
    start = time.process_time()
    env.render()
    assert time.process_time() - start < 2.0


HALF = "\ud800"
LANE = {"id": "a", "kind": "lane", "centreline": np.zeros((2, 2), np.float32)}


@pytest.mark.parametrize(
    "texts",
    [
        {"name": HALF},
        *({key: [HALF]} for key in ("agent_ids", "agent_types", "agent_categories")),
        *({key: HALF} for key in ("token", "location", "source")),
        {"map_layers": {HALF: []}},
        *({"map_layers": {"lanes": [LANE | {key: HALF}]}} for key in ("id", "kind")),
    ],
    ids=str,
)
def test_texts_of_a_scene_are_unicode(texts):
    arrays = {
        "name": "drive",
        "agent_ids": ["ego"],
        "agent_types": ["vehicle"],
        "sizes": np.ones((1, 3), np.float32),
        "position": np.zeros((1, 11, 2), np.float32),
        "heading": np.zeros((1, 11), np.float32),
        "velocity": np.zeros((1, 11, 2), np.float32),
        "valid": np.ones((1, 11), bool),
    }
    with pytest.raises(errors.SceneError, match="half a character"):
        Scene.from_arrays(**(arrays | texts))


@pytest.fixture
def data_set(tmp_path):
    """The embedded scenes as files; loads the first one."""
    unpack(tmp_path)
    name = embedded_splits()["val"][0]

    def load() -> Scene:
        return ccdiff_env.load_nuscenes(tmp_path, VERSION, scenes=[name], cache=False)[0]

    return tmp_path, load


def test_a_lane_of_very_many_pieces_costs_little(data_set):
    folder, load = data_set
    load()
    path = folder / "maps/expansion/ccdiff-town.json"
    town = json.loads(path.read_text())
    lane = next(iter(town["arcline_path_3"]))
    pieces = town["arcline_path_3"][lane] * 100_000
    town["arcline_path_3"][lane] = pieces[:300_000]
    path.write_text(json.dumps(town))
    start = time.process_time()
    with contextlib.suppress(errors.DatasetError):
        load()
    assert time.process_time() - start < 20.0


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
def test_names_of_fields_with_escapes_are_refused(data_set, file, name):
    folder, load = data_set
    path = folder / file
    escaped = f'"\\u{ord(name[0]):04x}{name[1:]}"'
    assert json.loads(escaped) == name
    path.write_text(path.read_text().replace(f'"{name}"', escaped))
    with pytest.raises(errors.DatasetError, match="without escapes") as error:
        load()
    assert path.name in str(error.value)
