"""What a viewer sees of unguided CCDiff traffic: overlaps, parked movers, jumps at replans.

    python benchmarks/smoothness.py [--scenes nuscenes:FOLDER@v1.0-mini/all]
        [--ccdiff '{"keep_noise": true}'] [--world '{"on_traffic_collision": "ignore"}']

The ego replays its log; all other vehicles are driven for 10 s. Counted: pairs without the ego that
do not touch at the start and then overlap by 0.2 m and more for longer than 0.5 s; vehicles that
the log moves by 1 m at most in all, and that end more than 1 m from where they started; means and
95th percentiles of the change of acceleration and yaw rate from one step to the next, in the step
that a new plan begins with and in the others; share of vehicle steps with the centre off the road;
of the vehicles that drive at 1 m/s at least at the start: those that the log stops (below 0.5 m/s
from some step on), those of them that stop in traffic too, those that stop there alone, and those
that brake by more than 2.5 m/s in some second, in the log and in traffic.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from ccdiff_env.bench.episode import off_road
from ccdiff_env.config import WorldConfig
from ccdiff_env.metrics import Motion
from ccdiff_env.record import episode
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from

#: Scenes that share a batch.
CHUNK = 12
#: Overlap that counts, m, for how long, steps.
DEPTH_M, LONGEST_STEPS = 0.2, 5
PARKED_M = 1.0
DRIVES_MPS, STOPPED_MPS, BRAKES_MPS2 = 1.0, 0.5, 2.5
STOPS = ("stops_in_log", "stops_in_both", "stops_in_traffic_alone", "brakes_in_log", "brakes")


def play(scenes: SceneSet, ccdiff: dict[str, Any], world: dict[str, Any], seed: int) -> list[Any]:
    """Return the states [A, T] of each scene, and which vehicles were driven."""
    options = {
        "traffic": "ccdiff",
        "driver": "replay",
        "on_collision": "ignore",
        "on_off_road": "ignore",
        "terminate_at_goal": False,
        "autoreset": "disabled",
        "ccdiff": ccdiff,
        **world,
    }
    config = WorldConfig().with_options(**options)
    worlds = episode.begin(scenes, config, seed)
    states = [[worlds.native.states(i)] for i in range(len(scenes))]
    for step in episode.play(worlds):
        for i in np.flatnonzero(step.running).tolist():
            states[i].append(worlds.native.states(i))
    names = ("position", "heading", "speed", "active")
    return [{n: np.stack([s[n] for s in one], axis=1) for n in names} for one in states]


def stops(logged: Any, driven: Any, dt_s: float) -> list[bool]:
    """Return STOPS of a vehicle's speeds [T], in the log and in traffic."""
    second = round(1.0 / dt_s)

    def brakes(speed: Any) -> bool:
        return bool((speed[:-second] - speed[second:] > BRAKES_MPS2).any())

    log, traffic = (bool((speed < STOPPED_MPS).any()) for speed in (logged, driven))
    return [log, log and traffic, traffic and not log, brakes(logged), brakes(driven)]


