"""Speed of CCDiff traffic: ``python benchmarks/traffic.py [--dataroot <nuscenes>]``.

- *ego steps per second* of the vector environment, reset and step through Python, resets included,
  a plan every 0.5 s, DDIM with five steps, one sample; the ego is driven by IDM.
- *plans per second* (one world planned once) and milliseconds per vehicle and plan, per vehicle and
  simulated frame (five frames a plan), for both presets. The ``paper`` network has fresh weights:
  its speed does not depend on them.

Seconds are of the clock and of the processor (all threads); the latter do not depend on what else
the machine does. Scenes: ccdiff100 of the data set, else the embedded validation scenes.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

import ccdiff_env
from ccdiff_env.models import Planner, require_networks, shipped_weights
from ccdiff_env.scenes import SceneSet

require_networks()
from ccdiff_env import _models  # noqa: E402

ENVS = (1, 8, 32)
STEP = 40


def scenes_of(dataroot: str | None) -> SceneSet:
    if dataroot is None:
        return ccdiff_env.embedded_scenes("val")
    return ccdiff_env.load_nuscenes(dataroot, "v1.0-trainval", "ccdiff100")


def paper_weights(scenes: SceneSet, folder: str) -> Path:
    """Write fresh weights of the paper's preset."""
    model, training = _models.model_preset("paper")
    trainer = _models.Trainer(
        list(scenes[:1]), [], model, training, device="cpu", stride=10, smooth=False, estimate=True
    )
    path = Path(folder) / "paper.safetensors"
    trainer.export(str(path), '{"data": "none: fresh weights"}')
    return path


def ego_steps(scenes: SceneSet, steps: int, **options: object) -> None:
    for envs in ENVS:
        env = ccdiff_env.make_vec(
            envs, scenes=scenes, traffic="ccdiff", driver="idm", copy=False, info="end", **options
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
            f"{count / busy:7.0f} per second of one processor"
        )
        env.close()


def plans(name: str, weights: Path, scenes: SceneSet, rounds: int, solver_steps: int) -> None:
    planner = Planner(weights)
    for envs in ENVS:
        part = [scenes[i % len(scenes)] for i in range(envs)]
        steps = [STEP] * envs
        vehicles = sum(len(p.agents) for p in planner.plan(part, steps, solver_steps=solver_steps))
        start, busy = time.perf_counter(), time.process_time()
        for _ in range(rounds):
            planner.plan(part, steps, solver_steps=solver_steps)
        clock = (time.perf_counter() - start) / rounds
        busy = (time.process_time() - busy) / rounds
        print(
            f"  {name}, E = {envs:3d}, {vehicles:4d} vehicles: {envs / clock:7.1f} plans/s, "
            f"{1e3 * busy / vehicles:7.2f} ms of processor per vehicle and plan, "
            f"{1e3 * busy / vehicles / 5:6.3f} per vehicle and frame"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dataroot", help="folder of nuScenes; embedded scenes without it")
    parser.add_argument("--steps", type=int, default=50, help="steps per measurement")
    parser.add_argument("--rounds", type=int, default=3, help="plans per measurement")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    scenes = scenes_of(args.dataroot)
    vehicles = np.mean([int(s.tracks()["valid"][:, STEP].sum()) for s in scenes])
    print(
        f"{len(scenes)} scenes, {vehicles:.1f} agents at a time, {args.threads} thread(s) of torch"
    )
    print("Ego-v0 in CCDiff traffic, not guided:")
    ego_steps(scenes, args.steps)
    print("Ego-v0 in CCDiff traffic, criticality 1, K = 5:")
    ego_steps(scenes, args.steps, ccdiff={"criticality": 1.0})
    print("Plans, DDIM with 5 steps, one sample:")
    plans("fast", shipped_weights(), scenes, args.rounds, 5)
    with tempfile.TemporaryDirectory() as folder:
        plans("paper", paper_weights(scenes, folder), scenes, 1, 5)


if __name__ == "__main__":
    main()
