"""Memory over time: worlds of all kinds made, stepped, drawn and dropped.

    python benchmarks/soak.py --minutes 60 --out runs/soak

writes the resident memory of each round as ``memory.csv`` and ``memory.svg``, and fails where the
last quarter needs over 5 % more than the second one.
"""

from __future__ import annotations

import argparse
import csv
import gc
import itertools
import os
import time
from pathlib import Path

import numpy as np

import ccdiff_env
from ccdiff_env.bench.plots import new_plot, save_plot

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
MAX_GROWTH = 0.05
#: One round makes each of these: traffic, and worlds.
KINDS = [("replay", 64), ("idm", 64), ("ccdiff", 4), ({"idm": 0.5, "ccdiff": 0.5}, 4)]


def resident_mib() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * PAGE_BYTES / 2**20


def one_round(seed: int) -> int:
    """Vector, single and several-vehicle environments, images, snapshots; steps of worlds."""
    steps = 0
    rng = np.random.default_rng(seed)
    for traffic, num_worlds in KINDS:
        mode = ("next_step", "same_step")[seed % 2]
        worlds = ccdiff_env.make_vec(num_worlds, traffic=traffic, autoreset_mode=mode)
        worlds.reset(seed=seed)
        for _ in range(60):
            worlds.step(rng.uniform(-1, 1, worlds.action_space.shape).astype(np.float32))
        steps += 60 * num_worlds
        worlds.close()
    env = ccdiff_env.EgoEnv(traffic="ccdiff", criticality=1.0, render_mode="rgb_array")
    env.reset(seed=seed)
    recorder, state = ccdiff_env.Recorder(env), env.snapshot()
    for _ in range(20):
        _, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        recorder.step()
        env.render()
        if terminated or truncated:
            break
    recorder.rollout().to_scene()
    env.restore(state)
    env.close()
    env = ccdiff_env.parallel_env(agents=4, adversaries=1)
    env.reset(seed=seed)
    for _ in range(20):
        if env.agents:
            env.step({name: env.action_space(name).sample() for name in env.agents})
    return steps + 40


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--out", type=Path, default=Path("runs/soak"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows, steps, start = [], 0, time.monotonic()
    with (args.out / "memory.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["minutes", "steps", "resident_mib"])
        for seed in itertools.count():
            steps += one_round(seed)
            gc.collect()
            rows.append(((time.monotonic() - start) / 60.0, steps, resident_mib()))
            writer.writerow(rows[-1])
            file.flush()
            if rows[-1][0] >= args.minutes and len(rows) >= 4:
                break
    minutes, _, memory = np.array(rows).T
    quarters = [part.mean() for part in np.array_split(memory, 4)]
    growth = quarters[3] / quarters[1] - 1.0
    figure, axes = new_plot(7, 3)
    axes.plot(minutes, memory)
    axes.set_ylim(0, memory.max() * 1.2)
    axes.set_xlabel("minutes")
    axes.set_ylabel("resident memory, MiB")
    save_plot(figure, args.out / "memory")
    print(
        f"{len(rows)} rounds, {steps:,} world steps in {minutes[-1]:.1f} minutes: "
        f"{' '.join(f'{q:.0f}' for q in quarters)} MiB by quarter, growth {growth:+.1%}"
    )
    return int(growth > MAX_GROWTH)


if __name__ == "__main__":
    raise SystemExit(main())
