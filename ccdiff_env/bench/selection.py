"""Who is turned on the ego: learned choices beside rules, at an equal cost of guidance.

A rule pays for its collisions by the strength of the guidance, or by how often it acts. Its share
of scenes with a collision at a policy's shift is read off the line through its points. The test of
a policy is the difference of the two, paired over scenes, by the permutation of signs; that of all
policies is the same of their means. Gates of the closest approach are chosen on other scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import difference
from ccdiff_env.bench.plots import new_plot, save_plot
from ccdiff_env.envs.selection import AdversarySelectionVectorEnv, fork_actions, rule_actions
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.table import Column, Table, TableRows

__all__ = ["Choice", "gated", "play", "plot", "rivals", "table", "traffics"]

#: Figures by name, a number for each scene: means over seeds.
Figures = Mapping[str, Sequence[float]]
#: Strengths at which rules are measured; gates of the closest approach that are tried, metres.
RULE_STRENGTHS = (1.0, 2.0, 3.0, 4.0)
GATES_M = (3.0, 5.0, 7.0, 10.0, 15.0, 30.0)


class Choice(NamedTuple):
    """Somebody who chooses: the line that it belongs to, its point there, and how it chooses."""

    line: str
    point: str
    #: Returns what :meth:`AdversarySelectionVectorEnv.decide` takes.
    choose: Callable[[AdversarySelectionVectorEnv], Any]
    #: Options of the environment.
    options: Mapping[str, Any] = {}


def _rule(line: str, strength: float, gate_m: float = np.inf) -> Choice:
    def choose(env: AdversarySelectionVectorEnv) -> Any:
        seed = int(env.worlds.native.status(0).elapsed_steps)
        rule = line.partition(",")[0]
        return env.chosen(rule_actions(env, rule, gate_m=gate_m, seed=seed))

    point = f"{strength:g}" + (f" within {gate_m:g} m" if np.isfinite(gate_m) else "")
    return Choice(line, point, choose, {"strengths": (strength,)})


def traffics(line: str, point: str, criticality: float = 1.0, **ccdiff: Any) -> Choice:
    """Return the traffic's own choice, such as that of its ``adversary_policy``."""
    return Choice(line, point, lambda env: [(None, criticality)] * env.num_envs, {"ccdiff": ccdiff})


def rivals() -> list[Choice]:
    """Return the rules, each at its strengths; ``causal`` is the ranking of the paper."""
    found = [_rule("none", 1.0)]
    for name in ("random", "nearest", "ttc", "approach"):
        found += [_rule(name, strength) for strength in RULE_STRENGTHS]
    for c in RULE_STRENGTHS:
        found.append(traffics("causal", f"{c:g}", c, num_guided=1, ranking="cliques"))
    return found


def forks() -> Choice:
    """Return who tries every choice in copies of the worlds, and takes the weakest that hits."""
    return Choice("forks", "weakest of 1, 2, 4", lambda env: env.chosen(fork_actions(env)))


def gated(scenes: SceneSet, **options: Any) -> list[Choice]:
    """Return the closest approach with those gates and strengths that no mixture of others beats.

    ``scenes`` and ``options`` are those of :func:`play`; scenes that report are not among them.
    """
    tried = [_rule("approach, gated", c, gate_m) for gate_m in GATES_M for c in (2.0, 4.0)]
    found = [(_means(play(scenes, choice, **options)), choice) for choice in tried]
    hull: list[tuple[tuple[float, float], Choice]] = [((0.0, 0.0), _rule("none", 1.0))]
    for (shift, share), choice in sorted(found, key=lambda one: one[0]):
        while len(hull) > 1:
            (x, y), (before_x, before_y) = hull[-1][0], hull[-2][0]
            if (share - before_y) * (x - before_x) < (y - before_y) * (shift - before_x):
                break
            hull.pop()
        if share > hull[-1][0][1]:
            hull.append(((shift, share), choice))
    return [choice for _, choice in hull[1:]]


