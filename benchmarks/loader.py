"""Time and peak memory of loading nuScenes.

    python benchmarks/loader.py --dataroot DATA/nuscenes --version v1.0-trainval

Every figure is the best of some runs, each in a process of its own, taken in turns, files in the
page cache. "cpu s" adds up the threads: on a busy machine it says more than the clock.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

#: What each way of loading runs before the clock, and the cache that it takes.
WAYS = {
    "cold, no cache": ("", "False"),
    "cold, cache written": ("shutil.rmtree(folder, ignore_errors=True)", "folder"),
    "warm": ("", "folder"),
}
CODE = """
import resource, shutil, sys, time
import ccdiff_env
root, version, folder = sys.argv[1:]
{before}
clock, cpu = time.perf_counter(), time.process_time()
scenes = ccdiff_env.load_nuscenes(root, version, cache={cache})
print(time.perf_counter() - clock, time.process_time() - cpu, len(scenes))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def run(way: str, *arguments: str) -> list[float]:
    """Return seconds, CPU seconds, scenes and peak resident MiB of one load."""
    before, cache = WAYS[way]
    command = [sys.executable, "-c", CODE.format(before=before, cache=cache), *arguments]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [float(word) for word in out.split()]


def main() -> None:
    """Print a line per way of loading."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataroot", required=True)
    parser.add_argument("--version", default="v1.0-trainval")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        cache = str(Path(folder) / "cache")
        # in turns, so that other load on the machine affects all alike
        rounds = [
            {way: run(way, args.dataroot, args.version, cache) for way in WAYS} for _ in range(3)
        ]
    print(f"{'':<22}{'seconds':>9}{'cpu s':>9}{'scenes':>9}{'peak MiB':>10}")
    for way in WAYS:
        runs = zip(*(taken[way] for taken in rounds), strict=True)
        seconds, cpu, count, peak = map(min, runs)
        print(f"{way:<22}{seconds:>9.3f}{cpu:>9.3f}{count:>9.0f}{peak:>10.0f}")


if __name__ == "__main__":
    main()
