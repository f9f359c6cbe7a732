"""The log's own motion by the times of key frames and the curve between them.

    python benchmarks/log_motion.py --dataroot <nuscenes> [--version v1.0-trainval --split all]

First table: loads with every choice of ``timing`` and ``interpolation``. Vehicles above 3 m/s, the
ego and others: standard deviation of the change of speed per half second; rms of acceleration
(m/s²) and jerk (m/s³) from differences at 10 Hz; vehicle steps in which ``velocity`` differs from
the slope of ``position`` by more than a tenth. Of the log: pairs of agents in contact per scene,
and share of vehicle steps with the centre off the road.

Second table: each inner key frame of vehicles is left out once and foretold from the others, by
scipy's curves: rms of the error, and 99th percentile of how far the curve through all stays off.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, make_smoothing_spline

import ccdiff_env
from ccdiff_env.bench.episode import drivable
from ccdiff_env.metrics import Motion

MOVES_MPS = 3.0
TIMINGS, CURVES = ("nominal", "recorded"), ("linear", "smooth")
SMOOTHINGS_S3 = (0.001, 0.003, 0.01, 0.03, 0.1)
TRACKS = 600  #: Tracks that are foretold, drawn from a fixed seed.


def motion_of(scenes):
    """Return a row of the first table."""
    found = defaultdict(list)
    for scene in scenes:
        tracks = scene.tracks()
        half = round(0.5 / scene.dt)
        for agent, kind in enumerate(scene.agent_types):
            there = np.flatnonzero(tracks["valid"][agent])
            if kind != "vehicle" or len(there) < 3 * half:
                continue
            position = tracks["position"][agent, there].astype(float)
            step = np.diff(position, axis=0)
            who = "ego" if scene.agent_ids[agent] == "ego" else "others"
            speed = np.linalg.norm(position[half:] - position[:-half], axis=1)[::half] / 0.5
            moving = (speed[1:] > MOVES_MPS) & (speed[:-1] > MOVES_MPS)
            found[f"{who} dv"] += list(np.diff(speed)[moving])
            fast = np.linalg.norm(step, axis=1) / scene.dt > MOVES_MPS
            along = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
            change = (np.diff(step, axis=0) * along[1:]).sum(axis=1) / scene.dt**2
            found[f"{who} acc"] += list(change[fast[1:]])
            found[f"{who} jerk"] += list((np.diff(change) / scene.dt)[fast[2:]])
            slope = (position[2:] - position[:-2]) / (2 * scene.dt)
            size = np.linalg.norm(slope, axis=1)
            off = np.linalg.norm(slope - tracks["velocity"][agent, there][1:-1], axis=1)
            found["disagrees"] += list((off > 0.1 * size)[size > MOVES_MPS])
        sizes = scene.sizes[:, :2]
        motion = Motion(
            tracks["position"], tracks["heading"], sizes, tracks["valid"], dt_s=scene.dt
        )
        contacts = motion.collisions().contacts
        found["contacts"].append(len({(i, j) for _, i, j in contacts.tolist()}))
        vehicles = np.array(scene.agent_types) == "vehicle"
        outside = motion.off_road(drivable(scene)).centroid
        found["off"] += list(outside[vehicles][tracks["valid"][vehicles]])
    rms = {name: float(np.sqrt(np.mean(np.square(found[name])))) for name in found}
    mean = {name: float(np.mean(found[name])) for name in ("disagrees", "contacts", "off")}
    spread = [float(np.std(found[f"{who} dv"])) for who in ("ego", "others")]
    columns = [
        *spread,
        *(rms[f"{who} {what}"] for what in ("acc", "jerk") for who in ("ego", "others")),
    ]
    return [f"{v:.2f}" for v in columns] + [
        f"{100 * mean['disagrees']:.1f} %", f"{mean['contacts']:.2f}", f"{100 * mean['off']:.3f} %"
    ]  # fmt: skip


def tracks_of(folder):
    """Return times (s) and positions (m) at key frames of vehicle tracks, from the tables."""

    def table(name):
        return json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))

    times = {sample["token"]: sample["timestamp"] * 1e-6 for sample in table("sample")}
    vehicle = {c["token"] for c in table("category") if c["name"].startswith("vehicle")}
    wanted = {i["token"] for i in table("instance") if i["category_token"] in vehicle}
    tracks = defaultdict(list)
    for row in table("sample_annotation"):
        if row["instance_token"] in wanted:
            tracks[row["instance_token"]].append(
                (times[row["sample_token"]], *row["translation"][:2])
            )
    arrays = [np.array(sorted(track)) for track in tracks.values() if len(track) >= 8]
    moved = [a for a in arrays if np.linalg.norm(a[-1, 1:] - a[0, 1:]) > 10]
    chosen = np.random.default_rng(0).permutation(len(moved))[:TRACKS]
    return [moved[i] - [moved[i][0, 0], *moved[i][0, 1:]] for i in chosen]


def curves():
    """Return the curves by name: functions of times, values and the times that are asked for."""

    def line(t, x, at):
        return np.stack([np.interp(at, t, x[:, axis]) for axis in (0, 1)], axis=1)

    def smoothed(smoothing_s3):
        return lambda t, x, at: make_smoothing_spline(t, x, lam=smoothing_s3)(at)

    named = {"straight lines": line}
    named["cubic spline"] = lambda t, x, at: CubicSpline(t, x, bc_type="natural")(at)
    named |= {f"smoothing spline, {s} s³": smoothed(s) for s in SMOOTHINGS_S3}
    return named


def foretold(tracks, curve, nominal):
    """Return the rms error of key frames left out, and the 99th percentile of the distance."""
    errors, distances = [], []
    for track in tracks:
        t = np.round(track[:, 0] / 0.5) * 0.5 if nominal else track[:, 0]
        if (np.diff(t) <= 0).any():
            continue
        x = track[:, 1:]
        for i in range(2, len(t) - 2):
            rest = np.arange(len(t)) != i
            errors.append(np.linalg.norm(curve(t[rest], x[rest], t[i : i + 1])[0] - x[i]))
        distances += list(np.linalg.norm(curve(t, x, t) - x, axis=1))
    return np.sqrt(np.mean(np.square(errors))), np.percentile(distances, 99)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--dataroot", required=True, type=Path)
    parser.add_argument("--version", default="v1.0-trainval")
    parser.add_argument("--split", default="all")
    args = parser.parse_args()
    print("| key frames | curve | ego Δv | others Δv | ego acc. | others | ego jerk | others "
          "| velocity off | contacts | off the road |\n" + "|---|---|" + "---:|" * 9)  # fmt: skip
    for timing, curve in itertools.product(TIMINGS, CURVES):
        scenes = ccdiff_env.load_nuscenes(
            args.dataroot, args.version, args.split, timing=timing, interpolation=curve
        )
        print("|", " | ".join([timing, curve, *motion_of(scenes)]), "|", flush=True)
    tracks = tracks_of(args.dataroot / args.version)
    print(
        "\n| curve | left out, nominal | left out, recorded | stays within |\n|---|---:|---:|---:|"
    )
    for name, curve in curves().items():
        (before, _), (now, within) = foretold(tracks, curve, True), foretold(tracks, curve, False)
        print(f"| {name} | {before:.3f} m | {now:.3f} m | {within:.3f} m |", flush=True)


if __name__ == "__main__":
    main()
