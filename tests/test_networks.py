"""Networks on own kernels: those of torch but for rounding, one set of bits, no torch."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from traffic_play import Play

from ccdiff_env import _native, embedded_scenes
from ccdiff_env.errors import CheckpointError, ConfigError
from ccdiff_env.models import guidance_preset, require_networks, shipped_weights, weight_files
from ccdiff_env.traffic import KINDS

FILES = {file.stem: os.fspath(file) for file in weight_files()}
GOLDEN = Path(__file__).parent / "golden" / "plans.json"
#: All shipped networks of traffic.
NAMES = sorted(
    name
    for name in FILES
    if (kind := KINDS.get(name.split("_")[0])) is not None and not kind.distilled
)
#: Those of them that denoise, and those that also attend to each other.
SCENE_DIFFUSIONS = [name for name in NAMES if name.startswith(("ccdiff", "ctgpp"))]
DIFFUSIONS = [*SCENE_DIFFUSIONS, "ctg_fast"]
SCENES = ("left-turn-04", "tee-crossing-04", "queue-03")
#: Parts of plans that are compared, and how many of their last columns.
PARTS = {"states": 2, "actions": 2, "attention": None}
#: What rounding may do to places (m), actions and shares of attention: about 4e-5 on one processor.
ROUNDING = 1e-3


def plans(model, name, *, found=None, samples=1, weight=1.0, steps=5, guidance=None, guided=None):
    """Plans of scenes at two moments, with attention and, where it is known, routes."""
    if found is None:
        found = [embedded_scenes("val")[scene] for scene in SCENES]
    moments = [40, 90] * len(found)
    found = [scene for scene in found for _ in range(2)]
    return model.plan_scenes(
        found,
        moments,
        list(range(len(found))),
        solver_steps=1 if "one_step" in name else steps,
        num_samples=samples,
        guidance_weight=weight,
        guidance=guidance,
        guided=guided,
        attention=True,
        follow_route="routes" in name,
    )


def own(name):
    return _native.load_network(FILES[name])


def changed(tmp_path, change):
    """A copy of shipped weights with another header of its tensors."""
    data, path = shipped_weights().read_bytes(), tmp_path / "weights.safetensors"
    size = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + size]), data[8 + size :]
    # the checksum is of names and values; without it the file is an older one
    own_header = json.loads(header["__metadata__"]["ccdiff_env"])
    own_header.pop("checksum", None)
    change(header, own_header)
    header["__metadata__"]["ccdiff_env"] = json.dumps(own_header)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + body)
    return os.fspath(path)


def farthest(some, others):
    """Greatest difference of each part of two lists of plans."""
    found = dict.fromkeys(PARTS, 0.0)
    for a, b in zip(some, others, strict=True):
        assert a["agents"].tolist() == b["agents"].tolist()
        for part, columns in PARTS.items():
            if a[part] is None:
                assert b[part] is None
                continue
            away = np.abs(a[part][..., :columns] - b[part][..., :columns])
            found[part] = max(found[part], float(away.max()))
    return found


@pytest.mark.parametrize(
    ("name", "samples", "weight", "steps"),
    [
        (name, *draw)
        for name in NAMES
        for draw in ((1, 1.0, 5), (3, 1.5, 5), (1, 1.0, None))
        # some were taught to plan in one step, and some do not denoise
        if draw[-1] or (name in DIFFUSIONS and "one_step" not in name)
    ],
)
def test_plans_are_those_of_torch_but_for_rounding(name, samples, weight, steps):
    require_networks()
    from ccdiff_env import _models

    weight = weight if name.startswith("ccdiff") else 1.0
    torch = _models.load_network(FILES[name], "cpu")
    ours = own(name)
    assert (ours.header, ours.num_parameters) == (torch.header, torch.num_parameters)
    options = {"samples": samples, "weight": weight, "steps": steps}
    found = plans(ours, name, **options)
    away = farthest(plans(torch, name, **options), found)
    assert max(away.values()) < ROUNDING, away
    seen = [plan["attention"] for plan in found]
    # somebody sees several others; what CCDiff tells leaves out who passes by
    assert (name in SCENE_DIFFUSIONS) == all(one is not None for one in seen)
    assert name not in SCENE_DIFFUSIONS or max((one > 0.01).sum(1).max() for one in seen) > (
        not name.startswith("ccdiff")
    )


@pytest.mark.parametrize("name", sorted({"trafficsim_fast", "strive_fast"} & {*NAMES}))
def test_latents_descend_by_the_gradients_of_torch(name):
    require_networks()
    from ccdiff_env import _models

    models = (own(name), _models.load_network(FILES[name], "cpu"))
    free = plans(models[0], name)
    guided = {
        "guidance": json.dumps(guidance_preset("rl")),
        "guided": [plan["agents"][1:3].tolist() for plan in free],
    }
    ours, theirs = (plans(model, name, **guided) for model in models)
    effect = farthest(ours, free)["states"]
    assert effect > 0.5
    # the first step of Adam goes by the signs of gradients, some of which are nearly 0
    assert farthest(theirs, ours)["states"] < 0.1 * effect


def digest(found):
    hasher = hashlib.blake2b(digest_size=8)
    for plan in found:
        for part in ("states", "actions", "attention"):
            if plan[part] is not None:
                hasher.update(np.ascontiguousarray(plan[part]).tobytes())
    return hasher.hexdigest()


def test_plans_have_the_bits_that_they_have_on_every_machine():
    """``PYTHONPATH=. python tests/test_networks.py`` writes those of new weights."""
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert {name: digest(plans(own(name), name, samples=2)) for name in NAMES} == golden


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_the_same_plan_alone_and_among_others(name):
    together = plans(own(name), name)
    alone = plans(own(name), name, found=[embedded_scenes("val")[SCENES[0]]])
    for a, b in zip(alone, together, strict=False):
        assert a["states"].tobytes() == b["states"].tobytes()


def everything():
    """Digests of all plans and of an episode."""
    play = Play(embedded_scenes("val")[:1])
    play.step(30)
    found = {name: digest(plans(own(name), name, samples=2)) for name in NAMES}
    return f"{found} {play.native.digest(0)}"


def test_the_narrowest_vectors_have_the_same_plans_and_episodes():
    code = "import test_networks as t; t._native.hold_to_base(); print(t.everything())"
    paths = os.pathsep.join([*map(os.fspath, (GOLDEN.parents[2], GOLDEN.parents[1]))])
    command, env = [sys.executable, "-c", code], {**os.environ, "PYTHONPATH": paths}
    found = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == everything()


def test_what_own_kernels_lack_is_named(tmp_path):
    def per_step(_, own_header):
        own_header["model"]["history"] = "per_step"

    path = changed(tmp_path, per_step)
    assert _native.needs_torch(path)
    with pytest.raises(ConfigError, match=r"model\.history is per_step.*without torch"):
        _native.load_network(path)


def test_tensors_of_other_shapes_are_refused_by_name(tmp_path):
    def transposed(header, _):
        header["out.weight"]["shape"].reverse()

    with pytest.raises(CheckpointError, match=r"out\.weight is \[64, 2\], expected \[2, 64\]"):
        _native.load_network(changed(tmp_path, transposed))
    assert _native.load_network(changed(tmp_path, lambda *_: None)).num_parameters > 0
    with pytest.raises(OSError, match=r"nowhere\.safetensors"):
        _native.load_network("nowhere.safetensors")


if __name__ == "__main__":
    found = {name: digest(plans(own(name), name, samples=2)) for name in NAMES}
    GOLDEN.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
