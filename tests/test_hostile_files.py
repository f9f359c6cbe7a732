"""Files made to harm are refused in words, or do nothing: doors of the package by damages."""

import argparse
import contextlib
import json
import os
import pickle
import re
import struct
import sys
import zipfile
import zlib
from pathlib import Path

import hostile_pickles
import numpy as np
import pytest
from array_scenes import agent, array_scene

import ccdiff_env
from ccdiff_env import EgoEnv, Rollout, Scene, WorldConfig, errors, planners
from ccdiff_env.bench.cli import add_run_arguments
from ccdiff_env.bench.jobs import Job, run_jobs
from ccdiff_env.bench.record import Record
from ccdiff_env.bench.run import Run
from ccdiff_env.envs.replay import replay
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.record.bank import load_bank, record_bank
from ccdiff_env.record.certificate import Certificate
from ccdiff_env.scenes.embedded import VERSION, unpack
from ccdiff_env.scenes.scenarionet_export import scenario_dict
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.view.index import write_pages
from ccdiff_env.view.sources import log_rollout, play_scene


def scene() -> Scene:
    return ccdiff_env.embedded_scenes()[0]


# doors


def bank(path: Path) -> object:
    (path.parent / "bank.json").write_text("{}")
    return load_bank(path.parent)


def in_data_set(table: str):
    def load(path: Path) -> object:
        folder = path.parents[len(Path(table).parts) - 1]
        kept = path.parent / "kept"
        if path.exists() or path.is_symlink():
            path.rename(kept)
        unpack(folder)
        path.unlink()
        if kept.exists() or kept.is_symlink():
            kept.rename(path)
        return ccdiff_env.load_nuscenes(folder, VERSION, cache=folder / "cache")

    return load


def run_in(path: Path) -> object:
    parser = argparse.ArgumentParser()
    add_run_arguments(parser)
    return Run(parser.parse_args(["--out", str(path.parent)]), "planners")


TOWN = "maps/expansion/ccdiff-town.json"
#: What reads a file, and the name of the file.
DOORS = {
    "scenario": (ccdiff_env.load_scenarionet, "a.pkl"),
    "scenarios of a folder": (lambda path: ccdiff_env.load_scenarionet(path.parent), "a.pkl"),
    "Waymo scene": (lambda path: ccdiff_env.load_gpudrive(path, cache=False)[0], "a.json"),
    "rollout": (Rollout.load, "a.npz"),
    "pages": (lambda path: write_pages(path.parent, path.parent / "out"), "a.npz"),
    "certificate": (Certificate.load, "a.json"),
    "configuration": (lambda path: WorldConfig.from_json(path.read_text()), "a.json"),
    "run of planners": (lambda path: Record.read(path.parent), "run.json"),
    "result": (lambda path: run_jobs([Job("a", "builtins:len", {})], path.parent), "a.json"),
    "settings of a run": (run_in, "run.json"),
    "bank": (bank, "0.scenes"),
    "settings of a bank": (lambda path: record_bank("val", path.parent), "bank.json"),
    "policy": (planners.load, "a.safetensors"),
    "policy of stable-baselines3": (planners.load, "a.zip"),
    "weights": (TrajectoryModel, "a.safetensors"),
    "weights of traffic": (
        lambda path: EgoEnv(traffic="ccdiff", ccdiff={"weights": str(path)}),
        "a.safetensors",
    ),
    "table": (in_data_set(f"{VERSION}/sample.json"), f"{VERSION}/sample.json"),
    "map": (in_data_set(TOWN), TOWN),
}
#: What may stand where a file is expected: what it is, or its bytes.
CONTENTS = {
    "nothing": lambda path: None,
    "pipe": os.mkfifo,
    "device": lambda path: os.symlink("/dev/zero", path),
    "folder": os.mkdir,
    "empty": lambda path: path.write_bytes(b""),
    "list": lambda path: path.write_bytes(b"[]"),
    "pickled list": lambda path: path.write_bytes(pickle.dumps([])),
    "nested 100000 deep": lambda path: path.write_bytes(b"[" * 100_000),
    "no UTF-8": lambda path: path.write_bytes(b"\xff\xfe\x00"),
}
TEXTS = ("empty", "list", "nested 100000 deep")
#: Text is opened before it is read as a configuration; a bank may hold nothing and a map be absent;
#: what has no result or settings yet begins.
LEFT_OUT = {
    ("bank", "empty"),
    *(("configuration", kind) for kind in CONTENTS if kind not in TEXTS),
    *((f"settings of a {of}", "nothing") for of in ("run", "bank")),
    *((name, "nothing") for name in ("result", "bank", "map")),
}


