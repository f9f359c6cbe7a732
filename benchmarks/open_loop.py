"""Open-loop errors of a CCDiff network on nuScenes scenes, and how fast it plans.

``python benchmarks/open_loop.py [--scenes SOURCE] [--weights <file>] [--limit N]``
prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch

from ccdiff_env.models import ScenePlan, TrajectoryModel, shipped_weights
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.arguments import add_scene_arguments, place_from
from ccdiff_env.scenes.sources import load

SAMPLES = 5
HORIZON = 52


def errors(scene: Scene, step: int, plan: ScenePlan) -> tuple[np.ndarray, np.ndarray]:
    """Distances [N, M', T] of the plans and [M', T] of constant velocity, for whole logs."""
    tracks = scene.tracks()
    span = slice(step + 1, step + 1 + HORIZON)
    whole = tracks["valid"][plan.agents, span].all(axis=1)
    rows = plan.agents[whole]
    logged = tracks["position"][rows, span]
    times = 0.1 * np.arange(1, HORIZON + 1)[None, :, None]
    start, velocity = tracks["position"][rows, step], tracks["velocity"][rows, step]
    constant = start[:, None] + velocity[:, None] * times
    planned = plan.positions()[:, whole]
    return (
        np.linalg.norm(planned - logged[None], axis=-1),
        np.linalg.norm(constant - logged, axis=-1),
    )


def quality(
    model: TrajectoryModel,
    cases: list[tuple[Scene, int]],
    solver_steps: int,
    follow_route: bool = False,
) -> dict[str, float]:
    """Means over vehicles of the errors in metres."""
    ours, constant = [], []
    for at in range(0, len(cases), 32):
        part = cases[at : at + 32]
        plans = model.plan(
            [scene for scene, _ in part],
            [step for _, step in part],
            solver_steps=solver_steps,
            num_samples=SAMPLES,
            follow_route=follow_route,
        )
        for (scene, step), plan in zip(part, plans, strict=True):
            found, reference = errors(scene, step, plan)
            ours.append(found)
            constant.append(reference)
    distance, reference = np.concatenate(ours, axis=1), np.concatenate(constant)
    return {
        "vehicles": distance.shape[1],
        "min_ade_m": float(distance.mean(-1).min(0).mean()),
        "min_fde_m": float(distance[..., -1].min(0).mean()),
        "ade_m": float(distance.mean(-1).mean()),
        "fde_m": float(distance[..., -1].mean()),
        "constant_velocity_ade_m": float(reference.mean()),
        "constant_velocity_fde_m": float(reference[:, -1].mean()),
    }


def speed(
    model: TrajectoryModel, cases: list[tuple[Scene, int]], solver_steps: int
) -> dict[str, float]:
    """Milliseconds per plan of the first 32 cases, drawing their maps included."""
    part = cases[:32]
    scenes, steps = [scene for scene, _ in part], [step for _, step in part]
    found = []
    for _ in range(5):
        begin = time.perf_counter()
        plans = model.plan(scenes, steps, solver_steps=solver_steps)
        found.append(1e3 * (time.perf_counter() - begin))
    vehicles = sum(len(plan.agents) for plan in plans)
    best = min(found)
    return {
        "worlds": len(part),
        "vehicles": vehicles,
        "ms": best,
        "ms_per_vehicle": best / vehicles,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_scene_arguments(parser, "test")
    parser.add_argument("--weights", type=Path, default=None)
    args = parser.parse_args()
    torch.set_num_threads(1)
    model = TrajectoryModel(args.weights or shipped_weights())
    # a network that was taught to plan in one step takes no other number, and who does not denoise
    # has none
    steps = (5, 10) if model.header["kind"] in ("ccdiff", "ctg", "ctgpp") else (5,)
    if model.header["training"].get("teacher_steps"):
        steps = (1,)
    knows_routes = bool(model.header["model"].get("route_points_m"))
    chosen = load(place_from(args), kinds=["vehicle"])
    cases = [(s, t) for s in chosen for t in range(30, s.num_steps - HORIZON, 20)]
    result = {
        "scenes": len(chosen),
        "plans": len(cases),
        "samples": SAMPLES,
        **{f"ddim_{n}": quality(model, cases, n) for n in steps},
        **{f"routes_ddim_{n}": quality(model, cases, n, True) for n in steps if knows_routes},
        **{f"speed_ddim_{n}": speed(model, cases, n) for n in steps},
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
