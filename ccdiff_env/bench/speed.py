"""Seconds per plan against the number of vehicles.

Times depend on the machine and on what else it does; they are no part of a resumable run.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.models import TrajectoryModel, shipped_weights
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.system.files import write_aside
from ccdiff_env.system.table import Column, Table, TableRows, document

__all__ = ["Timing", "choose_moments", "fit", "measure_speed", "write_speed"]

#: Steps of the log at which scenes are looked at.
STEPS = (31, 56, 81, 106)
#: Kinds of plans: title, options of the model.
KINDS: Mapping[str, Mapping[str, Any]] = {
    "not guided": {},
    "guided": {"guidance": "rl"},
}


@dataclass(frozen=True)
class Timing:
    """Time of the plans of one scene at one step.

    Parameters
    ----------
    kind
        Kind of plan, see :data:`KINDS`.
    num_agents
        Vehicles that are planned for.
    seconds, processor_s
        Of the clock and of the processor, medians over rounds.
    """

    kind: str
    num_agents: int
    seconds: float
    processor_s: float


def choose_moments(scenes: Sequence[Scene], per_count: int = 2) -> list[tuple[Scene, int]]:
    """Return scenes and steps, some for every number of vehicles that there is."""
    found: dict[int, list[tuple[Scene, int]]] = {}
    for scene in scenes:
        vehicles = np.array(scene.agent_types) == "vehicle"
        there = scene.tracks()["valid"][vehicles]
        for step in (s for s in STEPS if s < scene.num_steps):
            count = int(there[:, step].sum())
            if count and len(found.setdefault(count, [])) < per_count:
                found[count].append((scene, step))
    return [moment for count in sorted(found) for moment in found[count]]


def measure_speed(
    scenes: SceneSet,
    *,
    rounds: int = 5,
    num_samples: int = 1,
    solver_steps: int = 5,
    device: str = "cpu",
) -> list[Timing]:
    """Time plans of single scenes with the shipped network on one thread.

    Parameters
    ----------
    scenes
        Where the moments are taken from, see :func:`choose_moments`.
    rounds
        Plans per moment and kind, after one that is not timed.
    num_samples, solver_steps
        Samples N per plan, evaluations of the network.
    device
        Where the network runs.
    """
    model = TrajectoryModel(shipped_weights(), device=device)
    found = []
    for scene, step in choose_moments(scenes):
        for kind, options in KINDS.items():
            settings = {"solver_steps": solver_steps, "num_samples": num_samples, **options}
            if "guidance" in options:
                settings["guided"] = [list(range(scene.num_agents))]
            agents = model.plan([scene], [step], **settings)[0].agents
            clock, busy = [], []
            for _ in range(rounds):
                start, work = time.perf_counter(), time.process_time()
                model.plan([scene], [step], **settings)
                clock.append(time.perf_counter() - start)
                busy.append(time.process_time() - work)
            found.append(Timing(kind, len(agents), float(np.median(clock)), float(np.median(busy))))
    return found


def fit(timings: Sequence[Timing], kind: str) -> tuple[float, float]:
    """Return seconds of the clock per plan, and per vehicle beside, by least squares."""
    points = [(t.num_agents, t.seconds) for t in timings if t.kind == kind]
    counts, seconds = np.array(points, np.float64).T
    if len(set(counts.tolist())) < 2:
        return float(seconds.mean()), 0.0
    slope, start = np.polyfit(counts, seconds, 1)
    return float(start), float(slope)


def write_speed(timings: Sequence[Timing], folder: Path) -> None:
    """Write ``speed.csv``, ``table.md`` and ``speed.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    raw: TableRows = [[t.kind, t.num_agents, t.seconds, t.processor_s] for t in timings]
    Table(["kind", "agents", "seconds", "processor_s"], raw).write_csv(folder / "speed.csv")
    kinds = list(dict.fromkeys(t.kind for t in timings))
    rows: TableRows = []
    for count in sorted({t.num_agents for t in timings}):
        seconds = [
            [t.seconds for t in timings if (t.kind, t.num_agents) == (kind, count)]
            for kind in kinds
        ]
        rows.append([count, *(float(np.mean(of)) if of else None for of in seconds)])
    columns = [Column(f"ms per plan, {kind}", digits=1, factor=1e3) for kind in kinds]
    fits = []
    for kind in kinds:
        start, slope = fit(timings, kind)
        fits.append(f"{kind}: {1e3 * start:.1f} ms + {1e3 * slope:.2f} ms per vehicle.")
    write_aside(folder / "table.md", document(Table(["vehicles", *columns], rows), "\n".join(fits)))
    _plot(timings, kinds, folder / "speed.png")


def _plot(timings: Sequence[Timing], kinds: Sequence[str], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.6), layout="constrained")
    for kind in kinds:
        part = [t for t in timings if t.kind == kind]
        counts = np.array([t.num_agents for t in part])
        (dots,) = axes.plot(counts, [1e3 * t.seconds for t in part], "o", label=kind, markersize=4)
        start, slope = fit(timings, kind)
        ends = np.array([counts.min(), counts.max()])
        axes.plot(ends, 1e3 * (start + slope * ends), "-", color=dots.get_color(), linewidth=1)
    axes.set_xlabel("vehicles")
    axes.set_ylabel("ms per plan")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=130)
    plt.close(figure)