@pytest.mark.parametrize("kind", CONTENTS)
@pytest.mark.parametrize("name", DOORS)
@pytest.mark.filterwarnings("ignore:left out")
def test_what_is_no_such_file_is_refused(tmp_path, name, kind):
    if (name, kind) in LEFT_OUT:
        return
    read, file = DOORS[name]
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    CONTENTS[kind](path)
    with pytest.raises(errors.CcdiffError):
        read(path)


@pytest.mark.parametrize("name", hostile_pickles.pickles())
def test_scenario_pickles(tmp_path, capfd, name):
    path = tmp_path / f"{name}.pkl"
    path.write_bytes(hostile_pickles.pickles()[name])
    with pytest.raises(errors.DatasetError, match=re.escape(path.name)):
        ccdiff_env.load_scenarionet(path)
    assert "attacked" not in capfd.readouterr().out


def test_parts_of_pickles_that_nobody_looks_at_cost_their_size(tmp_path):
    for name, data in hostile_pickles.harmless().items():
        (tmp_path / f"{name}.pkl").write_bytes(data)
    assert len(ccdiff_env.load_scenarionet(tmp_path)) == len(hostile_pickles.harmless())


# one change of a sound file


def certificate(**changes):
    """A replayed certificate of three steps with changed fields."""

    def read(path: Path) -> object:
        env = EgoEnv(traffic="replay")
        env.reset(seed=1)
        for _ in range(3):
            env.step(env.action_space.sample() * 0)
        fields = json.loads(env.certificate().to_json())
        path.write_text(json.dumps(fields | changes))
        return replay(path)

    return read


def rollout(change=None, played=False, **members):
    """A recording whose head is changed by a function, and whose arrays are."""

    def read(path: Path) -> object:
        file = path.with_suffix(".npz")
        made = play_scene(scene(), traffic="ccdiff") if played else log_rollout(scene())
        made.save(file)
        with np.load(file) as kept:
            arrays = {name: kept[name] for name in kept.files}
        head = json.loads(arrays.pop("head").tobytes())
        text = change(head) if change else None
        text = text if isinstance(text, str) else json.dumps(head)
        np.savez_compressed(file, **arrays | members, head=np.frombuffer(text.encode(), np.uint8))
        return Rollout.load(file)

    return read


def head(**values):
    return rollout(lambda fields: fields.update(values))


def number(place: str, text: str):
    """A number of the head that JSON takes and nobody can compute with."""
    inside = {"event": {"events": [["#", "ego", None, "goal", 0]]}, "plan": {"plans": [["#", []]]}}
    return rollout(
        lambda fields: json.dumps(fields | inside.get(place, {place: "#"})).replace('"#"', text)
    )


def tensors(source: Path, change):
    """A safetensors file with a changed header: of a dictionary, or the text itself."""
    data = source.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    entries = json.loads(data[8 : 8 + length])
    text = change(entries)
    made = (text if isinstance(text, str) else json.dumps(entries)).encode()
    return struct.pack("<Q", len(made)) + made + data[8 + length :]


EGO = planners.SHIPPED["ego"]


def policy(header=None, *, arrays=None, tail=b"", **metadata):
    """The shipped ego with changes: of its header, tensors and settings."""

    def read(path: Path) -> object:
        path, (before, about) = path.with_suffix(".safetensors"), read_tensors(EGO)
        write_tensors(path, {**before, **(arrays or {})}, {**about, **metadata})
        path.write_bytes(tensors(path, header or (lambda _: None)) + tail)
        return planners.load(path)

    return read


def weights(change=None, *entry, value=None):
    """The shipped weights with a changed header, or a changed entry of their settings."""

    def changed(header):
        if change is not None:
            return change(header)
        settings = json.loads(header["__metadata__"]["ccdiff_env"])
        place = settings
        for step in entry[:-1]:
            place = place[step]
        place[entry[-1]] = value
        header["__metadata__"]["ccdiff_env"] = json.dumps(settings)
        return None

    def read(path: Path) -> object:
        path.write_bytes(tensors(Path(shipped_weights()), changed))
        return TrajectoryModel(path)

    return read


def shape_of(header, shape):
    ends = [part["data_offsets"][1] for name, part in header.items() if name[0] != "_"]
    header["a"] = {"dtype": "F32", "shape": shape, "data_offsets": [max(ends)] * 2}


def sb3(text):
    def read(path: Path) -> object:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("data", text)
        return planners.load(path)

    return read


def scenario(**changes):
    def read(path: Path) -> object:

        file = path.with_suffix(".pkl")
        file.write_bytes(pickle.dumps(scenario_dict(scene()) | changes, 4))
        return ccdiff_env.load_scenarionet(file)

    return read