def play(
    scenes: SceneSet, choice: Choice, *, seeds: Sequence[int] = (0,), **options: Any
) -> dict[str, list[float]]:
    """Let somebody choose in every scene once for each seed.

    Parameters
    ----------
    scenes, choice, seeds
        The scenes, who chooses, and seeds of the episodes.
    **options
        Of the environment, such as ``ego="pdm"``.

    Returns
    -------
    dict
        The metrics of the environment, a number for each scene: means over the seeds.
    """
    both = {**options, **choice.options}
    both["ccdiff"] = {**options.get("ccdiff", {}), **choice.options.get("ccdiff", {})}
    env = AdversarySelectionVectorEnv(len(scenes), scenes=scenes, num_threads=1, **both)
    total: dict[str, npt.NDArray[np.float64]] = {}
    for seed in seeds:
        env.reset(seed=[seed] * len(scenes), options={"scene": list(range(len(scenes)))})
        while not env.ended.all():
            env.decide(choice.choose(env))
        for name, values in env.metrics().items():
            total[name] = total.get(name, 0.0) + values / len(seeds)
    return {name: values.tolist() for name, values in total.items()}


def _means(figures: Figures) -> tuple[float, float]:
    """Shift and share of scenes with a collision."""
    return float(np.mean(figures["mean_shift_sigmas"])), float(np.mean(figures["is_success"]))


def _interval(values: Sequence[float]) -> tuple[float, float, float]:
    return difference(np.asarray(values, np.float64))[0]


def at_shift(line: Iterable[Figures], shift: float) -> npt.NDArray[np.float64] | None:
    """Return collisions by scene of a line at a shift, between its points; ``None`` beyond them."""
    for one, other in pairwise(sorted(line, key=_means)):
        (low, _), (high, _) = _means(one), _means(other)
        if low <= shift <= high and high > low:
            share = (shift - low) / (high - low)
            below, above = np.array([one["is_success"], other["is_success"]])
            return np.asarray((1.0 - share) * below + share * above)
    return None


def table(played: Mapping[str, Mapping[str, Figures]]) -> list[Table]:
    """Return all choices, and those of the line ``learned`` less each rule at the same shift.

    Parameters
    ----------
    played
        What :func:`play` gave, by line and point.
    """
    heads = [
        Column("is_success", head="ego collides", unit="%", digits=1, factor=100.0),
        Column("ego_at_fault", head="at fault", unit="%", digits=1, factor=100.0, interval=False),
        Column("mean_shift_sigmas", head="shift, sigmas", interval=False),
        Column("mean_realism_cost", head="C(tau)", interval=False),
        Column("guided", head="guided plans", unit="%", digits=0, factor=100.0, interval=False),
    ]
    whole: TableRows = [
        [line, point, *(_interval(figures[head.name]) for head in heads)]
        for line, points in played.items()
        for point, figures in points.items()
    ]
    less: TableRows = []
    for rule in (line for line in played if line not in ("none", "learned")):
        line = [*played["none"].values(), *played[rule].values()]
        pairs, shares = [], []
        for point, figures in played["learned"].items():
            other = at_shift(line, _means(figures)[0])
            if other is None:
                less.append([point, rule, None, None, "beyond its strongest"])
                continue
            pairs.append(np.asarray(figures["is_success"]) - other)
            shares.append(float(other.mean()))
            figure, p = difference(pairs[-1])
            less.append([point, rule, shares[-1], figure, f"{p:.4f}"])
        if len(pairs) > 1:
            figure, p = difference(np.mean(pairs, axis=0))
            less.append(["all", rule, float(np.mean(shares)), figure, f"{p:.4f}"])
    shown = [
        Column("share", head="collides at that shift", unit="%", digits=1, factor=100.0),
        Column("difference", head="learned less it", digits=1, sign="+", factor=100.0),
    ]
    return [
        Table(["chooses", "at", *heads], whole),
        Table(["policy", "rule", *shown, "p"], less),
    ]


def plot(played: Mapping[str, Mapping[str, Figures]], path: Path, *, ego: str) -> None:
    """Draw collisions against shift: lines of the rules, the learned ones as points."""
    figure, axes = new_plot(7.0, 4.4)
    for line, points in played.items():
        found = sorted((_means(one)[0], *_interval(one["is_success"])) for one in points.values())
        x, share, low, high = np.array(found).T
        look: dict[str, Any] = {"fmt": "o-", "markersize": 4}
        if line == "learned":
            look = {"fmt": "*", "markersize": 11, "color": "#000000"}
        spread = 100.0 * np.array([share - low, high - share])
        axes.errorbar(x, 100.0 * share, yerr=spread, label=line, **look)
    axes.set_xlabel("shift of the guided plan, standard deviations, mean over plans")
    axes.set_ylabel(f"scenes in which the ego ({ego}) collides, %")
    axes.legend(frameon=False)
    save_plot(figure, path)
