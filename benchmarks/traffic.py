"""Speed of traffic of networks: ``python benchmarks/traffic.py [--scenes SOURCE]``.

- *ego steps per second* of the vector environment, reset and step through Python, resets included,
  a plan every 0.5 s, DDIM with five steps, one sample, and in one step; the ego is driven by IDM.
- *plans per second* (one world planned once) and milliseconds per vehicle and plan, and per vehicle
  and simulated frame (five frames a plan).

Seconds are of the clock and of the processor (all threads); the latter do not depend on what else
the machine does.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

import ccdiff_env
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.traffic import SWIFT

ENVS = (1, 8, 32, 64)
STEP = 40


def ego_steps(scenes: SceneSet, steps: int, traffic: str = "ccdiff", **options: object) -> None:
    for envs in ENVS:
        env = ccdiff_env.make_vec(
            envs, scenes=scenes, traffic=traffic, driver="idm", copy=False, info="end", **options
        )
        env.reset(seed=0)
        idle = np.zeros(env.action_space.shape, np.float32)
        for _ in range(6):
            env.step(idle)
        start, busy = time.perf_counter(), time.process_time()
        for _ in range(steps):
            env.step(idle)
        clock, busy = time.perf_counter() - start, time.process_time() - busy
        count = envs * steps
        print(
            f"  E = {envs:3d}: {count / clock:7.0f} ego steps/s of the clock, "
            f"{count / busy:7.0f} per CPU second"
        )
        env.close()


def plans(weights: Path, scenes: SceneSet, rounds: int, solver_steps: int) -> None:
    """Print the speed of plans."""
    model = TrajectoryModel(weights)
    for envs in ENVS:
        part = [scenes[i % len(scenes)] for i in range(envs)]
        steps = [STEP] * envs
        vehicles = sum(len(p.agents) for p in model.plan(part, steps, solver_steps=solver_steps))
        start, busy = time.perf_counter(), time.process_time()
        for _ in range(rounds):
            model.plan(part, steps, solver_steps=solver_steps)
        clock = (time.perf_counter() - start) / rounds
        busy = (time.process_time() - busy) / rounds
        print(
            f"  E = {envs:3d}, {vehicles:4d} vehicles: {envs / clock:7.1f} plans/s of the "
            f"clock, {envs / busy:7.1f} per CPU second, "
            f"{1e3 * busy / vehicles:7.2f} ms of it per vehicle and plan, "
            f"{1e3 * busy / vehicles / 5:6.3f} per vehicle and frame"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--steps", type=int, default=50, help="steps per measurement")
    parser.add_argument("--rounds", type=int, default=3, help="plans per measurement")
    parser.add_argument("--threads", type=int, default=1, help="threads of worlds and of torch")
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(args.threads)
    scenes = scenes_from(args)
    vehicles = np.mean([int(s.tracks()["valid"][:, STEP].sum()) for s in scenes])
    print(f"{len(scenes)} scenes, {vehicles:.1f} agents at a time, {args.threads} thread(s)")
    for traffic in ("idm", SWIFT, "idm", SWIFT):
        print(f"Ego-v0 in {traffic} traffic, criticality 1 where there is one")
        ccdiff = {"ccdiff": {"criticality": 1.0}} if traffic == SWIFT else {}
        ego_steps(scenes, args.steps, traffic, num_threads=args.threads, **ccdiff)
    for guided, criticality in (("not guided", 0.0), ("criticality 1, K = 5", 1.0)):
        for denoising_steps in (5, 1):
            print(f"Ego-v0 in CCDiff traffic, {guided}, denoising steps: {denoising_steps}")
            ccdiff = {"criticality": criticality, "denoising_steps": denoising_steps}
            ego_steps(scenes, args.steps, ccdiff=ccdiff, num_threads=args.threads)
    for steps in (5, 1):
        print(f"Plans, denoising steps: {steps}, one sample")
        plans(shipped_weights(one_step=steps == 1), scenes, args.rounds, steps)


if __name__ == "__main__":
    main()
