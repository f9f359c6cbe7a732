"""Time and peak memory of loading nuScenes, ours beside nuscenes-devkit's constructor.

    python benchmarks/loader.py --dataroot DATA/nuscenes --version v1.0-trainval

Every figure is the best of some runs, each in a process of its own, taken in turns, files in the
page cache. "cpu s" adds up the threads: on a busy machine it says more than the clock. The devkit's
constructor reads and indexes the tables; ours also reads the maps and builds every scene.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

RUNNERS = {
    "devkit constructor": """
from nuscenes.nuscenes import NuScenes
start = clock()
data = NuScenes(version, root, verbose=False)
taken, count = since(start), len(data.scene)
""",
    "cold, no cache": """
import ccdiff_env
start = clock()
scenes = ccdiff_env.load_nuscenes(root, version, cache=False)
taken, count = since(start), len(scenes)
""",
    "cold, cache written": """
import ccdiff_env, shutil
shutil.rmtree(cache, ignore_errors=True)
start = clock()
scenes = ccdiff_env.load_nuscenes(root, version, cache=cache)
taken, count = since(start), len(scenes)
""",
    "warm": """
import ccdiff_env
start = clock()
scenes = ccdiff_env.load_nuscenes(root, version, cache=cache)
taken, count = since(start), len(scenes)
""",
    "warm, 10 scenes": """
import ccdiff_env, json
names = [s["name"] for s in json.load(open(f"{root}/{version}/scene.json"))][:10]
start = clock()
scenes = ccdiff_env.load_nuscenes(root, version, scenes=names, cache=cache)
taken, count = since(start), len(scenes)
""",
}

FRAME = """
import resource, sys, time
root, version, cache = sys.argv[1:]
def clock():
    return time.perf_counter(), time.process_time()
def since(start):
    return [b - a for a, b in zip(start, clock())]
{body}
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(*taken, count, peak / 1024)
"""


def run(body: str, root: Path, version: str, cache: Path) -> tuple[float, float, int, float]:
    """Return seconds, processor seconds, scenes and peak resident MiB of one run in its process."""
    code = FRAME.format(body=body)
    command = [sys.executable, "-c", code, str(root), version, str(cache)]
    out = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return float(out[0]), float(out[1]), int(out[2]), float(out[3])


def table(root: Path, version: str, repeats: int) -> None:
    """Print one line per way of loading."""
    nothing = "import ccdiff_env\ntaken, count = (0.0, 0.0), 0"
    *_, base_mib = min(run(nothing, root, version, Path("-")) for _ in range(2))
    size = sum(p.stat().st_size for p in (root / version).glob("*.json")) / 2**20
    print(
        f"{root.name} {version}: {size:.0f} MiB of tables; a bare import takes {base_mib:.0f} MiB"
    )
    heads = ("seconds", "ratio", "cpu s", "ratio", "scenes", "peak MiB", "above import")
    print(" " * 22 + "".join(f"{head:>{max(9, len(head) + 2)}}" for head in heads))
    reference = None
    with tempfile.TemporaryDirectory() as folder:
        # in turns: what else the machine does in the meantime befalls them all
        rounds = [
            {
                name: run(body, root, version, Path(folder) / "cache")
                for name, body in RUNNERS.items()
            }
            for _ in range(repeats)
        ]
    for name in RUNNERS:
        runs = [taken[name] for taken in rounds]
        seconds, _, count, peak = min(runs)
        cpu = min(taken for _, taken, _, _ in runs)
        if name.startswith("devkit"):
            reference = (seconds, cpu)
        by_clock, by_cpu = (
            f"{whole / part:.1f}x" if reference else "-"
            for whole, part in zip(reference or (0, 0), (seconds, cpu), strict=True)
        )
        above = "" if name.startswith("devkit") else f"{peak - base_mib:.0f}"
        print(
            f"{name:<22}{seconds:>9.3f}{by_clock:>9}{cpu:>9.3f}{by_cpu:>9}"
            f"{count:>9}{peak:>10.0f}{above:>14}"
        )


def main() -> None:
    """Parse options and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataroot", type=Path, required=True)
    parser.add_argument("--version", default="v1.0-trainval")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    table(options.dataroot, options.version, options.repeats)


if __name__ == "__main__":
    main()