def figures(scene: Scene, played: Any, start_step: int, replan_steps: int) -> dict[str, Any]:
    """Return the counts of one scene."""
    kinds, ids = np.array(scene.agent_types), np.array(scene.agent_ids)
    moving = np.flatnonzero((kinds != "static") & (ids != "ego"))
    everyone = np.flatnonzero(ids != "ego")
    position, heading, active = (played[n] for n in ("position", "heading", "active"))
    size = np.maximum(scene.sizes[everyone][:, :2] - DEPTH_M, 0.1)
    motion = Motion(position[everyone], heading[everyone], size, active[everyone], dt_s=scene.dt)
    steps: dict[tuple[int, int], set[int]] = {}
    for step, i, j in motion.collisions().contacts:
        steps.setdefault((int(i), int(j)), set()).add(int(step))
    vehicle = kinds[everyone] == "vehicle"
    long = [
        pair
        for pair, at in steps.items()
        if vehicle[list(pair)].any() and len(at) > LONGEST_STEPS and 0 not in at
    ]
    tracks = scene.tracks()
    parked = moved = movers = 0
    stopped = np.zeros(len(STOPS), np.int64)
    jumps: dict[str, list[float]] = {"a": [], "a_replan": [], "w": [], "w_replan": []}
    off = steps_in_all = 0
    for a in moving:
        there = active[a]
        if kinds[a] != "vehicle" or not there[0]:
            continue
        logged = tracks["position"][a][tracks["valid"][a]]
        if np.linalg.norm(logged - logged[0], axis=-1).max() <= PARKED_M:
            parked += 1
            end = int(np.flatnonzero(there).max())
            moved += bool(np.linalg.norm(position[a, end] - position[a, 0]) > PARKED_M)
            continue
        length = int(there.argmin()) if not there.all() else len(there)
        speed, turn = played["speed"][a, :length], np.unwrap(heading[a, :length])
        there = tracks["valid"][a, start_step:][:length]
        length = min(length, len(there) if there.all() else int(there.argmin()))
        logged = np.linalg.norm(tracks["velocity"][a, start_step:][:length], axis=-1)
        if logged[0] >= DRIVES_MPS:
            movers += 1
            stopped += stops(logged, speed[:length], scene.dt)
        # an action is the change over a step; the first follows the log
        action = {"a": np.diff(speed) / scene.dt, "w": np.diff(turn) / scene.dt}
        for name, values in action.items():
            for k in range(1, len(values)):
                key = f"{name}_replan" if k % replan_steps == 0 else name
                jumps[key].append(float(abs(values[k] - values[k - 1])))
    driven = np.flatnonzero((kinds == "vehicle") & (ids != "ego") & active[:, 0])
    if len(driven):
        cars = Motion(
            position[driven], heading[driven], scene.sizes[driven][:, :2], active[driven],
            dt_s=scene.dt,
        )  # fmt: skip
        road, steps_in_all = off_road(scene, cars), int(active[driven].sum())
        off = 0 if road is None else int((road.centroid & active[driven]).sum())
    return {
        "long_overlaps": len(long), "parked": parked, "parked_moved": moved, "off": off,
        "vehicles": len(driven), "vehicle_steps": steps_in_all, "jumps": jumps,
        "movers": movers, **dict(zip(STOPS, stopped.tolist(), strict=True)),
    }  # fmt: skip


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add_scene_arguments(parser, "test")
    parser.add_argument(
        "--ccdiff", type=json.loads, default={}, help="fields of CcdiffConfig, JSON"
    )
    parser.add_argument("--world", type=json.loads, default={}, help="fields of WorldConfig, JSON")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    scenes = scenes_from(args)
    found = []
    for at in range(0, len(scenes), CHUNK):
        part = scenes[at : at + CHUNK]
        replan_steps = args.ccdiff.get("replan_steps", 5)
        played = play(part, args.ccdiff, args.world, args.seed)
        start_step = WorldConfig().with_options(**args.world).history_steps
        found += [
            figures(s, p, start_step, replan_steps) for s, p in zip(part, played, strict=True)
        ]
    names = ("vehicles", "long_overlaps", "parked", "parked_moved", "movers", *STOPS)
    total = {n: sum(f[n] for f in found) for n in names}
    share = sum(f["off"] for f in found) / max(sum(f["vehicle_steps"] for f in found), 1)
    jumps = {}
    for name in found[0]["jumps"]:
        values = [v for f in found for v in f["jumps"][name]]
        jumps[name] = [round(float(np.mean(values)), 4), round(float(np.percentile(values, 95)), 4)]
    print(
        json.dumps(
            {
                "scenes": len(found),
                **total,
                "off_road_%": round(100 * share, 3),
                "jumps (mean, p95)": jumps,
            }
        )
    )


if __name__ == "__main__":
    main()
