"""Steps per second through Python: ``python benchmarks/steps.py``.

A scene-step is one step of one world, an agent-step one step of one controlled agent: it is moved,
checked for collisions and road departures, rewarded and observed. Resets of ended episodes are
included (SAME_STEP), background agents are moved but not counted. One thread: steps per second of
its processor time; more: per second of the clock. Best of some rounds.

- *make_vec*: the vector environment on the embedded scenes, default configuration, but
  ``copy=False`` and ``info="end"`` as a learner would choose.
- *equal work*: the worlds beneath, all vehicles controlled, with 7 + 63 x 7 + 200 x 7 = 1,848
  floats each: the work that other simulators' figures are quoted for. It needs real roads, the
  eight scenes of most vehicles in ``--scenes``.
- traffic of networks: a plan every 0.5 s, one sample, the ego driven by IDM; without ``--scenes``
  in the embedded ones.

The last lines say what one world of 1,024 costs, when it is reset and when it goes on alone, and
what a plan of CCDiff costs.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

import ccdiff_env
from ccdiff_env.config import ObservationConfig, WorldConfig
from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.worlds import Worlds, scene_set


def best_s(step: Callable[[], object], threads: int, rounds: int) -> float:
    """Return the best seconds per call over rounds of about a fifth of a second."""
    clock = time.process_time if threads == 1 else time.perf_counter
    best = float("inf")
    for _ in range(rounds):
        end, start, calls = time.perf_counter() + 0.2, clock(), 0
        while time.perf_counter() < end:
            step()
            calls += 1
        best = min(best, (clock() - start) / calls)
    return best


@dataclass(frozen=True)
class Steps:
    """Something to be stepped."""

    step: Callable[[], object]
    envs: int
    threads: int
    agents: float
    floats: int
    steps: int = 1  #: That one call takes.

    def report(self, name: str, rounds: int) -> None:
        """Measure and print one line."""
        s = best_s(self.step, self.threads, rounds) / self.steps
        slots = self.envs * self.agents
        print(
            f"{name:<36}{self.envs:>6}{self.threads:>4}{self.agents:>5.0f}{self.floats:>6}"
            f"{self.envs / s:>13,.0f}{slots / s:>13,.0f}{s * 1e9 / slots:>9,.0f}",
            flush=True,
        )


def vector_env(envs: int, traffic: str, threads: int) -> Steps:
    """Return a vector environment that has begun, as what steps it."""
    options = {"copy": False, "info": "end", "autoreset_mode": "same_step"}
    env = ccdiff_env.make_vec(envs, traffic=traffic, num_threads=threads, **options)
    env.reset(seed=0)
    shape = env.action_space.shape
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, shape).astype(np.float32)
    return Steps(lambda: env.step(actions), envs, threads, 1, env.single_observation_space.shape[0])


def network_env(scenes: SceneSet, envs: int, threads: int, traffic: str, **ccdiff: object) -> Steps:
    """Return a vector environment in traffic that plans, as what takes ten steps of it."""
    options = {"copy": False, "info": "end", "driver": "idm", "ccdiff": ccdiff}
    env = ccdiff_env.make_vec(envs, scenes=scenes, traffic=traffic, num_threads=threads, **options)
    env.reset(seed=0)
    idle, width = np.zeros(env.action_space.shape, np.float32), env.single_observation_space.shape
    return Steps(lambda: [env.step(idle) for _ in range(10)], envs, threads, 1, width[0], 10)


def vehicles(scene: Scene) -> int:
    """Return how many vehicles are there when an episode starts."""
    there = scene.tracks()["valid"][:, WorldConfig().history_steps]
    return int((there & (np.array(scene.agent_types) == "vehicle")).sum())


def equal_work(scenes: Sequence[Scene], envs: int, threads: int) -> Steps:
    """Return the worlds beneath with all vehicles controlled, as what steps them."""
    slots = max(map(vehicles, scenes))
    config = WorldConfig(
        controlled="vehicles",
        num_slots=slots,
        on_collision="ignore",
        on_off_road="ignore",
        terminate_at_goal=False,
        horizon_steps=91,
        autoreset="same_step",
        observation=ObservationConfig(
            num_neighbors=63,
            num_route_points=0,
            num_map_segments=200,
            radius_m=200.0,
            masks=False,
            ego_columns=(
                *("speed", "acceleration", "yaw_rate", "length", "width", "off_road", "collided"),
            ),
            agent_columns=("x", "y", "cos", "sin", "speed", "length", "width"),
            map_columns=("x", "y", "cos", "sin", "half_length", "is_lane", "is_road_edge"),
        ),
    )
    worlds = Worlds(scene_set(list(scenes)), config, num_worlds=envs, num_threads=threads)
    out = worlds.arrays()
    worlds.native.reset(list(range(envs)), [None] * envs, None, out)
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (envs, slots, 2)).astype(np.float32)
    there = sum(a is not None for i in range(envs) for a in worlds.native.slot_agents(i)) / envs
    return Steps(lambda: worlds.native.step(actions, out), envs, threads, there, out.obs.shape[-1])


def one_of_many(rounds: int, envs: int = 1024) -> None:
    """Print what it costs to reset one world of many, and to step one of them."""
    config = WorldConfig(autoreset="same_step")
    worlds = Worlds(scene_set(None), config, num_worlds=envs, num_threads=1)
    out, native, nothing = worlds.arrays(), worlds.native, [None] * envs
    native.reset(list(range(envs)), nothing, None, out)
    actions = np.zeros((envs, 1, 2), np.float32)
    one, nobody = np.eye(1, envs, dtype=np.bool_)[0], np.zeros(envs, np.bool_)
    masks = {"none": nobody.tolist(), "one": one.tolist()}
    figures = {
        f"reset of {name}": lambda mask=mask: native.reset(nothing, nothing, mask, out)
        for name, mask in masks.items()
    }
    figures |= {
        "step of all": lambda: native.step(actions, out),
        "step of none": lambda: native.step(actions, out, nobody),
        "step of one": lambda: native.step(actions, out, one),
    }
    for name, call in figures.items():
        print(f"{name} of {envs} worlds: {best_s(call, 1, rounds) * 1e6:,.1f} us")


def plans(scenes: SceneSet, rounds: int, envs: int = 64, step: int = 40) -> None:
    """Print what plans of some worlds cost in one thread."""
    part = [scenes[i % len(scenes)] for i in range(envs)]
    for solver_steps in (5, 1):
        model = TrajectoryModel(shipped_weights(one_step=solver_steps == 1))
        plan = partial(model.plan, part, [step] * envs, solver_steps=solver_steps)
        count = sum(len(found.agents) for found in plan())
        ms = 1e3 * best_s(plan, 1, rounds) / count
        print(
            f"a plan of {count} vehicles, denoising steps {solver_steps}: {ms:.2f} ms per vehicle"
        )


def table(rounds: int, source: str | None) -> None:
    """Print all figures, those of real roads first."""
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    heads = ("E", "n", "C", "D", "scene-st/s", "agent-st/s", "ns/as")
    widths = (6, 4, 5, 6, 13, 13, 9)
    print("E worlds, n threads, C controlled agents each, D floats of observation each")
    print(" " * 36 + "".join(f"{head:>{w}}" for head, w in zip(heads, widths, strict=True)))
    sizes = ((1, 1), (64, 1), (1024, 1), (1024, threads))
    if source is not None:
        real = sorted(ccdiff_env.load(source), key=vehicles, reverse=True)[:8]
        equal_work(real[:1], 1, 1).report(f"equal work, {real[0].name}", rounds)
        equal_work(real[:1], 64, 1).report(f"equal work, {real[0].name}", rounds)
        equal_work(real, 64, 1).report("equal work, eight scenes", rounds)
    for traffic in ("replay", "idm"):
        for envs, n in sizes:
            vector_env(envs, traffic, n).report(f"make_vec, {traffic}", rounds)
    scenes = ccdiff_env.load(source or "embedded/val")
    for envs, n in ((1, 1), (64, 1), (64, threads)):
        network_env(scenes, envs, n, "swift", criticality=1.0).report("make_vec, swift", rounds)
        for criticality, steps in product((0.0, 1.0), (5, 1)):
            ccdiff = {"criticality": criticality, "denoising_steps": steps}
            name = f"make_vec, ccdiff-{criticality:g}, {steps} denoising"
            network_env(scenes, envs, n, "ccdiff", **ccdiff).report(name, rounds)
    one_of_many(rounds)
    plans(scenes, rounds)


def main() -> None:
    """Parse options; print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="rounds of 0.2 s per figure")
    parser.add_argument("--scenes", help="source of real roads, as ccdiff_env.load takes it")
    options = parser.parse_args()
    table(options.rounds, options.scenes)


if __name__ == "__main__":
    main()
