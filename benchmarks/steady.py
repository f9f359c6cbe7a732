"""CCDiff traffic on a busy machine: ``python benchmarks/steady.py [--scenes SOURCE]``.

Ego steps per second of E = 32 worlds with CCDiff traffic (criticality 1), in a process of its own
that sets no variable of OpenMP: alone with one and with two threads, two processes of one thread
each, and with as many busy neighbours as there are cores; in eight processes of 4 worlds that say
no number of threads, like the workers of SubprocVecEnv; and in one that may use a single core, like
a container of one. All cases take turns, so that what else the machine does meets all of them. Also
the time and memory of a first CCDiff environment.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from typing import NamedTuple

import numpy as np

from ccdiff_env.scenes.arguments import add_scene_arguments, place_from

BUSY = "while True: pass"
WORKER = """
import resource, sys, time
import numpy as np
start = time.perf_counter()
import ccdiff_env
worlds, threads, steps = map(int, sys.argv[2:])
scenes = ccdiff_env.load(sys.argv[1])
read = time.perf_counter()
env = ccdiff_env.make_vec(
    worlds, scenes=scenes, traffic="ccdiff", driver="idm", copy=False, info="end",
    num_threads=threads or None, criticality=1.0,
)
env.reset(seed=0)
idle = np.zeros(env.action_space.shape, np.float32)
env.step(idle)
ready = time.perf_counter()
for _ in range(9):
    env.step(idle)
begin = time.perf_counter()
for _ in range(steps):
    env.step(idle)
speed = worlds * steps / (time.perf_counter() - begin)
mebibytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(speed, read - start, ready - read, mebibytes)
"""


class Case(NamedTuple):
    """What runs at once; without a number of threads the library finds one."""

    threads: int = 0
    processes: int = 1
    worlds: int = 32
    neighbours: int = 0
    one_core: bool = False


def measure(case: Case, args: argparse.Namespace) -> np.ndarray:
    """Ego steps per second of all processes together; of the first: seconds twice, MiB."""
    free = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "MKL_", "RAYON_"))}
    words = [place_from(args), case.worlds, case.threads, args.steps]
    command = [sys.executable, "-c", WORKER, *map(str, words)]
    if case.one_core:
        command = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0))), *command]
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(case.neighbours)]
    try:
        runs = [
            subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=free)
            for _ in range(case.processes)
        ]
        found = [np.array(run.communicate()[0].split(), float) for run in runs]
    finally:
        for process in busy:
            process.kill()
    return np.array([sum(one[0] for one in found), *found[0][1:]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--steps", type=int, default=100, help="steps of each measurement")
    parser.add_argument("--rounds", type=int, default=3, help="turns of all cases")
    args = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    cases = {
        "one thread": Case(1),
        f"{cores} threads": Case(cores),
        f"{cores} processes of one thread": Case(1, processes=cores),
        f"{cores} threads, {cores} busy neighbours": Case(cores, neighbours=cores),
        f"{2 * cores} threads, {cores} busy neighbours": Case(2 * cores, neighbours=cores),
        "8 processes of 4 worlds": Case(processes=8, worlds=4),
        "one core of the machine": Case(one_core=True),
    }
    rows: dict[str, list[np.ndarray]] = {name: [] for name in cases}
    for _ in range(args.rounds):
        for name, case in cases.items():
            rows[name].append(measure(case, args))
    found = {name: np.array(part) for name, part in rows.items()}
    first = found["one thread"]
    for name, part in found.items():
        middle, ratio = np.median(part[:, 0]), np.median(part[:, 0] / first[:, 0])
        print(f"{name:34s} {middle:7.0f} ego steps/s, {ratio:.2f} of one thread alone")
    read, made, mebibytes = np.median(first[:, 1:], axis=0)
    print(f"import and scenes {read:.1f} s; environment to its first step {made:.1f} s")
    print(f"peak {mebibytes:.0f} MiB")


if __name__ == "__main__":
    main()
