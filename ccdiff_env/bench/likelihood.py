"""Realism as likelihood: how probable the log is under many samples of the same scene.

In the manner of the Waymo Open Sim Agents Challenge (Montali et al. 2023): each feature of each
vehicle has a histogram over samples and steps; the score of a scene is the geometric mean of what
the histograms give the logged values. Bins and horizon are ours, so that numbers compare with those
of this package only. The single figure weighs features as that challenge does.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.jobs import Job, chunk_jobs
from ccdiff_env.bench.methods import METHODS, on_device, resolved
from ccdiff_env.bench.scenes import scenes_of
from ccdiff_env.bench.traffic import (
    CHUNK,
    STATIONARY_MPS,
    Episode,
    episodes,
    kept_rollouts,
    off_road,
    window_of,
)
from ccdiff_env.errors import ConfigError
from ccdiff_env.metrics import Motion, causal
from ccdiff_env.planners.planning import overlap
from ccdiff_env.scenes.map_queries import road_distance
from ccdiff_env.system.files import file_name
from ccdiff_env.traffic import NETWORKS

F64 = npt.NDArray[np.float64]
STRIDE = 5  #: Steps between looks at other vehicles.
PSEUDO_COUNT = 0.1  #: What every bin counts before anything is seen.


@dataclass(frozen=True)
class Feature:
    """Histogram of a feature: equal bins, values outside count in the outermost ones."""

    low: float
    high: float
    num_bins: int

    def bins(self, values: F64) -> npt.NDArray[np.int64]:
        """Return the bins of values."""
        at = np.floor((values - self.low) / (self.high - self.low) * self.num_bins)
        found: npt.NDArray[np.int64] = np.clip(at, 0, self.num_bins - 1).astype(np.int64)
        return found


#: Where signs are, 0 lies within a bin: vehicles that stand have values about it.
_KINEMATIC = {
    "speed": Feature(0.0, 25.0, 25),
    "acceleration": Feature(-6.25, 6.25, 25),
    "yaw_rate": Feature(-0.625, 0.625, 25),
    "yaw_acceleration": Feature(-2.1, 2.1, 21),
}
#: Features by name; units of SI. ``_half_s``: of states every half second, which hold less noise.
FEATURES: dict[str, Feature] = {
    **_KINEMATIC,
    "gap": Feature(0.0, 40.0, 20),
    "ttc": Feature(0.0, 10.0, 10),
    "collision": Feature(0.0, 2.0, 2),
    "off_road": Feature(0.0, 2.0, 2),
    "edge": Feature(-5.0, 15.0, 20),
    **{f"{name}_half_s": feature for name, feature in _KINEMATIC.items()},
}
GROUPS: dict[str, tuple[str, ...]] = {
    "kinematic": tuple(_KINEMATIC),
    "kinematic_half_s": tuple(f"{name}_half_s" for name in _KINEMATIC),
    "interactive": ("gap", "ttc", "collision"),
    "map": ("off_road",),
}
#: Weights of the single figure: those of the challenge of 2025, its lights (0.05) left out.
WEIGHTS: dict[str, float] = {
    **dict.fromkeys(_KINEMATIC, 0.05),
    "gap": 0.10,
    "ttc": 0.10,
    "collision": 0.25,
    "off_road": 0.25,
    "edge": 0.05,
}
#: Times after the start at which the logged speed is ranked among the samples', s.
RANK_SECONDS = (1, 3, 5, 10)
RANK_BINS = 5
DENSITIES = {"speed": "speed, m/s", "gap": "gap to the nearest vehicle, m"}  #: Drawn, by feature.


def motion_features(
    position: npt.NDArray[Any], heading: npt.NDArray[Any], valid: npt.NDArray[np.bool_], dt_s: float
) -> dict[str, F64]:
    """Return speed, its change, yaw rate and its change [A, T] by central differences.

    NaN where a neighbouring step is missing. ``position`` is [A, T, 2], m, ``heading`` [A, T], rad.
    """
    x = np.where(valid[..., None], position, np.nan).astype(np.float64)
    yaw = np.where(valid, heading, np.nan).astype(np.float64)

    def central(values: F64) -> F64:
        found = np.full_like(values, np.nan)
        found[:, 1:-1] = values[:, 2:] - values[:, :-2]
        return found / (2.0 * dt_s)

    speed = np.linalg.norm(central(x), axis=-1)
    turn = np.full_like(yaw, np.nan)
    turn[:, 1:-1] = np.angle(np.exp(1j * (yaw[:, 2:] - yaw[:, :-2]))) / (2.0 * dt_s)
    return {
        "speed": speed,
        "acceleration": central(speed),
        "yaw_rate": turn,
        "yaw_acceleration": central(turn),
    }


def box_gaps(position: npt.NDArray[Any], heading: npt.NDArray[Any], sizes: npt.NDArray[Any]) -> F64:
    """Return the distances [A, A] of oriented boxes, m; 0 where they overlap, inf on the diagonal.

    ``position`` and ``sizes`` are [A, 2], m, ``heading`` [A], rad.
    """
    position, heading, sizes = (np.asarray(a, np.float64) for a in (position, heading, sizes))
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    half = 0.5 * sizes
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], np.float64)
    corners = (
        position[:, None]
        + signs[None, :, :1] * half[:, None, :1] * ahead[:, None]
        + signs[None, :, 1:] * half[:, None, 1:] * left[:, None]
    )
    # corners of i in the frame of j: apart by how much they are outside of its box
    offset = corners[:, None] - position[None, :, None]
    along = np.abs((offset * ahead[None, :, None]).sum(-1)) - half[None, :, None, 0]
    beside = np.abs((offset * left[None, :, None]).sum(-1)) - half[None, :, None, 1]
    outside = np.hypot(np.maximum(along, 0.0), np.maximum(beside, 0.0)).min(axis=-1)
    gaps = np.minimum(outside, outside.T)
    boxes = np.concatenate([position, heading[:, None], sizes], axis=1)
    gaps[overlap(boxes[:, None], boxes[None])] = 0.0
    np.fill_diagonal(gaps, np.inf)
    return np.asarray(gaps, np.float64)


def _features(episode: Episode, motion: Motion) -> dict[str, F64]:
    """Features of the vehicles of an episode: [A, T'] or, of the whole episode, [A, 1]."""
    position, heading = motion.position, motion.heading
    valid, dt_s, heights = motion.valid, episode.scene.dt, motion.elevation_m
    found = motion_features(position, heading, valid, dt_s)
    coarse = motion_features(
        position[:, ::STRIDE], heading[:, ::STRIDE], valid[:, ::STRIDE], STRIDE * dt_s
    )
    found |= {f"{name}_half_s": values for name, values in coarse.items()}
    sizes = episode.scene.sizes[episode.agents][:, :2]
    # speeds are known from the second step to the last but one
    looks = np.arange(STRIDE, valid.shape[1] - 1, STRIDE)
    there = valid[:, looks] & np.isfinite(found["speed"][:, looks])
    found["gap"] = np.full(there.shape, np.nan)
    for k, step in enumerate(looks):
        some = np.flatnonzero(there[:, k])
        if len(some) > 1:
            at, yaw = position[some, step], heading[some, step]
            gaps = box_gaps(at, yaw, sizes[some])
            if heights is not None:
                gaps[causal.apart(heights[some, step])] = np.inf
            found["gap"][some, k] = gaps.min(axis=1)
    seconds = causal.ttc(
        position[:, looks].swapaxes(0, 1),
        heading[:, looks].T,
        np.nan_to_num(found["speed"][:, looks]).T,
        sizes,
        there.T,
        elevation_m=None if heights is None else heights[:, looks].T,
        normalised=False,
    )
    seconds[:, np.arange(len(sizes)), np.arange(len(sizes))] = np.inf
    found["ttc"] = np.where(there, seconds.min(axis=2, initial=np.inf).T, np.nan)
    found["ttc"] = np.minimum(found["ttc"], FEATURES["ttc"].high)
    hits = motion.collisions().agents["all"]
    road = off_road(episode.scene, motion)
    present = valid.any(axis=1)
    found["collision"] = np.where(present, hits, np.nan)[:, None]
    left = np.nan if road is None else road.box.any(axis=1)
    found["off_road"] = np.where(present, left, np.nan)[:, None]
    found["edge"] = np.full(there.shape, np.nan)
    if road is not None:
        at = np.asarray(position[:, looks][there], np.float32)
        level = None if heights is None else heights[:, looks][there]
        found["edge"][there] = road_distance(episode.scene, at, elevation_m=level)
    return found


def ranks(samples: Sequence[F64], log: F64) -> F64:
    """Return where logged values [N] lie among the samples [N]: how many in each part [RANK_BINS].

    A calibrated model has equal masses. Equal values share the places that they take. A value
    counts where all samples are finite.
    """
    drawn = np.stack(samples)
    known = np.isfinite(log) & np.isfinite(drawn).all(axis=0)
    drawn, log = drawn[:, known], log[known]
    places = len(drawn) + 1
    low = (drawn < log).sum(axis=0) / places
    high = ((drawn <= log).sum(axis=0) + 1) / places
    edges = np.linspace(0.0, 1.0, RANK_BINS + 1)
    below = np.clip((edges[:, None] - low) / (high - low), 0.0, 1.0)
    masses: F64 = np.diff(below, axis=0).sum(axis=1)
    return masses


def _score(
    samples: Sequence[dict[str, F64]], log: dict[str, F64], weight: float
) -> dict[str, float]:
    """Likelihoods of a log by feature and group, and the single figure."""
    found = {
        name: likelihood(feature, [s[name] for s in samples], log[name], weight)
        for name, feature in FEATURES.items()
    }
    for group, names in GROUPS.items():
        values = [found[name] for name in names if np.isfinite(found[name])]
        found[group] = float(np.mean(values)) if values else np.nan
    known = [name for name in WEIGHTS if np.isfinite(found[name])]
    found["realism"] = (
        float(np.average([found[n] for n in known], weights=[WEIGHTS[n] for n in known]))
        if known
        else np.nan
    )
    return found


def likelihood(feature: Feature, samples: Sequence[F64], log: F64, weight: float = 1.0) -> float:
    """Return the geometric mean of what histograms of the samples give the logged values.

    Samples and log are [A, T]; values that are not finite do not count. Each sample counts
    ``weight`` times. NaN where nothing can be compared.
    """
    stacked = np.concatenate(samples, axis=1)
    logs: list[F64] = []
    for values, logged in zip(stacked, log, strict=True):
        seen, asked = values[np.isfinite(values)], logged[np.isfinite(logged)]
        if not len(seen) or not len(asked):
            continue
        counts = weight * np.bincount(feature.bins(seen), minlength=feature.num_bins)
        shares = (counts + PSEUDO_COUNT) / (counts.sum() + PSEUDO_COUNT * feature.num_bins)
        logs.append(np.log(shares[feature.bins(asked)]))
    return float(np.exp(np.concatenate(logs).mean())) if logs else float("nan")


def scene_likelihoods(played: Sequence[Episode], num_samples: int) -> dict[str, Any]:
    """Return the likelihoods of a scene's log, and what else is said of its samples.

    ``realism``, features and groups; ``own_`` before ``realism`` and ``kinematic``: the same where
    each sample stands for the log in turn and the others are the samples; displacements; ``scr``
    and ``orr``: share of the samples with a contact, of vehicle steps off the road;
    ``ranks_1s`` and so on: see :func:`ranks`, of the speeds of vehicles that moved at the start;
    ``speed_shares``, ``log_gap_shares`` and so on: shares of the bins of :data:`FEATURES`.

    Args:
        played: Episodes of the scene, samples of one method. A method without chance gives one.
        num_samples: As many as it stands for.
    """
    first = played[0]
    log = _features(first, first.log)
    samples = [_features(e, e.motion) for e in played]
    found: dict[str, Any] = _score(samples, log, num_samples / len(played))
    own = [
        _score([*samples[:k], *samples[k + 1 :]], samples[k], num_samples / (len(played) - 1))
        for k in range(len(played) if len(played) > 1 else 0)
    ]
    for name in ("realism", "kinematic"):
        values = [o[name] for o in own if np.isfinite(o[name])]
        found[f"own_{name}"] = float(np.mean(values)) if values else np.nan
    errors = np.stack([e.motion.displacement(e.log).ade for e in played])
    known = np.isfinite(errors).all(axis=0)
    found["ade_m"] = float(errors[:, known].mean()) if known.any() else np.nan
    found["min_ade_m"] = float(errors[:, known].mean(axis=1).min()) if known.any() else np.nan
    hits = [e.motion.collisions().any("all") for e in played]
    found["scr"] = float(np.mean(hits))
    roads = [off_road(e.scene, e.motion) for e in played]
    found["orr"] = float(np.mean([np.nan if r is None else r.centroid_rate for r in roads]))
    numbers = {n: v if v is not None and np.isfinite(v) else None for n, v in found.items()}
    for name in DENSITIES:
        for whose, of in (("", samples), ("log_", [log])):
            values = np.concatenate([one[name].ravel() for one in of])
            bins = FEATURES[name].bins(values[np.isfinite(values)])
            counts = np.bincount(bins, minlength=FEATURES[name].num_bins)
            numbers[f"{whose}{name}_shares"] = (counts / max(counts.sum(), 1)).tolist()
    moved = np.nan_to_num(log["speed"][:, 1]) > STATIONARY_MPS
    num_steps = log["speed"].shape[1]
    for seconds in RANK_SECONDS if len(played) > 1 else ():
        if (step := round(seconds / first.scene.dt)) > num_steps:
            break
        step = min(step, num_steps - 2)  # speeds are known up to the last step but one
        speeds = [s["speed"][moved, step] for s in samples]
        numbers[f"ranks_{seconds}s"] = ranks(speeds, log["speed"][moved, step]).tolist()
    return numbers


def likelihood_jobs(
    source: str,
    methods: Sequence[str],
    *,
    num_samples: int = 16,
    weights: Mapping[str, str] | None = None,
    seed: int = 0,
    keep: str | None = None,
) -> list[Job]:
    """Return the jobs: methods x chunks of the scenes, all vehicles driven by the method.

    Seeds of the ``num_samples`` episodes per scene follow one another from ``seed`` on.
    """
    if num_samples < 1:
        raise ConfigError(f"samples is {num_samples}, expected at least 1")
    window_of(source)
    for name in methods:
        METHODS[name]  # refuses a name that does not exist
    given: dict[str, Any] = {"num_samples": num_samples, "seed": seed}
    given |= {"weights": dict(weights)} if weights else {}
    given |= {"keep": keep} if keep is not None else {}
    function = f"{__name__}:evaluate"
    return [
        job
        for method in methods
        for job in chunk_jobs(file_name(method), function, source, CHUNK, method=method, **given)
    ]


def evaluate(
    *,
    source: str,
    names: Sequence[str],
    method: str,
    num_samples: int,
    seed: int,
    weights: Mapping[str, str] | None = None,
    keep: str | None = None,
    device: str = "cpu",
) -> list[dict[str, Any]]:
    """Play scenes several times: one dictionary per scene, see :func:`scene_likelihoods`.

    ``processor_s``: processor seconds of an episode, mean of the chunk; ``keep`` as for
    :func:`.kept_rollouts`.
    """
    METHODS.add(weights or {})
    chosen = on_device(resolved(METHODS[method].with_weights(weights or {})), device)
    # without a network there is no chance
    draws = chosen.driver in NETWORKS or ":" in chosen.driver
    count = num_samples if draws else 1
    scenes = scenes_of(source, names)
    start = time.process_time()
    played = [episodes(scenes, chosen, num_controlled=None, seed=seed + k) for k in range(count)]
    spent = (time.process_time() - start) / (count * len(scenes))
    rows: list[dict[str, Any]] = []
    for i, scene in enumerate(scenes):
        samples = [p[i] for p in played]
        row = {"scene": scene.name, **scene_likelihoods(samples, num_samples), "processor_s": spent}
        row |= kept_rollouts(keep, method, {seed + k: sample for k, sample in enumerate(samples)})
        rows.append(row)
    return rows
