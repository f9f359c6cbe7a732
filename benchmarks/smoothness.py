"""What a viewer sees of unguided CCDiff traffic: overlaps, parked movers, jumps at replans.

    python benchmarks/smoothness.py [--dataroot <nuscenes> --version v1.0-mini --split all]
        [--ccdiff '{"keep_noise": true}'] [--world '{"on_traffic_collision": "ignore"}']

The ego replays its log; all other vehicles are driven for 10 s. Counted: pairs without the ego that
do not touch at the start and then overlap by 0.2 m and more for longer than 0.5 s; vehicles that
the log moves by 1 m at most in all, and that end more than 1 m from where they started; means and
95th percentiles of the change of acceleration and yaw rate from one step to the next, in the step
that a new plan begins with and in the others; share of vehicle steps with the centre off the road.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

import ccdiff_env
from ccdiff_env.bench.episode import drivable
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.worlds import Worlds
from ccdiff_env.metrics import Motion
from ccdiff_env.scenes import Scene, SceneSet

#: Scenes that share a batch.
CHUNK = 12
#: Overlap that counts, m, for how long, steps.
DEPTH_M, LONGEST_STEPS = 0.2, 5
PARKED_M = 1.0


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
    worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=1)
    out, native = worlds.arrays(), worlds.native
    native.reset([seed] * len(scenes), list(range(len(scenes))), None, out)
    actions = np.zeros((len(scenes), 1, native.action_width), np.float32)
    states = [[native.states(i)] for i in range(len(scenes))]
    running = np.ones(len(scenes), np.bool_)
    while running.any():
        native.step(actions, out, running)
        for i in np.flatnonzero(running).tolist():
            states[i].append(native.states(i))
        running &= ~out.done
    names = ("position", "heading", "speed", "active")
    return [{n: np.stack([s[n] for s in one], axis=1) for n in names} for one in states]


def figures(scene: Scene, played: Any, replan_steps: int) -> dict[str, Any]:
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
    parked = moved = 0
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
        outside = cars.off_road(drivable(scene)).centroid
        off, steps_in_all = int((outside & active[driven]).sum()), int(active[driven].sum())
    return {
        "long_overlaps": len(long), "parked": parked, "parked_moved": moved, "off": off,
        "vehicles": len(driven), "vehicle_steps": steps_in_all, "jumps": jumps,
    }  # fmt: skip


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--dataroot")
    parser.add_argument("--version", default="v1.0-trainval")
    parser.add_argument("--split", help="ccdiff100; of the embedded scenes: val; all: no split")
    parser.add_argument("--limit", type=int)
    parser.add_argument(
        "--ccdiff", type=json.loads, default={}, help="fields of CcdiffConfig, JSON"
    )
    parser.add_argument("--world", type=json.loads, default={}, help="fields of WorldConfig, JSON")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    if args.dataroot is None:
        scenes = ccdiff_env.embedded_scenes(args.split or "val")
    else:
        split = None if args.split == "all" else args.split or "ccdiff100"
        scenes = ccdiff_env.load_nuscenes(args.dataroot, args.version, split)
    scenes = scenes[: args.limit]
    found = []
    for at in range(0, len(scenes), CHUNK):
        part = scenes[at : at + CHUNK]
        replan_steps = args.ccdiff.get("replan_steps", 5)
        played = play(part, args.ccdiff, args.world, args.seed)
        found += [figures(s, p, replan_steps) for s, p in zip(part, played, strict=True)]
    total = {
        n: sum(f[n] for f in found) for n in ("vehicles", "long_overlaps", "parked", "parked_moved")
    }
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
