"""Files of the package that were made to harm: policies, banks, scenario sets, runs, plans."""

from __future__ import annotations

import dataclasses
import json
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import ccdiff_env
from ccdiff_env import EgoEnv, Rollout, Scene, errors, policies
from ccdiff_env.bench import scenario_sets
from ccdiff_env.bench.page import markdown_html
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.record.bank import load_bank, record_bank
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.view.sources import log_rollout, play_scene

EGO = policies.SHIPPED["ego"]


def policy(path: Path, *, tensors=None, header=None, text=None, tail=b"", **metadata: str) -> Path:
    """Write the shipped ego with changes: of its tensors, of the header as a dictionary or text."""
    before, about = read_tensors(EGO)
    write_tensors(path, {**before, **(tensors or {})}, {**about, **metadata})
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    entries = json.loads(data[8 : 8 + length])
    if header is not None:
        header(entries)
    made = json.dumps(entries).encode() if text is None else text
    path.write_bytes(struct.pack("<Q", len(made)) + made + data[8 + length :] + tail)
    return path


NESTED = "[" * 100_000
OWN_CODE = {"traffic": "attack_module:Model"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"options": json.dumps(OWN_CODE)}, "traffic"),
        ({"options": json.dumps({"driver": "attack_module:Model"})}, "driver"),
        ({"options": json.dumps({"ccdiff": {"weights": "/dev/zero"}})}, "ccdiff"),
        ({"options": NESTED}, "nested"),
        ({"options": "[]"}, "list"),
        ({"about": NESTED}, "nested"),
        ({"text": NESTED.encode()}, "nested"),
        ({"tail": b"more"}, "bytes"),
        ({"tensors": {"std": np.zeros(1, np.float32)}}, "std"),
        ({"tensors": {"encoder.0.weight": np.zeros((), np.float32)}}, "encoder"),
        ({"header": lambda h: h["mean"].update(data_offsets=[-976, None])}, "offsets"),
        ({"header": lambda h: h["mean"].update(data_offsets=h["std"]["data_offsets"])}, "offsets"),
        ({"header": lambda h: h["mean"].update(shape=[-1])}, "offsets"),
        ({"header": lambda h: h["mean"].update(shape=[2**40, 2**40])}, "offsets"),
        ({"header": lambda h: h.update(mean=3)}, "damaged"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_policies_hold_numbers_alone(tmp_path, monkeypatch, change, words):
    (tmp_path / "attack_module.py").write_text("Model = object\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(errors.DatasetError, match=words):
        policies.load(policy(tmp_path / "a.safetensors", **change))
    assert "attack_module" not in sys.modules


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_policies_divide_by_positive_numbers(tmp_path, value):
    std = np.full_like(read_tensors(EGO)[0]["std"], value)
    with pytest.raises(errors.DatasetError, match="std"):
        policies.load(policy(tmp_path / "a.safetensors", tensors={"std": std}))


@pytest.mark.parametrize("text", [b"", b"[]", NESTED.encode(), b"\xff\xfe\x00"], ids=len)
def test_banks_with_damaged_settings(tmp_path, text):
    (tmp_path / "bank.json").write_bytes(text)
    with pytest.raises(errors.DatasetError, match=r"bank\.json"):
        record_bank("val", tmp_path)


def test_banks_that_unpack_to_too_much(tmp_path):
    (tmp_path / "bank.json").write_text("{}")
    bomb = zlib.compress(bytes(200 << 20))
    (tmp_path / "0.scenes").write_bytes(struct.pack("<I", len(bomb)) + bomb)
    with pytest.raises(errors.DatasetError, match=r"0\.scenes"):
        load_bank(tmp_path)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A set of two scenes and its manifest."""
    folder, names = (
        tmp_path_factory.mktemp("set"),
        list(ccdiff_env.embedded_scenes("val").names[:2]),
    )
    source = "embedded/val"
    rows = scenario_sets.generate(
        source=source, names=names, generator="idm", traffic="replay", seed=0,
        folder=str(folder), num_plans=1,
    )  # fmt: skip
    path = scenario_sets.write_manifest(
        folder, [row["scenario"] for row in rows], generator="idm", traffic="replay", seed=0,
        weights="", source=source, settings={},
    )  # fmt: skip
    return folder, json.loads(path.read_text())


def manifest(made, change):
    folder, fields = made
    fields = json.loads(json.dumps(fields))
    change(fields)
    (folder / "manifest.json").write_text(json.dumps(fields))
    return scenario_sets.load_scenario_set(folder)


@pytest.mark.parametrize("value", [[], {}, float("nan")], ids=str)
@pytest.mark.parametrize("name", [f.name for f in dataclasses.fields(scenario_sets.Scenario)])
def test_manifests_hold_what_they_say(made, name, value):
    manifest(made, lambda fields: None)
    with pytest.raises(errors.DatasetError):
        manifest(made, lambda fields: fields["scenarios"][0].update({name: value}))


@pytest.mark.parametrize(
    "change",
    [
        {"scenarios": 3}, {"seed": "0"}, {"seed": True}, {"generator": None}, {"settings": []},
        {"source": 3}, {"source": {}}, {"source": {"embedded": "val"}},
        {"source": "embedded/val?limit=0"},
    ],
    ids=str,
)  # fmt: skip
def test_manifests_with_changed_heads(made, change):
    with pytest.raises(errors.CcdiffError):
        manifest(made, lambda fields: fields.update(change))


def test_episodes_are_of_the_scene_that_the_manifest_names(made):
    def swap(fields):
        fields["scenarios"][0]["scene"] = "another"

    with pytest.raises(errors.DatasetError, match="another"):
        manifest(made, swap).rollout("another")
    with pytest.raises(errors.DatasetError, match="two scenarios"):
        manifest(made, lambda fields: fields["scenarios"].append(fields["scenarios"][0]))


@pytest.mark.parametrize(
    "address",
    ["javascript:alert(1)", "JaVaScript:alert(1)", "\x01javascript:x", "data:text/html,x"],
)
def test_names_in_tables_make_no_links_that_run(address):
    assert "href" not in markdown_html(f"| [a]({address}) | b |\n|---|---|\n")
    assert 'href="replays/a.html#t=1:0"' in markdown_html("[a](replays/a.html#t=1:0)")
    assert 'href="https://x.org/a"' in markdown_html("[a](https://x.org/a)")


@pytest.mark.parametrize("step", [-5, 10**6, 2**70, "x", None])
def test_plans_of_moments_that_are_not_recorded(tmp_path, step):
    path = tmp_path / "a.npz"
    play_scene(ccdiff_env.embedded_scenes()["left-turn-00"], traffic="ccdiff").save(path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    head = json.loads(arrays.pop("head").tobytes())
    head["plans"][0][0] = step
    np.savez(path, **arrays, head=np.frombuffer(json.dumps(head).encode(), np.uint8))
    with pytest.raises(errors.DatasetError, match=r"a\.npz"):
        Rollout.load(path)


@pytest.mark.parametrize("dt_s", [1e-30, 1e-3, 1e30, float("inf"), float("nan")])
def test_episodes_have_the_step_of_their_scene(dt_s):
    log = log_rollout(ccdiff_env.embedded_scenes()[0])
    with pytest.raises(errors.DatasetError, match="dt_s"):
        dataclasses.replace(log, dt_s=dt_s)


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        (("map", "bitmap_px_per_m"), 1e30),
        (("map", "bitmap_px_per_m"), 1e5),
        (("map", "metres_per_px"), 1e6),
        (("map", "size_px"), 4096),
        (("edge_width",), 0),
        (("feed_forward",), 0),
        (("agents_within_m",), -1.0),
        (("ttc_threshold_s",), -1.0),
        (("diffusion_steps",), 10**12),
        (("temporal_layers",), 10**6),
        (("width",), 2**40),
        (("max_agents",), 2**60),
        (("horizon_steps",), 10**9),
    ],
    ids=str,
)
def test_weights_of_absurd_maps_and_widths(tmp_path, entry, value):
    def change(settings):
        *path, name = entry
        place = settings["model"]
        for step in path:
            place = place[step]
        place[name] = value

    with pytest.raises(errors.CcdiffError, match=entry[-1]):
        TrajectoryModel(weights(tmp_path / "a.safetensors", change))


def test_weights_of_another_format(tmp_path):
    with pytest.raises(errors.CheckpointError, match="format is 2"):
        TrajectoryModel(
            weights(tmp_path / "a.safetensors", lambda settings: settings.update(format=2))
        )


def weights(path: Path, change) -> Path:
    """Write the shipped weights with a changed header."""
    data = Path(shipped_weights()).read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8 : 8 + length])
    settings = json.loads(header["__metadata__"]["ccdiff_env"])
    change(settings)
    header["__metadata__"]["ccdiff_env"] = json.dumps(settings)
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])
    return path


def test_agents_too_far_apart_for_the_map_of_a_network():
    """A bitmap round both would take terabytes; rules drive among them."""
    steps = 60
    position = np.zeros((2, steps, 2), np.float32)
    position[0, :, 0] = np.arange(steps)
    position[1] = 9e5
    square = np.array([[-9, -9], [99, -9], [99, 9], [-9, 9]], np.float32)
    scene = Scene.from_arrays(
        "far",
        agent_ids=["ego", "other"],
        agent_types=["vehicle"] * 2,
        sizes=np.array([[4.5, 1.9, 1.6]] * 2, np.float32),
        position=position,
        heading=np.zeros((2, steps), np.float32),
        velocity=np.full((2, steps, 2), [10.0, 0.0], np.float32),
        valid=np.ones((2, steps), bool),
        map_layers={"drivable_area": [{"exterior": square, "holes": []}]},
    )
    EgoEnv(scenes=scene, traffic="idm").reset(seed=0)
    with pytest.raises(errors.SceneError, match=r"far.*pixels"):
        EgoEnv(scenes=scene, traffic="ccdiff")
    with pytest.raises(errors.SceneError, match=r"far.*pixels"):
        TrajectoryModel(shipped_weights()).plan([scene], [40])
