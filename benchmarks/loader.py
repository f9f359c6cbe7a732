"""Time and peak memory of loading nuScenes, ours beside nuscenes-devkit's constructor.

    python benchmarks/loader.py --dataroot DATA/nuscenes --version v1.0-trainval
    python benchmarks/loader.py --synthetic        # tables as large as the official v1.0-trainval

Every figure is the best of some runs, each in a process of its own, taken in turns, files in the
page cache.
"cpu s" adds up the threads: on a busy machine it says more than the clock. The devkit's constructor
reads and indexes the tables; ours also reads the maps and builds every scene.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
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


def table(root: Path, version: str, repeats: int, skip: list[str]) -> None:
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
    bodies = {name: body for name, body in RUNNERS.items() if name not in skip}
    with tempfile.TemporaryDirectory() as folder:
        # in turns: what else the machine does in the meantime befalls them all
        rounds = [
            {
                name: run(body, root, version, Path(folder) / "cache")
                for name, body in bodies.items()
            }
            for _ in range(repeats)
        ]
    for name in bodies:
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


def write_rows(path: Path, rows) -> None:
    """Write records as the official release does, one field a line."""
    with path.open("w") as file:
        file.write("[\n")
        for i, row in enumerate(rows):
            file.write(",\n" if i else "")
            file.write(json.dumps(row, indent=0))
        file.write("\n]\n")


def token(kind: int, number: int) -> str:
    """Return a token of 32 digits that looks random."""
    mixed = (number * 0x9E3779B97F4A7C15F39CC0605CEDC835 + kind * 0x2545F4914F6CDD1D) % 2**128
    return f"{mixed:032x}"


def synthesise(root: Path, *, scenes: int = 850, frames: int = 40, boxes: int = 35) -> None:
    """Write tables as large as the official v1.0-trainval: 1.2 M boxes, 2.6 M sensor records."""
    folder = root / "v1.0-synthetic"
    folder.mkdir(parents=True)
    channels = ["LIDAR_TOP"] + [f"CAM_{i}" for i in range(6)] + [f"RADAR_{i}" for i in range(5)]
    start = 1_531_883_530_000_000

    def every_frame():
        return ((s, k, s * frames + k) for s in range(scenes) for k in range(frames))

    def sensor_records():
        # 12 channels with a key frame and about 5.4 sweeps each
        for s, k, n in every_frame():
            for c, _ in enumerate(channels):
                for sweep in range(6 if c < 5 else 7):
                    yield s, k, n, c, sweep, token(7, (n * 12 + c) * 7 + sweep)

    single = {
        "category": [{"token": token(1, 0), "name": "vehicle.car", "description": "a car"}],
        "sensor": [
            {"token": token(2, c), "channel": n, "modality": "x"} for c, n in enumerate(channels)
        ],
        "calibrated_sensor": [
            {
                "token": token(3, c),
                "sensor_token": token(2, c),
                "translation": [0, 0, 0],
                "rotation": [1, 0, 0, 0],
                "camera_intrinsic": [],
            }
            for c in range(len(channels))
        ],
        "log": [
            {"token": token(4, s), "location": "nowhere", "logfile": ""} for s in range(scenes)
        ],
        "scene": [
            {
                "token": token(5, s),
                "name": f"scene-{s:04d}",
                "log_token": token(4, s),
                "nbr_samples": frames,
                "first_sample_token": token(6, s * frames),
                "last_sample_token": "",
                "description": "parked cars",
            }
            for s in range(scenes)
        ],
    }
    # what only the devkit reads
    single["attribute"] = [{"token": token(10, 0), "name": "vehicle.parked", "description": ""}]
    single["visibility"] = [{"token": "4", "level": "v80-100", "description": ""}]
    logs = [row["token"] for row in single["log"]]
    single["map"] = [
        {
            "token": token(11, 0),
            "log_tokens": logs,
            "category": "semantic_prior",
            "filename": "m.png",
        }
    ]
    (root / "m.png").touch()
    for name, rows in single.items():
        write_rows(folder / f"{name}.json", rows)
    write_rows(
        folder / "sample.json",
        (
            {
                "token": token(6, n),
                "timestamp": start + 500_000 * k,
                "scene_token": token(5, s),
                "prev": "",
                "next": "",
            }
            for s, k, n in every_frame()
        ),
    )
    write_rows(
        folder / "instance.json",
        (
            {
                "token": token(8, s * boxes + b),
                "category_token": token(1, 0),
                "nbr_annotations": frames,
                "first_annotation_token": "",
                "last_annotation_token": "",
            }
            for s in range(scenes)
            for b in range(boxes)
        ),
    )
    write_rows(
        folder / "sample_annotation.json",
        (
            {
                "token": token(9, n * boxes + b),
                "sample_token": token(6, n),
                "instance_token": token(8, s * boxes + b),
                "visibility_token": "4",
                "attribute_tokens": [token(10, 0)],
                "translation": [373.214 + b, 1130.48 + 0.1 * k, 1.25],
                "size": [1.9, 4.5, 1.6],
                "rotation": [0.9831098797903927, 0.0, 0.0, -0.18301629506281616],
                "prev": token(9, n * boxes + b),
                "next": token(9, n * boxes + b),
                "num_lidar_pts": 5,
                "num_radar_pts": 0,
            }
            for s, k, n in every_frame()
            for b in range(boxes)
        ),
    )
    write_rows(
        folder / "sample_data.json",
        (
            {
                "token": t,
                "sample_token": token(6, n),
                "ego_pose_token": t,
                "calibrated_sensor_token": token(3, c),
                "timestamp": start + 500_000 * k + 20_000 * sweep,
                "fileformat": "pcd",
                "is_key_frame": sweep == 0,
                "height": 0,
                "width": 0,
                "filename": f"sweeps/{channels[c]}/n015-2018-07-24-11-22-45__{n}{sweep}.pcd.bin",
                "prev": t,
                "next": t,
            }
            for s, k, n, c, sweep, t in sensor_records()
        ),
    )
    write_rows(
        folder / "ego_pose.json",
        (
            {
                "token": t,
                "timestamp": start + 500_000 * k + 20_000 * sweep,
                "rotation": [
                    0.5720320396729045,
                    -0.0016977771610471074,
                    0.011798001930183783,
                    -0.8201446642457809,
                ],
                "translation": [411.3039349319818 + 0.5 * k, 1180.8903791765097, 0.0],
            }
            for s, k, n, c, sweep, t in sensor_records()
        ),
    )


def main() -> None:
    """Parse options and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataroot", type=Path)
    parser.add_argument("--version", default="v1.0-trainval")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument(
        "--synthetic", action="store_true", help="write 3 GB of tables to a temporary folder"
    )
    parser.add_argument(
        "--scenes", type=int, default=850, help="scenes in the synthetic tables, 3.5 MB each"
    )
    parser.add_argument("--folder", type=Path, help="keep the synthetic tables here")
    parser.add_argument(
        "--devkit",
        action="store_true",
        help="the devkit on them too: 12 GB of memory for 850 scenes",
    )
    options = parser.parse_args()
    if options.dataroot:
        table(options.dataroot, options.version, options.repeats, [])
    if options.synthetic:
        with tempfile.TemporaryDirectory() as temporary:
            root = options.folder or Path(temporary)
            if not (root / "v1.0-synthetic" / "ego_pose.json").is_file():
                started = time.perf_counter()
                synthesise(root, scenes=options.scenes)
                print(f"wrote the tables in {time.perf_counter() - started:.0f} s")
            table(root, "v1.0-synthetic", 1, [] if options.devkit else ["devkit constructor"])


if __name__ == "__main__":
    main()
