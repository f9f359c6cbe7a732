"""``ccdiff-env distil``: swift traffic, taught what guided CCDiff does.

CCDiff drives scenes at many strengths of guidance. What each vehicle saw and did in the next half
second is a label for a small network, a row [ROW + 3]: what ``swift_rows`` tells, the strength of
guidance, the bins of change of speed and yaw rate. Later rounds label states that the network
leads to; the log is labelled as well. Unguided vehicles turn so that they return to their routes.
Then the strength is fitted: IDM shall collide as often as in five-step CCDiff.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, MissingFeatureError
from ccdiff_env.models import weights_path
from ccdiff_env.record.episode import begin, play
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.scenes.arguments import (
    add_other_scenes,
    add_scene_arguments,
    place_from,
    scenes_from,
)
from ccdiff_env.scenes.sources import coverage, title
from ccdiff_env.system.files import read_bytes, reading, write_aside
from ccdiff_env.system.settings import keep_settings, sha256
from ccdiff_env.system.tensors import read_tensors, write_tensors
from ccdiff_env.traffic import SWIFT, CcdiffConfig, NamedDriver
from ccdiff_env.training.networks import LICENCE

F32: TypeAlias = npt.NDArray[np.float32]

#: Bins of each axis; steps for which a draw is held, and seconds of a step.
BINS, HELD_STEPS, DT_S = 21, 5, 0.1
#: A row: numbers of a vehicle and its route, of the ego, of K other agents, and how many are there.
OWN, EGO, NEAR, OTHER, PLACES_M = json.loads(_native.schema("swift_row"))
ROW = OWN + EGO + NEAR * OTHER + 1
#: The first of the four numbers of each place on the route; these are ``PLACES_M`` ahead.
FIRST_PLACE = OWN - 4 * len(PLACES_M)
#: Columns that change their sign where the world is mirrored: of a vehicle itself (turns, its place
#: beside the route, places on the route), and of another agent, as which the ego begins.
OWN_MIRRORED = (4, 5, 10, 11, *range(FIRST_PLACE + 1, OWN, 2))
OTHER_MIRRORED = (1, 3, 5)
MIRRORED = [*OWN_MIRRORED, *(OWN + i for i in OTHER_MIRRORED)]
MIRRORED += [OWN + EGO + OTHER * k + i for k in range(NEAR) for i in OTHER_MIRRORED]
#: Steps of an episode; starts are spread by as many as the logs of nuScenes leave.
STEPS, SPREAD = 100, 80
#: Options of the teacher.
TEACHER: Mapping[str, Any] = {
    "denoising_steps": 5,
    "follow_route": True,
    "careful": True,
    "criticality": 6.0,
}
#: Share of episodes without guidance; in the others the strength is drawn up to the teacher's.
UNGUIDED = 0.3
#: Share of the vehicles that the network drives from the second round on, drawn at every plan.
STUDENT = 0.5
#: Times in each scene of which the log is labelled, steps that they are spread by, and how far
#: vehicles of the log that count as moving get, metres.
LOGGED_STARTS, LOGGED_SPREAD, MOVING_M = 30, 170, 2.0
#: Rate at which unguided vehicles return to their routes, critically damped, 1/s.
RETURN_1PS = 0.5
#: What the logits of an axis are divided by: logged speeds then lie evenly among samples.
TEMPERATURES = {"speed": 1.1, "yaw_rate": 0.3}
#: Strengths of the network that are tried for its dial, and criticalities that are fitted.
TRIED = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
FITTED = (0.5, 1.0, 2.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_scene_arguments(parser, "train")
    add_other_scenes(parser, "fit")
    parser.add_argument("--out", type=Path, default=Path("runs/swift"), help="folder of the run")
    parser.add_argument(
        "--teacher",
        type=json.loads,
        default=TEACHER,
        help="options of CCDiff as JSON; criticality is sampled from 0 to the one given",
    )
    parser.add_argument(
        "--rounds", type=int, default=4, help="rounds of data; the first is the teacher's"
    )
    parser.add_argument("--episodes", type=int, default=960, help="episodes per round")
    parser.add_argument("--updates", type=int, default=16000, help="gradient steps per network")


def run(args: argparse.Namespace) -> int:
    """Collect, train, fit; print where the weights are.

    Labels and networks that a run in ``--out`` has finished are kept; a :class:`ConfigError`
    refuses a run of another teacher, other scenes or other numbers.
    """
    if find_spec("torch") is None:
        raise MissingFeatureError("distillation needs torch: pip install 'ccdiff-env[models]'")
    if not isinstance(args.teacher, Mapping):
        raise ConfigError(f"--teacher is {args.teacher!r}, expected an object of JSON")
    teacher, scenes = {**TEACHER, **args.teacher}, scenes_from(args)
    fit = scenes_from(args, other=True)
    if len(fit) < 10:
        raise ConfigError(f"--fit-scenes: {len(fit)} scenes, expected at least 10")
    weights = weights_path(
        teacher.get("weights", "fast"),
        "ccdiff",
        teacher["denoising_steps"],
        teacher["follow_route"],
    )
    settings = {
        "teacher": {**teacher, "weights": sha256(read_bytes(weights))},
        **{
            n: sha256(*(scene.hash for scene in of)) for n, of in (("scenes", scenes), ("fit", fit))
        },
        **{name: getattr(args, name) for name in ("rounds", "episodes", "updates")},
    }
    keep_settings(args.out / "run.json", settings)
    began = time.process_time()

    def say(text: str) -> None:
        line = f"{time.process_time() - began:6.0f} s of processor: {text}"
        print(line, file=sys.stderr, flush=True)
        with (args.out / "log.txt").open("a", encoding="utf-8") as log:
            print(line, file=log)

    def labels(name: str, made: Callable[[], F32]) -> F32:
        file: Path = args.out / f"labels-{name}.npy"
        if not file.exists():
            np.save(packed := io.BytesIO(), made())
            write_aside(file, packed.getvalue())
            say(f"{file.name}: {len(np.load(file, mmap_mode='r'))} labels")
        with reading("labels", file):
            rows: F32 = np.load(file)
        return rows

    def taught(of: SceneSet, episodes: int, seed: int, student: Path | None = None) -> F32:
        return collect(of, teacher, episodes, seed=seed, student=student)

    def trained(name: str, updates: int, seed: int) -> tuple[float, Path]:
        file: Path = args.out / f"{name}.safetensors"
        if not file.exists():
            tensors, nats = train(np.concatenate(rounds), judge, updates, seed=seed)
            save(file, tensors, [[0.0, 0.0], [1.0, 1.0]], {"nats": nats})
            say(f"{file.name}: {nats:.3f} nats on {len(judge)} labels of scenes to fit on")
        return json.loads(read_tensors(file)[1]["ccdiff_env"])["notes"]["nats"], file

    judge = labels("fit", lambda: taught(fit, len(fit), args.rounds))
    rounds = [labels("log", lambda: logged(scenes))]
    rounds.append(labels("0", lambda: taught(scenes, args.episodes, 0)))
    for i in range(1, args.rounds):
        student = trained(f"pilot-{i}", args.updates // 8, i)[1]
        rounds.append(labels(str(i), partial(taught, scenes, args.episodes, i, student)))
    nats, network = trained("network", args.updates, 0)
    dial, rates = fit_dial(fit, network)
    say(f"IDM collides at {FITTED} with the teacher, at {TRIED} with {network.name}: {rates}")
    place = place_from(args)
    notes = {
        "teacher": settings["teacher"],
        "data": title(place, coverage(place, scenes.names)),
        "labels": [len(rows) for rows in rounds],
        "nats": nats,
        "collisions": rates,
        "licence": LICENCE,
    }
    save(args.out / f"{SWIFT}_fast.safetensors", read_tensors(network)[0], dial, notes)
    print(args.out / f"{SWIFT}_fast.safetensors")
    return 0


# what the teacher does


def collect(
    scenes: SceneSet,
    teacher: Mapping[str, Any],
    episodes: int,
    *,
    seed: int = 0,
    student: Path | None = None,
    worlds: int = 48,
) -> F32:
    """Return labels [n, ROW + 3] of episodes in scenes that are drawn evenly.

    CCDiff drives with the options of a teacher, at strengths up to its criticality. A student, the
    weights of swift traffic, drives half of the vehicles, so that its own states are met.
    """
    rng, listed, found = np.random.default_rng(seed), list(scenes), list[F32]()
    for first in range(0, episodes, worlds):
        count = min(worlds, episodes - first, len(listed))
        batch = SceneSet([listed[i] for i in rng.choice(len(listed), count, replace=False)])
        found += _label_episode(batch, teacher, student, rng)
    return np.concatenate(found)


def _label_episode(
    scenes: SceneSet, teacher: Mapping[str, Any], student: Path | None, rng: np.random.Generator
) -> list[F32]:
    """Labels of each half second of an episode in every scene, each with a strength of its own."""
    count, driver = len(scenes), str(rng.choice(["idm", "replay", "external"], p=[0.45, 0.15, 0.4]))
    strengths = rng.uniform(0.2, float(teacher["criticality"]), count)
    strengths[rng.random(count) < UNGUIDED] = 0.0
    options: dict[str, Any] = {"dynamics": "assisted"} if driver == "external" else {}
    if student:
        own = NamedDriver(SWIFT, CcdiffConfig(weights=str(student)))
        options |= {"named_drivers": {"student": own}}
        options |= {"traffic": {"ccdiff": 1.0 - 1e-6, "student": 1e-6}}
    config = WorldConfig().with_options(
        start_spread_steps=SPREAD,
        horizon_steps=STEPS,
        driver=driver,
        **{"traffic": "ccdiff", "ccdiff": dict(teacher), **options},
    )
    worlds = begin(scenes, config, int(rng.integers(1 << 30)))
    native, found = worlds.native, list[F32]()
    for i, strength in enumerate(strengths):
        native.override_plan(i, guided=None, criticality=float(strength))
    actions = np.zeros((count, native.action_width), np.float32)
    seen: dict[int, tuple[Any, list[int], F32]] = {}
    step = -1

    def act(_: Any, running: npt.NDArray[np.bool_]) -> F32:
        """Note what vehicles see before the plans of this step."""
        nonlocal actions, step
        step += 1
        seen.clear()
        if step % HELD_STEPS:
            return actions
        if driver == "external":
            noise = rng.normal(0.0, (0.3, 0.2), actions.shape)
            actions = np.clip(0.8 * actions + noise, -1.0, 1.0).astype(np.float32)
        for i in np.flatnonzero(running).tolist():
            names = np.array(native.drivers(i), object)
            if student:
                mine = np.flatnonzero((names == "ccdiff") | (names == "student"))
                names[mine] = np.where(rng.random(len(mine)) < STUDENT, "student", "ccdiff")
                for name in ("student", "ccdiff"):
                    native.assign(i, np.flatnonzero(names == name).tolist(), name)
            states = native.states(i)
            agents = np.flatnonzero(states["active"] & (names == "ccdiff")).tolist()
            seen[i] = states, agents, native.swift_rows(i, agents)
        return actions

    for _ in play(worlds, act):
        for i, before in seen.items():
            plan = native.explain(i, "ccdiff")
            if plan is not None and plan["made_at"] == step and plan["follows_plan"].any():
                found.append(_labels(plan, *before, float(strengths[i])))
    return found


def _labels(
    plan: Mapping[str, Any],
    states: Mapping[str, Any],
    agents: list[int],
    rows: F32,
    strength: float,
) -> F32:
    """What the vehicles that follow a plan saw, and what it does in its first half second."""
    planned = np.flatnonzero(plan["follows_plan"])
    a = plan["agents"][planned]
    poses = plan["samples"][plan["selected_sample"][planned], planned, :HELD_STEPS]
    heading, after = states["heading"][a], poses[:, -1, 2]
    change = _along((poses[:, -1] - poses[:, -2]) / DT_S, after)
    change -= _along(states["velocity"][a], heading)
    told, mine = strength * plan["guided"][planned], np.searchsorted(agents, a)
    return _rows(rows[mine], told, change, after - heading)


def logged(scenes: SceneSet, *, seed: int = 0, starts: int = LOGGED_STARTS) -> F32:
    """Return labels [n, ROW + 3] of vehicles that move in the log, at times drawn in each scene."""
    rng, listed, found = np.random.default_rng(seed), list(scenes), list[F32]()
    config = WorldConfig().with_options(
        start_spread_steps=LOGGED_SPREAD,
        horizon_steps=HELD_STEPS + 1,
        driver="replay",
        # CCDiff, which drives nobody, has worlds keep the past that rows tell
        traffic={"replay": 1.0, "ccdiff": 0.0},
    )
    moving = {scene.name: _moving(scene) for scene in listed}
    for first in [i for _ in range(starts) for i in range(0, len(listed), 48)]:
        part = SceneSet(listed[first : first + 48])
        worlds = begin(part, config, int(rng.integers(1 << 30)))
        native, before = worlds.native, []
        for i, scene in enumerate(part):
            states = native.states(i)
            a = np.flatnonzero(states["active"] & moving[scene.name])
            before.append((states, a, native.swift_rows(i, a.tolist())))
        for _ in play(worlds, most=HELD_STEPS):
            pass
        for i, (old, agents, rows) in enumerate(before):
            new = native.states(i)
            there = new["active"][agents]
            a = agents[there]
            was, heading = old["heading"][a], new["heading"][a]
            change = _along(new["velocity"][a], heading) - _along(old["velocity"][a], was)
            found.append(_rows(rows[there], np.zeros(len(a)), change, heading - was))
    return np.concatenate(found)


def _moving(scene: Scene) -> npt.NDArray[np.bool_]:
    """Vehicles but the ego that get away from where they begin."""
    tracks, types = scene.tracks(), np.array(scene.agent_types)
    place = np.where(tracks["valid"][..., None], tracks["position"], np.nan)
    reach = np.nanmax(place, axis=1) - np.nanmin(place, axis=1)
    moving: npt.NDArray[np.bool_] = (types == "vehicle") & (reach.max(axis=1) > MOVING_M)
    moving[0] = False
    return moving


def _along(way: npt.NDArray[Any], heading: npt.NDArray[Any]) -> Any:
    return way[:, 0] * np.cos(heading) + way[:, 1] * np.sin(heading)


def _rows(rows: F32, told: npt.NDArray[Any], change: Any, turned: Any) -> F32:
    """Labels of rows, of strengths, changes of speed (m/s) and turns (rad) in half a second."""
    yaw_rate = ((turned + math.pi) % (2 * math.pi) - math.pi) / (HELD_STEPS * DT_S)
    back = _back_to_route(rows, change)
    yaw_rate = np.where((told == 0.0) & np.isfinite(back), back, yaw_rate)
    bins = np.reshape(_native.swift_bins(list(zip(change, yaw_rate, strict=True))), (-1, 2))
    labels: F32 = np.column_stack([rows, told, bins]).astype(np.float32)
    return labels


def _back_to_route(rows: F32, change: Any) -> npt.NDArray[Any]:
    """Yaw rates [n], rad/s, that lead onto the route; NaN for who stands or is far from it."""
    held_s = HELD_STEPS * DT_S
    speed = np.maximum(10.0 * rows[:, 0] + 0.5 * change, 0.0)
    # how far the vehicle is beside the route, and the route's heading less the vehicle's by place
    places = rows[:, FIRST_PLACE:OWN].reshape(-1, len(PLACES_M), 4)
    beside_m, turns = 3.0 * rows[:, 11], np.arcsin(np.clip(places[..., 3], -1.0, 1.0))
    last = np.maximum(places[..., 2].sum(axis=1).astype(int) - 1, 0)
    way_m = np.minimum(np.maximum(held_s * speed, PLACES_M[1]), np.take(PLACES_M, last))
    ahead = np.array([np.interp(w, PLACES_M, t) for w, t in zip(way_m, turns, strict=True)])
    back = speed * (ahead - turns[:, 0]) / np.maximum(way_m, 0.5) + 2.0 * RETURN_1PS * turns[:, 0]
    back -= RETURN_1PS**2 * beside_m / np.maximum(speed, 2.0)
    near = (last >= 1) & (speed > 0.3) & (np.abs(beside_m) < 6.0) & (np.abs(turns[:, 0]) < 0.78)
    return np.where(near, np.clip(back, -0.35 * speed, 0.35 * speed), np.nan)


# the network


def train(
    labels: F32, judge: F32, updates: int, *, seed: int = 0, width: int = 128, batch: int = 1024
) -> tuple[dict[str, F32], float]:
    """Return a network's tensors after so many updates on labels, mirrored at random, and its nats
    a label of others.
    """
    import torch
    from torch.nn import Linear, functional

    torch.set_num_threads(1)
    torch.manual_seed(seed % 2**64)
    relu, cross = functional.relu, functional.cross_entropy
    mirrored = torch.ones(ROW)
    mirrored[MIRRORED] = -1.0
    rows = torch.from_numpy(labels)
    own = rows[:, :OWN]
    mean, std = own.mean(0) * (mirrored[:OWN] > 0), own.std(0) + 1e-2
    layers = {
        "others.0": Linear(OTHER, 32),
        "others.1": Linear(32, 32),
        "trunk.0": Linear(OWN + 2 * EGO + 1 + 32, width),
        "trunk.1": Linear(width, width),
        "speed": Linear(width, BINS),
        "turning": Linear(width, 64),
        "yaw_rate": Linear(64, BINS),
    }
    by_speed = torch.nn.Parameter(0.1 * torch.randn(BINS, 64))
    weights = [by_speed, *(w for layer in layers.values() for w in layer.parameters())]

    def loss_of(some: Any, flip: Any) -> Any:
        """Who is not guided (c = 0) does not know who the ego is: the last number of an agent."""
        x = some[:, :ROW] * torch.where(flip[:, None], mirrored, 1.0)
        own, ego, others, seen = x.split((OWN, EGO, NEAR * OTHER, 1), 1)
        c, speed, turn = some[:, ROW, None], some[:, -2].long(), some[:, -1].long()
        others = others.unflatten(1, (NEAR, OTHER)).clone()
        others[..., -1] = torch.where(c > 0, others[..., -1], others[..., -1].clamp(max=0.0))
        h = relu(layers["others.1"](relu(layers["others.0"](others))))
        h = (h * (torch.arange(NEAR) < seen)[..., None]).amax(1)
        h = torch.cat([(own - mean) / std, ego * (c > 0), c, c * ego, h], 1)
        h = relu(layers["trunk.1"](relu(layers["trunk.0"](h))))
        turning = layers["yaw_rate"](relu(layers["turning"](h) + by_speed[speed]))
        turn = torch.where(flip, BINS - 1 - turn, turn)
        return cross(layers["speed"](h), speed) + cross(turning, turn)

    optimizer = torch.optim.AdamW(weights, lr=2e-3, weight_decay=1e-3)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, updates, pct_start=0.03)
    for _ in range(updates):
        loss = loss_of(rows[torch.randint(len(rows), (batch,))], torch.rand(batch) < 0.5)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
    with torch.no_grad():
        other = torch.from_numpy(judge)
        nats = loss_of(other, torch.zeros(len(other), dtype=torch.bool)).item()
        # the network of the file takes numbers as they are
        first = layers["trunk.0"]
        first.bias.sub_(first.weight[:, :OWN] @ (mean / std))
        first.weight[:, :OWN].div_(std)
        for name, temperature in TEMPERATURES.items():
            for weight in layers[name].parameters():
                weight.div_(temperature)
    named = {
        f"{name}.{k}": w for name, layer in layers.items() for k, w in layer.named_parameters()
    }
    return {name: w.detach().numpy() for name, w in {**named, "by_speed": by_speed}.items()}, nats


def save(
    path: Path,
    tensors: Mapping[str, F32],
    dial: Sequence[Sequence[float]],
    notes: Mapping[str, Any],
) -> None:
    """Write tensors of :func:`train` as swift traffic reads them.

    A dial is pairs of a criticality and the strength of the network that belongs to it, both
    rising from 0, 0.
    """
    header = {"format": 1, "kind": SWIFT, "dial": dial, "notes": notes}
    write_tensors(path, dict(tensors), {"ccdiff_env": json.dumps(header)})


# its dial


def collisions(scenes: SceneSet, options: Mapping[str, Any], seeds: Sequence[int]) -> float:
    """Return the share of episodes in which IDM, as the ego, collides in some traffic."""
    hits, listed = list[npt.NDArray[np.float64]](), list(scenes)
    for seed in seeds:
        for first in range(0, len(listed), 48):
            part = SceneSet(listed[first : first + 48])
            worlds = begin(part, WorldConfig().with_options(driver="idm", **options), seed)
            for _ in play(worlds):
                pass
            column = worlds.metric_names.index("collision")
            hits.append(worlds.native.ended_metrics(list(range(len(part))))[:, 0, column])
    return float(np.concatenate(hits).mean())


def fit_dial(
    scenes: SceneSet, weights: Path, seeds: int = 4
) -> tuple[list[list[float]], dict[str, list[float]]]:
    """Return the dial of weights, and the shares that it was fitted to and found in.

    IDM collides in their traffic as often as in that of five steps at 0.5, 1 and 2 on these scenes;
    beyond, strengths go on evenly.
    """

    def shares(driver: str, own: Mapping[str, Any], levels: Sequence[float], draws: range) -> Any:
        """Of collisions at some levels of criticality."""
        found = ({"traffic": driver, "ccdiff": {**own, "criticality": c}} for c in levels)
        return [collisions(scenes, options, draws) for options in found]

    wanted = shares("ccdiff", {}, FITTED, range(seeds // 2))
    had = shares(SWIFT, {"weights": str(weights)}, TRIED, range(10, 10 + 2 * seeds))
    strengths = np.maximum.accumulate(np.interp(wanted, np.maximum.accumulate(had), TRIED))
    pairs = [[c, round(s, 3)] for c, s in zip(FITTED, strengths.tolist(), strict=True)]
    return [[0.0, 0.0], *pairs], {"teacher": wanted, "student": had}
