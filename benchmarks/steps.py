"""Steps per second through Python, and ratios of them: ``python -m benchmarks.steps``.

A step is one step of one world: all vehicles are moved, checked for collisions and the road, the
ego is rewarded and observed. Resets of ended episodes are included. Scenes are the embedded ones,
which everybody has; the ego's actions are small random ones. The figures of a row of traffic:

- E = 1: ``gymnasium.make`` and a loop over ``step`` and ``reset``. Where highway-env is installed,
  the same loop steps its ``highway-fast-v0``, whose frames count, several of each of its steps.
- E = 64, 1,024: ``make_vec`` as a learner would choose it. Networks plan every half second.
- its ratio to IDM's steps at E = 64 (of highway-env at E = 1), and what a vehicle's plan takes
  beyond log replay.

All rows take turns, round after round, and figures are medians over rounds of steps per second of
processor time on one thread: ratios hold on a machine that is busy or slow.
``--keep`` writes the table into docs/results.
"""

from __future__ import annotations

import argparse
import datetime
import os
import time
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np

import ccdiff_env
from ccdiff_env.bench.provenance import processor
from ccdiff_env.config import WorldConfig
from ccdiff_env.system.table import Table
from ccdiff_env.worlds import scene_set

#: Traffic by title, with its options.
TRAFFIC: dict[str, dict[str, Any]] = {
    "log replay": {"traffic": "replay"},
    "IDM": {"traffic": "idm"},
    "swift": {"traffic": "swift"},
    "CCDiff, one step": {"traffic": "ccdiff", "ccdiff": {"denoising_steps": 1}},
    "CCDiff": {"traffic": "ccdiff"},
}
HIGHWAY = "highway-env's highway-fast-v0"
PLAN_STEPS = 5  #: Steps from one plan to the next.
HEADS = {
    "what": "traffic",
    "1": "E = 1",
    "64": "E = 64",
    "1024": "E = 1,024",
    "of_idm": "of IDM's steps",
    "plan_us": "µs per vehicle and plan",
}


def one_env(made: gymnasium.Env[Any, Any], frames: int = 1) -> tuple[Callable[[], object], float]:
    """Return what takes ten steps of an environment and resets it where it ends, and the frames of
    a call.
    """
    made.reset(seed=0)
    made.action_space.seed(0)

    def steps() -> None:
        for _ in range(10):
            _, _, terminated, truncated, _ = made.step(made.action_space.sample())
            if terminated or truncated:
                made.reset()

    return steps, 10.0 * frames


def vector_env(envs: int, **options: Any) -> tuple[Callable[[], object], float]:
    """Return what takes ten steps of a vector environment, and the steps of a call."""
    learner = {"copy": False, "info": "end", "autoreset_mode": "same_step"}
    env = ccdiff_env.make_vec(envs, num_threads=1, **learner, **options)
    env.reset(seed=0)
    shape = env.action_space.shape
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, shape).astype(np.float32)
    return lambda: [env.step(actions) for _ in range(10)], 10.0 * envs


def seconds_of(call: Callable[[], object], span_s: float) -> float:
    """Return processor seconds per call over a span."""
    end, start, calls = time.perf_counter() + span_s, time.process_time(), 0
    while time.perf_counter() < end or not calls:
        call()
        calls += 1
    return (time.process_time() - start) / calls


def measured(rounds: int, span_s: float) -> dict[tuple[str, str], list[float]]:
    """Return seconds per step of every row and column, one of each round."""
    calls: dict[tuple[str, str], tuple[Callable[[], object], float]] = {}
    if find_spec("highway_env") is not None:
        import highway_env  # noqa: F401  # registers its environments

        made = gymnasium.make("highway-fast-v0")
        config = made.unwrapped.config  # type: ignore[attr-defined]
        frames = config["simulation_frequency"] // config["policy_frequency"]
        calls[HIGHWAY, "1"] = one_env(made, frames)
    for what, options in TRAFFIC.items():
        calls[what, "1"] = one_env(gymnasium.make("ccdiff_env/Ego-v0", **options))
        calls[what, "64"] = vector_env(64, **options)
        if "ccdiff" not in options["traffic"]:
            calls[what, "1024"] = vector_env(1024, **options)
    found: dict[tuple[str, str], list[float]] = {key: [] for key in calls}
    for _ in range(rounds):
        for key, (call, steps) in calls.items():
            found[key].append(seconds_of(call, span_s) / steps)
    return found


def vehicles() -> float:
    """Return how many vehicles but the ego a world has when its episode starts, on average."""
    scenes, at = scene_set(None), WorldConfig().history_steps
    there = [
        (s.tracks()["valid"][:, at] & (np.array(s.agent_types) == "vehicle")).sum() - 1
        for s in scenes
    ]
    return float(np.mean(there))


def rows(found: Mapping[tuple[str, str], list[float]], driven: float) -> list[dict[str, Any]]:
    """Return the table's rows."""
    made = []
    log = np.array(found["log replay", "64"])
    for what in dict.fromkeys(what for what, _ in found):
        of = {column: values for (name, column), values in found.items() if name == what}
        row: dict[str, Any] = {"what": what}
        row |= {c: int(float(f"{1.0 / np.median(v):.3g}")) for c, v in of.items()}
        column = "64" if "64" in of else "1"
        ratio = np.median(np.array(found["IDM", column]) / of[column])
        row["of_idm"] = f"{100.0 * ratio:.3g} %"
        if TRAFFIC.get(what, {}).get("traffic") in ("swift", "ccdiff"):
            extra_us = 1e6 * np.median(np.array(of["64"]) - log)
            row["plan_us"] = int(float(f"{extra_us * PLAN_STEPS / driven:.2g}"))
        made.append(row)
    return made


def main() -> None:
    """Parse options; measure, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, help="rounds of all figures")
    parser.add_argument("--span", type=float, default=0.2, help="seconds of a figure in a round")
    parser.add_argument("--keep", action="store_true", help="write docs/results/speed.json")
    options = parser.parse_args()
    driven = vehicles()
    table = rows(measured(options.rounds, options.span), driven)
    about = {
        "command": "python -m benchmarks.steps --keep",
        "machine": f"{processor()}, {os.cpu_count()} cores",
        "date": datetime.date.today().isoformat(),
        "heads": HEADS,
    }
    cells = [[row.get(name, "–") for name in HEADS] for row in table]
    print(Table([*HEADS.values()], cells), about, sep="\n")
    if options.keep:
        from tools.pages import keep

        keep("speed", about, table)


if __name__ == "__main__":
    main()
