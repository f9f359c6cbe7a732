"""Who is turned on the ego: learned choices beside rules, at an equal cost of guidance.

A rule pays for its collisions by the strength of the guidance, or by how often it acts. Its
share of scenes with a collision at another's shift is read off the line through its points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import mean_interval, permutation_p
from ccdiff_env.bench.plots import new_plot, save_plot
from ccdiff_env.envs.selection import AdversarySelectionVectorEnv, fork_actions, rule_actions
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.table import Column, Table, TableRows

__all__ = ["Choice", "learned", "play", "plot", "rivals", "table"]

F64 = npt.NDArray[np.float64]
Rows = Sequence[Mapping[str, Any]]
#: Steps of a fork: this decision and the next one.
FORK_STEPS = 40
#: Strengths at which rules are measured; gates of the closest approach, metres, the last one open.
RULE_STRENGTHS = (1.0, 2.0, 3.0, 4.0)
GATES_M = (5.0, 10.0, 15.0, 30.0)


class Choice(NamedTuple):
    """Somebody who chooses: the line that it belongs to, its point there, and how it chooses."""

    line: str
    point: str
    #: Returns agents and criticality of each world, see `AdversarySelectionVectorEnv.decide`.
    choose: Callable[[AdversarySelectionVectorEnv], Any]
    #: Options of CCDiff beside the environment's.
    ccdiff: Mapping[str, Any] = {}
    strengths: Sequence[float] = (1.0,)


def _rule(line: str, strength: float, gate_m: float | None = None) -> Choice:
    def choose(env: AdversarySelectionVectorEnv) -> Any:
        seed = int(env.worlds.native.status(0).elapsed_steps)
        return env.chosen(rule_actions(env, line, gate_m=gate_m, seed=seed))

    point = f"{strength:g}" + ("" if gate_m is None else f", within {gate_m:g} m")
    return Choice(line, point, choose, strengths=(strength,))


def _traffics(env: AdversarySelectionVectorEnv, criticality: float = 1.0) -> Any:
    """Leave the choice to the traffic."""
    return [(None, criticality)] * env.num_envs


def rivals(*, forks: bool = True) -> list[Choice]:
    """Return the rules: each at its strengths; ``forks`` needs an ego that worlds drive."""
    names = ("random", "nearest", "ttc", "approach")
    found = [_rule("none", 1.0)]
    found += [_rule(name, strength) for name in names for strength in RULE_STRENGTHS]
    gated = [_rule("approach", 4.0, gate_m) for gate_m in GATES_M]
    found += [choice._replace(line="approach, gated") for choice in gated]
    # the ranking of the traffic, as the paper's
    one = {"num_guided": 1, "ranking": "cliques"}
    for c in RULE_STRENGTHS:
        found.append(Choice("causal", f"{c:g}", partial(_traffics, criticality=c), one))
    if forks:

        def choose(env: AdversarySelectionVectorEnv) -> Any:
            return env.chosen(fork_actions(env, FORK_STEPS))

        found.append(Choice("forks", "weakest of 1, 2, 4", choose, strengths=(1.0, 2.0, 4.0)))
    return found


def learned(line: str, path: str | Path) -> Choice:
    """Return the choice of a policy by the file that the traffic reads."""
    options = {"adversary_policy": str(path)}
    return Choice(line, Path(path).stem, _traffics, options)


def play(
    scenes: SceneSet,
    choice: Choice,
    *,
    ego: str = "idm",
    seeds: Iterable[int] = (0,),
    **ccdiff: Any,
) -> list[dict[str, Any]]:
    """Let somebody choose in every scene once for each seed.

    Parameters
    ----------
    scenes
        The scenes.
    choice
        Who chooses.
    ego
        Who drives the ego.
    seeds
        Seeds of the episodes.
    **ccdiff
        Options of the traffic, such as ``denoising_steps=5``.

    Returns
    -------
    list of dict
        ``scene``, ``seed`` and the metrics of the environment, a row per scene and seed.
    """
    env = AdversarySelectionVectorEnv(
        len(scenes),
        scenes=scenes,
        ego=ego,
        strengths=choice.strengths,
        num_threads=1,
        ccdiff={**ccdiff, **choice.ccdiff},
    )
    rows = []
    for seed in seeds:
        env.reset(seed=[seed] * len(scenes), options={"scene": list(range(len(scenes)))})
        done = np.zeros(len(scenes), np.bool_)
        while not done.all():
            _, terminated, truncated = env.decide(choice.choose(env))
            done |= terminated | truncated
        rows += [
            {"scene": scene.name, "seed": seed, **env.metrics(e)} for e, scene in enumerate(scenes)
        ]
    return rows


def _by_scene(rows: Rows, name: str) -> F64:
    """Means over seeds of a figure, one number for each scene, in the order of the first rows."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    values: dict[str, list[float]] = {scene: [] for scene in scenes}
    for row in rows:
        values[row["scene"]].append(float(row[name]))
    return np.array([np.mean(values[scene]) for scene in scenes])