def packed_bank(made):
    def read(path: Path) -> object:
        (path.parent / "bank.json").write_text("{}")
        parts = [zlib.compress(part, 9) for part in made()]
        data = b"".join(struct.pack("<I", len(part)) + part for part in parts)
        (path.parent / "0.scenes").write_bytes(data)
        return load_bank(path.parent)

    return read


def wide_scenes():
    """Four scenes of 40 MB each that pack to next to nothing."""
    steps = 60_000
    others = [agent(f"{i}", np.zeros(steps)) for i in range(40)]
    made = array_scene(agent("ego", np.zeros(steps)), *others, name="n").to_bytes()
    return [made.replace(b"\1n", bytes([1, 65 + i]), 1) for i in range(4)]


def run_json(text):
    def read(path: Path) -> object:
        fields = {"benchmark": "planners", "source": {"embedded": "val"}, "seed": 0, "weights": "#"}
        (path.parent / "run.json").write_text(json.dumps(fields).replace('"#"', text))
        return Record.read(path.parent)

    return read


NESTED = "[" * 100_000
F4 = np.float32
#: What is read after one change, and words of the refusal.
DAMAGES = {
    **{
        f"certificate {name}={str(value)[:20]}": (certificate(**{name: value}), "certificate")
        for name, value in (
            *(("episode_idx", x) for x in (2**63, -5, True)),
            *(("seed", x) for x in (-1, 2**70)),
            *(("seed", "one"), ("format", "other"), ("config", {"colour": 1}), ("extra", 1)),
            *(("actions", x) for x in (3, None, {"shape": [1, 1], "float32": "!"})),
            *(("actions", {"shape": x, "float32": "AAAA" * 8}) for x in ([6], [2, 3], [9, 9])),
        )
    },
    "rollout nested": (rollout(lambda _: NESTED), "a.npz"),
    "rollout of a list": (rollout(lambda _: "[]"), "a.npz"),
    "rollout plans of nobody": (head(plans=[[0, ["nobody"]]]), "a.npz"),
    "rollout plans are a number": (head(plans=10**6), "a.npz"),
    "rollout dt_s": (head(dt_s=-1), "a.npz"),
    "rollout start_step": (head(start_step=-1), "a.npz"),
    "rollout start_step beyond the log": (head(start_step=10**9), "start_step is 10.*a.npz"),
    **{
        f"rollout event {event}": (head(events=[event]), "a.npz")
        for event in (
            [0, "nobody", None, "goal", False],
            [0, ["ego"], None, "goal", False],
            [0, "ego", 3, "goal", False],
            [-1, "ego", None, "goal", False],
            [10**9, "ego", "ego", "collision_front", False],
        )
    },
    "rollout of objects": (rollout(position=np.zeros(9, object)), "a.npz"),
    "rollout of a huge shape": (rollout(position=np.zeros((0, 10**9, 2), F4)), "a.npz"),
    "rollout without its scene": (rollout(scene=np.zeros(100, np.uint8)), "a.npz"),
    **{
        f"rollout {place} {text[:9]}": (number(place, text), "a.npz")
        for place in ("start_step", "dt_s", "event", "plan", "meta")
        for text in ("Infinity", "NaN", "1e400", "1" + "0" * 400)
    },
    **{
        f"rollout planned at {step}": (
            rollout(lambda h, step=step: h["plans"][0].__setitem__(0, step), played=True),
            "a.npz",
        )
        for step in (-5, 10**6, 2**70, "x", None)
    },
    "policy of other observations": (policy(schema="00"), "observations that this version"),
    "policy of another format": (policy(format="x"), "format 'x'"),
    "policy of a dynamics that is none": (policy(options='{"dynamics": "hover"}'), "hover"),
    "policy not finite": (policy(arrays={"mean": np.full(9, np.nan, F4)}), "finite"),
    "policy of own code": (policy(options='{"traffic": "attack_module:Model"}'), "traffic"),
    "policy of an own driver": (policy(options='{"driver": "attack_module:Model"}'), "driver"),
    "policy of a device": (policy(options='{"ccdiff": {"weights": "/dev/zero"}}'), "ccdiff"),
    "policy options nested": (policy(options=NESTED), "nested"),
    "policy options list": (policy(options="[]"), "list"),
    "policy about nested": (policy(about=NESTED), "nested"),
    "policy header nested": (policy(lambda _: NESTED), "nested"),
    "policy with a tail": (policy(tail=b"more"), "bytes"),
    "policy short std": (policy(arrays={"std": np.zeros(1, F4)}), "std"),
    "policy no matrix": (policy(arrays={"encoder.0.weight": np.zeros((), F4)}), "encoder"),
    "policy offsets": (policy(lambda h: h["mean"].update(data_offsets=[-976, None])), "offsets"),
    "policy overlap": (
        policy(lambda h: h["mean"].update(data_offsets=h["std"]["data_offsets"])),
        "offsets",
    ),
    "policy shape -1": (policy(lambda h: h["mean"].update(shape=[-1])), "offsets"),
    "policy shape": (policy(lambda h: h["mean"].update(shape=[2**40, 2**40])), "offsets"),
    "policy mean": (policy(lambda h: h.update(mean=3)), "damaged"),
    "policy shape Infinity": (
        policy(lambda h: h["mean"].update(shape="#") or json.dumps(h).replace('"#"', "[Infinity]")),
        "a.s",
    ),
    **{
        f"policy std {x}": (policy(arrays={"std": np.full_like(read_tensors(EGO)[0]["std"], x)}),
                            "std")
        for x in (0.0, -1.0)
    },
    **{
        f"weights {entry[-1]}={value}": (weights(None, "model", *entry, value=value), entry[-1])
        for entry, value in (
            (("map", "feature_width"), 2**40),
            *(((name,), 0) for name in ("edge_width", "feed_forward")),
            *(((name,), -1.0) for name in ("agents_within_m", "ttc_threshold_s")),
            (("diffusion_steps",), 10**12),
            (("temporal_layers",), 10**6),
            (("width",), 2**40),
            (("max_agents",), 2**60),
            (("horizon_steps",), 10**9),
        )
    },
    "weights of another format": (weights(None, "format", value=2), "format is 2"),
    "weights of a shape": (weights(lambda h: shape_of(h, [0, 2**63])), "a.x"),
    "weights beyond 64 bits": (weights(lambda h: shape_of(h, [0, 2**62])), "a.x"),
    "sb3 nested": (sb3(NESTED), "a.x"),
    "sb3 list": (sb3("[]"), "a.x"),
    "sb3 class": (sb3('{"policy_class": {"__module__": "os"}}'), "a.x"),
    "sb3 spaces": (sb3('{"x": 1}'), "a.x"),
    "scenario data set": (scenario(metadata={"dataset": np.zeros(3)}), "a.pkl"),
    "scenario metadata": (
        scenario(tracks={k: {**t, "metadata": np.zeros(3)}
                         for k, t in scenario_dict(scene())["tracks"].items()}),
        "a.pkl",
    ),
    "bank bomb": (packed_bank(lambda: [bytes(200 << 20)]), "0.scenes"),
    "bank of wide scenes": (packed_bank(wide_scenes), "far more.*0.scenes"),
    "half a letter": (run_json('"\\ud800"'), "run.json"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_what_is_damaged_is_refused(tmp_path, monkeypatch, name):
    (tmp_path / "attack_module.py").write_text("Model = object\n")
    monkeypatch.syspath_prepend(tmp_path)
    read, words = DAMAGES[name]
    with pytest.raises(errors.CcdiffError, match=words):
        read(tmp_path / "a.x")
    assert "attack_module" not in sys.modules


def test_recordings_with_changed_bytes_that_unpack_to_gibibytes_or_are_locked(tmp_path):
    path = tmp_path / "a.npz"
    log_rollout(scene()).save(path)
    whole = path.read_bytes()
    for at in np.random.default_rng(0).integers(0, len(whole), 150):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << (at % 8)
        path.write_bytes(damaged)
        with contextlib.suppress(errors.DatasetError):
            Rollout.load(path)
    locked = bytearray(whole)
    locked[6] |= 1
    locked[locked.rfind(b"PK\1\2") + 8] |= 1
    path.write_bytes(locked)
    with pytest.raises(errors.DatasetError):
        Rollout.load(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in "abcde":
            archive.writestr(f"{name}.npy", bytes(2**28))
    with pytest.raises(errors.DatasetError, match="unpacked"):
        Rollout.load(path)


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_caches_go_on_without_what_is_no_file(tmp_path, kind):
    unpack(tmp_path)
    cache, names = tmp_path / "cache", [scene().name]

    def load():
        return ccdiff_env.load_nuscenes(tmp_path, VERSION, scenes=names, cache=cache)

    before = load()
    (kept,) = [path for path in cache.rglob("*") if path.parent.name == "scene"]
    kept.unlink()
    CONTENTS[kind](kept)
    again = load()
    assert again[0] == before[0]
    assert "damaged" in again.report.cache.notes[0]
