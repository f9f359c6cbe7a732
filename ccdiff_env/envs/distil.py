"""``ccdiff-env distil``: swift traffic, taught what guided CCDiff does.

CCDiff drives scenes at many strengths of guidance; what each vehicle saw and did in the next half
second are labels for a small network. Further rounds label the states that its own driving leads
to. Then its strength is fitted, so that IDM collides in its traffic as often as in the teacher's.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, MissingFeatureError
from ccdiff_env.models.training import LICENCE
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    other_place,
    place_from,
    scenes_from,
)
from ccdiff_env.scenes.sources import coverage, load, title
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.traffic import SWIFT, CcdiffConfig, NamedDriver
from ccdiff_env.worlds import Worlds

__all__ = ["collect", "collisions", "fitted_dial", "save"]

F32: TypeAlias = npt.NDArray[np.float32]
Labels: TypeAlias = dict[str, npt.NDArray[Any]]

#: Bins of each axis; steps for which a draw is held, and seconds of a step.
BINS, HELD_STEPS, DT_S = 21, 5, 0.1
#: Name of the entry that holds the header of weights.
HEADER = "ccdiff_env"
#: Steps of an episode; starts are spread by as many as the logs of nuScenes leave.
STEPS, SPREAD = 100, 80
#: Options of the teacher.
TEACHER: Mapping[str, Any] = {
    "denoising_steps": 5,
    "follow_route": True,
    "careful": True,
    "criticality": 6.0,
}
#: Share of episodes without guidance; in the others the strength is drawn up to the most.
UNGUIDED = 0.3
#: Share of the vehicles that the student drives from the second round on, drawn at every plan.
STUDENT = 0.5
#: Columns that change their sign where the world is mirrored: of a vehicle itself (turns, its place
#: beside the route, places on the route), and of others.
OWN_MIRRORED = (4, 5, 10, 11, *(13 + 4 * k + i for k in range(13) for i in (1, 3)))
OTHER_MIRRORED = (1, 3, 5)
#: Column of another agent that is 1 for the ego.
WHO = 14
#: Strengths of the network that are tried for its dial, and criticalities that are fitted.
TRIED = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
FITTED = (0.5, 1.0, 2.0)
#: Layers as they are called in files and here.
LAYERS = ("others.0", "others.1", "trunk.0", "trunk.1", "speed", "turning", "yaw_rate")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "fit")
    parser.add_argument("--out", type=Path, default=Path("runs/swift"), help="folder of the run")
    parser.add_argument(
        "--teacher",
        type=json.loads,
        default=TEACHER,
        help="options of CCDiff as JSON; up to its criticality strengths are drawn",
    )
    parser.add_argument(
        "--episodes",
        type=int,
        nargs="+",
        default=(1500, 1000, 1000),
        help="of each round; from the second on the student drives, too",
    )
    parser.add_argument("--updates", type=int, default=8000, help="gradient steps of a training")
    parser.add_argument("--seeds", type=int, default=3, help="trainings, of which one is kept")
    parser.add_argument("--temperature", type=float, default=0.8, help="of the draws of the file")
    parser.add_argument("--seed", type=int, default=0, help="of episodes and networks")


def run(args: argparse.Namespace) -> int:
    """Collect, train, fit; print where the weights are. What a run in ``--out`` has is kept."""
    if find_spec("torch") is None:
        raise MissingFeatureError("distillation needs torch: pip install 'ccdiff-env[models]'")
    if not isinstance(args.teacher, Mapping):
        raise ConfigError(f"--teacher is {args.teacher!r}, expected an object of JSON")
    place, teacher = place_from(args), {**TEACHER, **args.teacher}
    scenes, rounds = scenes_from(args), list[Labels]()
    args.out.mkdir(parents=True, exist_ok=True)

    def trained(name: str, updates: int, seed: int) -> tuple[float, Path]:
        file: Path = args.out / f"{name}.safetensors"
        if not file.exists():
            tensors, nats = train(rounds, updates, seed=seed)
            save(file, tensors, [[0.0, 0.0], [1.0, 1.0]], {"nats": nats}, args.temperature)
        return json.loads(read_tensors(file)[1][HEADER])["notes"]["nats"], file

    student = None
    for i, episodes in enumerate(args.episodes):
        file = args.out / f"labels-{i}.npz"
        if not file.exists():
            found = collect(scenes, teacher, episodes, seed=args.seed + i, student=student)
            np.savez(file, **found)
        with np.load(file) as arrays:
            rounds.append(dict(arrays))
        student = student or trained("pilot", args.updates // 2, args.seed)[1]
    seeds = range(args.seed, args.seed + args.seeds)
    networks = [trained(f"network-{seed}", args.updates, seed) for seed in seeds]
    best = min(networks)[1]
    dial, rates = fitted_dial(load(other_place(args)), best)
    notes = {
        "teacher": teacher,
        "data": title(place, coverage(place, len(scenes))),
        "labels": [len(found["bins"]) for found in rounds],
        "nats": [nats for nats, _ in networks],
        "collisions": rates,
        "licence": LICENCE,
    }
    out = args.out / f"{SWIFT}_fast.safetensors"
    save(out, read_tensors(best)[0], dial, notes)
    print(out)
    return 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# what the teacher does


def collect(
    scenes: SceneSet,
    teacher: Mapping[str, Any],
    episodes: int,
    *,
    seed: int = 0,
    student: Path | None = None,
    worlds: int = 48,
) -> Labels:
    """Return what vehicles saw and did where CCDiff drove: arrays of n labels each.

    Parameters
    ----------
    scenes
        The scenes, drawn evenly.
    teacher
        Options of CCDiff; up to ``criticality`` strengths are drawn.
    episodes
        How many episodes are played.
    seed
        Of all that is drawn.
    student
        Weights of swift traffic that drives most of the vehicles, so that its own states are met.
    worlds
        Episodes that are played side by side.

    Returns
    -------
    dict
        ``own`` [n, 65], ``ego`` [n, 14], ``others`` [n, K, 15], ``seen`` [n], strength ``c`` [n] of
        the guidance that moved the vehicle's plan, ``bins`` [n, 2] of change of speed and yaw rate,
        and index of the ``scene`` [n].
    """
    rng, most = np.random.default_rng(seed), float(teacher["criticality"])
    found: dict[str, list[Any]] = {}
    start, listed = time.process_time(), list(scenes)
    for first in range(0, episodes, worlds):
        count = min(worlds, episodes - first, len(listed))
        chosen = rng.choice(len(listed), count, replace=False)
        strengths = np.where(rng.random(count) < UNGUIDED, 0.0, rng.uniform(0.2, most, count))
        batch = SceneSet([listed[i] for i in chosen])
        for i, labels in _episodes(batch, teacher, strengths, student, rng):
            for name, array in labels.items():
                found.setdefault(name, []).append(array)
            found.setdefault("scene", []).append(np.full(len(labels["c"]), chosen[i]))
        done = sum(map(len, found.get("bins", [])))
        _say(
            f"{first + count} of {episodes} episodes, {done} labels, "
            f"{time.process_time() - start:.0f} s of processor"
        )
    return {name: np.concatenate(arrays) for name, arrays in found.items()}


def _episodes(
    scenes: SceneSet,
    teacher: Mapping[str, Any],
    strengths: npt.NDArray[np.float64],
    student: Path | None,
    rng: np.random.Generator,
) -> Iterator[tuple[int, Labels]]:
    """World and labels of each half second of episodes, a strength of guidance for each scene."""
    count, driver = len(scenes), str(rng.choice(["idm", "replay", "external"], p=[0.45, 0.15, 0.4]))
    more: dict[str, Any] = {"dynamics": "assisted"} if driver == "external" else {}
    config = WorldConfig().with_options(
        start_spread_steps=SPREAD,
        horizon_steps=STEPS,
        driver=driver,
        traffic={"ccdiff": 1.0 - 1e-6, "student": 1e-6} if student else "ccdiff",
        named_drivers={"student": NamedDriver(SWIFT, CcdiffConfig(weights=str(student)))}
        if student
        else {},
        ccdiff=dict(teacher),
        **more,
    )
    worlds = Worlds(scenes, config, num_worlds=count, num_threads=1)
    out, native = worlds.arrays(), worlds.native
    seeds = [int(seed) for seed in rng.integers(1 << 30, size=count)]
    native.reset(seeds, list(range(count)), None, out)
    for i, strength in enumerate(strengths):
        native.override_plan(i, guided=None, criticality=float(strength))
    running, actions = np.ones(count, bool), np.zeros((count, 1, native.action_width), np.float32)
    for step in range(STEPS):
        if step % HELD_STEPS == 0 and driver == "external":
            noise = rng.normal(0.0, (0.3, 0.2), actions.shape)
            actions = np.clip(0.8 * actions + noise, -1.0, 1.0).astype(np.float32)
        if step % HELD_STEPS:
            native.step(actions, out, running)
        else:
            there: list[int] = np.flatnonzero(running).tolist()
            before: dict[int, tuple[Any, list[int], Any]] = {}
            for i in there:
                if student:
                    _share(native, i, rng)
                states, names = native.states(i), native.drivers(i)
                agents = [a for a in np.flatnonzero(states["active"]) if names[a] == "ccdiff"]
                before[i] = states, agents, native.swift_rows(i, agents)
            native.step(actions, out, running)
            for i in there:
                plan = native.explain(i, "ccdiff")
                if plan is not None and plan["made_at"] == step and plan["follows_plan"].any():
                    yield i, _labels(plan, *before[i], float(strengths[i]))
        running &= ~out.done
        if not running.any():
            break


def _share(native: _native.VecWorld, world_idx: int, rng: np.random.Generator) -> None:
    """Draw anew who of the vehicles is the student's, and who CCDiff's."""
    drivers = native.drivers(world_idx)
    mine = np.array([a for a, name in enumerate(drivers) if name in ("ccdiff", "student")], int)
    lent = rng.random(len(mine)) < STUDENT
    for name, whose in (("student", mine[lent]), ("ccdiff", mine[~lent])):
        if len(whose):
            native.assign(world_idx, whose.tolist(), name)


def _labels(
    plan: Mapping[str, Any],
    states: Mapping[str, Any],
    agents: list[int],
    rows: Mapping[str, Any],
    strength: float,
) -> Labels:
    """What the vehicles that follow a plan saw, and what it does in its first half second."""
    planned = np.flatnonzero(plan["follows_plan"])
    a = plan["agents"][planned]
    mine = np.searchsorted(agents, a)
    poses = plan["samples"][plan["selected_sample"][planned], planned, :HELD_STEPS]
    heading, after = states["heading"][a], poses[:, -1, 2]
    before = (states["velocity"][a] * np.stack([np.cos(heading), np.sin(heading)], -1)).sum(-1)
    way = ((poses[:, -1] - poses[:, -2])[:, :2] * np.stack([np.cos(after), np.sin(after)], -1)).sum(
        -1
    )
    turned = (after - heading + math.pi) % (2 * math.pi) - math.pi
    change = np.stack([way / DT_S - before, turned / (HELD_STEPS * DT_S)], -1)
    return {
        **{name: rows[name][mine] for name in ("own", "ego", "others", "seen")},
        "c": (strength * plan["guided"][planned]).astype(np.float32),
        "bins": np.array(_native.swift_bins(list(map(tuple, change.tolist()))), np.int64).reshape(
            -1, 2
        ),
    }


# the network


def train(
    rounds: Sequence[Labels], updates: int, *, seed: int = 0, width: int = 128, batch: int = 1024
) -> tuple[dict[str, F32], float]:
    """Train a network on labels; return its tensors and the nats a label of scenes held out.

    Every twelfth scene is held out. Labels are mirrored at random.
    """
    import torch
    from torch.nn import functional

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    data = {
        name: torch.from_numpy(np.concatenate([found[name] for found in rounds]))
        for name in rounds[0]
    }
    held_out = data["scene"] % 12 == 5
    here, there = (torch.nonzero(mask).squeeze(1) for mask in (~held_out, held_out))
    own, ego, others = data["own"], data["ego"], data["others"]
    mirrored = torch.ones(own.shape[1])
    mirrored[list(OWN_MIRRORED)] = -1.0
    other_mirrored = torch.ones(others.shape[2])
    other_mirrored[list(OTHER_MIRRORED)] = -1.0
    mean, std = own.mean(0), own.std(0) + 1e-2
    mean = torch.where(mirrored < 0, torch.zeros_like(mean), mean)
    slots = torch.arange(others.shape[1])

    far = 32
    inputs = own.shape[1] + 2 * ego.shape[1] + 1 + far
    sizes = [(others.shape[2], far), (far, far), (inputs, width), (width, width)]
    sizes += [(width, BINS), (width, 64), (64, BINS)]
    linear = (torch.nn.Linear(*size) for size in sizes)
    layers: dict[str, Any] = dict(zip(LAYERS, linear, strict=True))
    by_speed = torch.nn.Parameter(0.1 * torch.randn(BINS, 64))
    weights = [by_speed, *(w for one in layers.values() for w in one.parameters())]

    def losses(rows: Any, flip: Any) -> Any:
        sign = torch.where(flip[:, None], mirrored, torch.ones_like(mirrored))
        sign_of = torch.where(flip[:, None], other_mirrored, torch.ones_like(other_mirrored))
        c, bins = data["c"][rows][:, None], data["bins"][rows]
        told = (c > 0).float()
        x = (own[rows] * sign - mean) / std
        e = ego[rows] * sign_of[:, : ego.shape[1]] * told
        near = others[rows] * sign_of[:, None]
        who = torch.where(told > 0, near[..., WHO], near[..., WHO].clamp(max=0.0))
        near = torch.cat([near[..., :WHO], who[..., None]], -1)
        h = functional.relu(layers["others.1"](functional.relu(layers["others.0"](near))))
        h = (h * (slots < data["seen"][rows][:, None])[..., None]).amax(1)
        h = functional.relu(layers["trunk.0"](torch.cat([x, e, c, c * e, h], 1)))
        h = functional.relu(layers["trunk.1"](h))
        turning = functional.relu(layers["turning"](h) + by_speed[bins[:, 0]])
        turn = torch.where(flip, BINS - 1 - bins[:, 1], bins[:, 1])
        cross = functional.cross_entropy
        return cross(layers["speed"](h), bins[:, 0]) + cross(layers["yaw_rate"](turning), turn)

    optimizer = torch.optim.AdamW(weights, lr=2e-3, weight_decay=1e-3)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, updates, pct_start=0.03)
    for update in range(updates):
        rows = here[torch.randint(len(here), (batch,))]
        loss = losses(rows, torch.rand(batch) < 0.5)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
        if (update + 1) % 1000 == 0:
            _say(f"seed {seed}, update {update + 1} of {updates}, {loss.item():.3f} nats")
    with torch.no_grad():
        parts = torch.split(there, 8192)
        sums = [len(part) * losses(part, part < 0).item() for part in parts]
        nats = sum(sums) / max(len(there), 1)
        # the network of the file takes numbers as they are
        first = layers["trunk.0"]
        size = own.shape[1]
        first.bias -= first.weight[:, :size] @ (mean / std)
        first.weight[:, :size] /= std
    tensors = {
        f"{name}.{part}": getattr(one, part).detach().numpy()
        for name, one in layers.items()
        for part in ("weight", "bias")
    }
    _say(f"seed {seed}: {nats:.3f} nats on {len(there)} labels held out")
    return {**tensors, "by_speed": by_speed.detach().numpy()}, nats


def save(
    path: Path,
    tensors: Mapping[str, F32],
    dial: Sequence[Sequence[float]],
    notes: Mapping[str, Any],
    temperature: float = 1.0,
) -> None:
    """Write weights as swift traffic reads them.

    Parameters
    ----------
    path
        A ``.safetensors``.
    tensors
        As :func:`train` returns them.
    dial
        Pairs of a criticality and the strength of the network that belongs to it, both rising.
    notes
        What the file was made from.
    temperature
        What logits are divided by.
    """
    heads = ("speed.", "yaw_rate.")
    scaled = {
        name: array / np.float32(temperature) if name.startswith(heads) else array
        for name, array in tensors.items()
    }
    header = {"format": 1, "kind": SWIFT, "dial": dial, "notes": notes}
    write_tensors(path, scaled, {HEADER: json.dumps(header)})


# its dial


def collisions(scenes: SceneSet, options: Mapping[str, Any], seeds: Sequence[int]) -> float:
    """Return the share of episodes in which IDM, as the ego, collides in some traffic."""
    hits = []
    for seed in seeds:
        for first in range(0, len(scenes), 48):
            part = SceneSet(list(scenes)[first : first + 48])
            config = WorldConfig().with_options(driver="idm", **options)
            worlds = Worlds(part, config, num_worlds=len(part), num_threads=1)
            out, native = worlds.arrays(), worlds.native
            native.reset([seed] * len(part), list(range(len(part))), None, out)
            running = np.ones(len(part), bool)
            actions = np.zeros((len(part), 1, native.action_width), np.float32)
            while running.any():
                native.step(actions, out, running)
                running &= ~out.done
            column = worlds.metric_names.index("collision")
            hits.append(native.ended_metrics(list(range(len(part))))[:, 0, column])
    return float(np.concatenate(hits).mean())


def fitted_dial(
    scenes: SceneSet, weights: Path, seeds: int = 4
) -> tuple[list[list[float]], dict[str, list[float]]]:
    """Return the dial of weights, and the shares that it was fitted to and found in.

    IDM collides in their traffic as often as in that of five steps at 0.5, 1 and 2 on these scenes;
    beyond, strengths go on evenly.

    Raises
    ------
    ConfigError
        If there are fewer scenes than a share can be told from.
    """
    if len(scenes) < 10:
        raise ConfigError(f"--fit-scenes: {len(scenes)} scenes, expected at least 10")

    def shares(options: Mapping[str, Any], levels: Sequence[float], draws: range) -> list[float]:
        """Of collisions at some levels of criticality."""
        found = [{**options, "ccdiff": {**options["ccdiff"], "criticality": c}} for c in levels]
        return [collisions(scenes, one, draws) for one in found]

    wanted = shares({"traffic": "ccdiff", "ccdiff": {}}, FITTED, range(seeds // 2))
    swift = {"traffic": SWIFT, "ccdiff": {"weights": str(weights)}}
    had = shares(swift, TRIED, range(10, 10 + 2 * seeds))
    _say(f"IDM collides in the teacher's traffic at {FITTED}: {wanted}, here at {TRIED}: {had}")
    strengths = np.maximum.accumulate(np.interp(wanted, np.maximum.accumulate(had), TRIED))
    pairs = zip(FITTED, strengths.tolist(), strict=True)
    return [[0.0, 0.0], *([c, round(s, 3)] for c, s in pairs)], {"teacher": wanted, "student": had}