def at_shift(line: Sequence[Rows], shift: float) -> F64 | None:
    """Return collisions by scene of a line at a shift, between its points; ``None`` beyond them."""
    points = sorted(
        (float(_by_scene(rows, "mean_shift_sigmas").mean()), i) for i, rows in enumerate(line)
    )
    for (low, i), (high, j) in pairwise(points):
        if low <= shift <= high and high > low:
            share = (shift - low) / (high - low)
            below, above = (_by_scene(line[k], "is_success") for k in (i, j))
            return (1.0 - share) * below + share * above
    return None


def table(played: Mapping[tuple[str, str], Rows], policies: Iterable[str]) -> list[Table]:
    """Return all choices, and the learned ones less each rule at the same shift.

    Parameters
    ----------
    played
        Rows of :func:`play` by line and point.
    policies
        Lines that are learned.
    """
    learned_lines = list(policies)
    figures = [
        Column("is_success", head="ego collides", unit="%", digits=1, factor=100.0),
        Column("ego_at_fault", head="at fault", unit="%", digits=1, factor=100.0, interval=False),
        Column("mean_shift_sigmas", head="shift, sigmas", interval=False),
        Column("mean_realism_cost", head="C(tau)", interval=False),
        Column("guided", head="guided plans", unit="%", digits=0, factor=100.0, interval=False),
    ]
    whole: TableRows = [
        [*key, *(mean_interval(_scene_rows(rows, c.name), c.name) for c in figures)]
        for key, rows in played.items()
    ]
    less: TableRows = []
    none = next((rows for (line, _), rows in played.items() if line == "none"), [])
    for rule in dict.fromkeys(n for n, _ in played if n not in (*learned_lines, "none")):
        line = [found for (n, _), found in played.items() if n == rule]
        pairs, others = [], []
        for (name, point), rows in played.items():
            if name not in learned_lines:
                continue
            shift = float(_by_scene(rows, "mean_shift_sigmas").mean())
            other = at_shift([none, *line] if none else line, shift)
            if other is None:
                less.append([point, rule, None, None, "beyond its strongest"])
                continue
            pairs.append(_by_scene(rows, "is_success") - other)
            others.append(float(other.mean()))
            less.append([point, rule, others[-1], *_difference(pairs[-1])])
        if len(pairs) > 1:
            together = np.mean(pairs, axis=0)
            less.append(["all", rule, float(np.mean(others)), *_difference(together)])
    heads = [
        Column("share", head="collides at that shift", unit="%", digits=1, factor=100.0),
        Column("difference", head="learned less it", digits=1, sign="+", factor=100.0),
    ]
    return [
        Table(["chooses", "at", *figures], whole),
        Table(["policy", "rule", *heads, "p"], less),
    ]


def _difference(pairs: F64) -> tuple[tuple[float, float, float], str]:
    """A mean over scenes with its interval, and its p."""
    return mean_interval([{"x": float(d)} for d in pairs], "x"), f"{permutation_p(pairs):.4f}"


def _scene_rows(rows: Rows, name: str) -> list[dict[str, Any]]:
    return [{name: float(value)} for value in _by_scene(rows, name)]


def plot(
    played: Mapping[tuple[str, str], Rows], policies: Iterable[str], path: Path, *, ego: str
) -> None:
    """Draw collisions against shift: lines of the rules, the learned ones as points."""
    learned_lines = set(policies)
    figure, axes = new_plot(7.0, 4.4)
    lines: dict[str, list[tuple[float, tuple[float, float, float]]]] = {}
    for (line, _), rows in played.items():
        shift = float(_by_scene(rows, "mean_shift_sigmas").mean())
        share = mean_interval(_scene_rows(rows, "is_success"), "is_success")
        lines.setdefault(line, []).append((shift, share))
    for line, points in lines.items():
        points.sort(key=lambda point: point[0])
        x = [shift for shift, _ in points]
        y = [100.0 * share[0] for _, share in points]
        spread = 100.0 * np.array([[s[0] - s[1], s[2] - s[0]] for _, s in points]).T
        own = line in learned_lines
        look: dict[str, Any] = {"fmt": "o-", "markersize": 4}
        if own:
            look = {"fmt": "*", "markersize": 11, "color": "#000000"}
        axes.errorbar(x, y, yerr=spread, label=line, **look)
    axes.set_xlabel("shift of the guided plan, standard deviations, mean over plans")
    axes.set_ylabel(f"scenes in which the ego ({ego}) collides, %")
    axes.legend(frameon=False)
    save_plot(figure, path)
