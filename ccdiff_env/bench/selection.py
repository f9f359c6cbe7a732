"""Who is turned on the ego: learned choices beside rules, at an equal cost of guidance.

A rule pays for its collisions by the strength of the guidance, or by how often it acts. Its share
of scenes with a collision at a policy's move is read off the line through its points. The test of
a policy is the difference of the two, paired over scenes, by the permutation of signs; that of all
policies is the same of their means. Gates of the closest approach are chosen on other scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.bench.intervals import difference
from ccdiff_env.bench.plots import plot_lines
from ccdiff_env.envs.selection import FEATURES, SCALES, AdversarySelectionVectorEnv
from ccdiff_env.errors import unknown
from ccdiff_env.scenes import SceneSet
from ccdiff_env.system.table import Column, Table, TableRows

#: Figures by name, a number for each scene: means over seeds.
Figures = Mapping[str, Sequence[float]]
#: Rules that take the vehicle of the greatest value, and its column and sign: the nearest to the
#: ego, the soonest contact with it, and the closest approach in the coming 4 s at constant
#: velocity, the ego along its route. Others are nobody and chance.
RANKED = {"nearest": ("distance", -1.0), "ttc": ("ttc", 1.0), "approach": ("approach", -1.0)}
RULES = ("none", "random", *RANKED)
#: Strengths at which rules are measured; gates of the closest approach that are tried, metres.
RULE_STRENGTHS = (1.0, 2.0, 3.0, 4.0)
GATES_M = (3.0, 5.0, 7.0, 10.0, 15.0, 30.0)


def rule_actions(
    env: AdversarySelectionVectorEnv, rule: str, *, gate_m: float = np.inf, seed: int = 0
) -> npt.NDArray[np.int64]:
    """Return what one of :data:`RULES` chooses in each world [E], at the last of the strengths.

    Nobody where the closest approach of the vehicle found is farther than ``gate_m``, metres;
    ``seed`` is for ``"random"``. Another rule raises :class:`.ConfigError`.
    """
    if rule not in RULES:
        raise unknown("rule", rule, RULES)
    obs, there = env.obs, env.action_masks()[:, : -1 : len(env.strengths)]
    score: Any = np.random.default_rng(seed).random(there.shape)
    if rule in RANKED:
        column, sign = RANKED[rule]
        score = sign * obs[..., FEATURES.index(column)]
    rows = np.where(there, score, -np.inf).argmax(axis=1)
    approach = FEATURES.index("approach")
    near = obs[np.arange(len(obs)), rows, approach] * SCALES[approach] <= gate_m
    acts = there.any(axis=1) & near & (rule != "none")
    return np.where(acts, (rows + 1) * len(env.strengths) - 1, env.nobody)


class Choice(NamedTuple):
    """Somebody who chooses: the line that it belongs to, its point there, and how it chooses."""

    line: str
    point: str
    #: Returns what :meth:`AdversarySelectionVectorEnv.decide` takes.
    choose: Callable[[AdversarySelectionVectorEnv], Any]
    options: Mapping[str, Any] = {}  #: Options of the environment.


def _rule(rule: str, strength: float, gate_m: float = np.inf) -> Choice:
    def choose(env: AdversarySelectionVectorEnv) -> Any:
        seed = int(env.worlds.native.status(0).elapsed_steps)
        return env.chosen(rule_actions(env, rule, gate_m=gate_m, seed=seed))

    gate = ("", "") if gate_m == np.inf else (", gated", f" within {gate_m:g} m")
    return Choice(rule + gate[0], f"{strength:g}" + gate[1], choose, {"strengths": (strength,)})


def traffics(line: str, point: str, criticality: float = 1.0, **ccdiff: Any) -> Choice:
    """Return the traffic's own choice, such as that of its ``adversary_policy``."""
    return Choice(line, point, lambda env: [(None, criticality)] * env.num_envs, {"ccdiff": ccdiff})


def learned(model: Any, name: str) -> Choice:
    """Return the likeliest choice of a MaskablePPO of sb3-contrib."""

    def choose(env: AdversarySelectionVectorEnv) -> Any:
        masks = env.action_masks()
        return env.chosen(model.predict(env.obs, action_masks=masks, deterministic=True)[0])

    return Choice("learned", name, choose)


def rivals() -> list[Choice]:
    """Return the rules at their strengths, and the rankings of the paper and by reach."""
    found = [_rule("none", 1.0)]
    found += [_rule(rule, c) for rule in RULES[1:] for c in RULE_STRENGTHS]
    for line, ranking in (("causal", "cliques"), ("reach", "reach")):
        own = {"num_guided": 1, "ranking": ranking}
        found += [traffics(line, f"{c:g}", c, **own) for c in RULE_STRENGTHS]
    return found


def gated(scenes: SceneSet, **options: Any) -> list[Choice]:
    """Return the closest approach with those gates and strengths that no mixture of others beats.

    ``scenes`` and ``options`` are those of :func:`play`; scenes that report are not among them.
    """
    tried = [_rule("approach", c, gate_m) for gate_m in GATES_M for c in (2.0, 4.0)]
    points = [((0.0, 0.0), tried[0])]
    points += [(_means(play(scenes, choice, **options)), choice) for choice in tried]
    points.sort(key=lambda point: point[0])

    def mixed(moved_m: float) -> float:
        """The most of two others at a move."""
        pairs = combinations([at for at, _ in points if at[0] != moved_m], 2)
        found = [np.interp(moved_m, [x, u], [y, v]) for (x, y), (u, v) in pairs if x < moved_m]
        return float(max(found, default=0.0))

    return [choice for (moved_m, share), choice in points[1:] if share > mixed(moved_m)]


def play(
    scenes: SceneSet, choice: Choice, *, seeds: Sequence[int] = (0,), **options: Any
) -> dict[str, list[float]]:
    """Let somebody choose in every scene once for each seed.

    ``options`` are those of the environment, such as ``ego="pdm"``. Returns its metrics, a number
    for each scene: means over the seeds.
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
    """Metres moved and share of scenes with a collision."""
    return float(np.mean(figures["mean_moved_m"])), float(np.mean(figures["is_success"]))


def _interval(values: Sequence[float]) -> tuple[float, float, float]:
    return difference(np.asarray(values, np.float64))[0]


def at_move(line: Iterable[Figures], moved_m: float) -> npt.NDArray[np.float64] | None:
    """Return collisions by scene of a line at a move, between its points; ``None`` beyond them."""
    points = sorted(line, key=_means)
    at, hits = np.array([_means(one)[0] for one in points]), [one["is_success"] for one in points]
    if not at[0] <= moved_m <= at[-1]:
        return None
    return np.array([np.interp(moved_m, at, of) for of in np.transpose(hits)])


def table(played: Mapping[str, Mapping[str, Figures]]) -> list[Table]:
    """Return all choices, and those of the line ``learned`` less each rule at the same move.

    ``played`` is what :func:`play` gave, by line and point.
    """
    percent: dict[str, Any] = {"unit": "%", "digits": 1, "factor": 100.0}
    heads = [
        Column("is_success", "ego collides", **percent),
        Column("ego_at_fault", "at fault", interval=False, **percent),
        Column("mean_moved_m", "moved at 2 s, m", interval=False),
        Column("guided", "guided plans", interval=False, **{**percent, "digits": 0}),
    ]
    whole: TableRows = [
        [line, point, *(_interval(figures[head.name]) for head in heads)]
        for line, points in played.items()
        for point, figures in points.items()
    ]
    less: TableRows = []
    for rule in (line for line in played if line not in ("none", "learned")):
        pairs, shares = [], []
        for point, figures in played["learned"].items():
            line = [*played["none"].values(), *played[rule].values()]
            other = at_move(line, _means(figures)[0])
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
    shown = Column("share", "collides at that move", **percent)
    gain = Column("difference", "learned less it", digits=1, sign="+", factor=100.0)
    return [
        Table(["chooses", "at", *heads], whole),
        Table(["policy", "rule", shown, gain, "p"], less),
    ]


def plot(played: Mapping[str, Mapping[str, Figures]], path: Path, *, ego: str) -> None:
    """Draw collisions against moves: lines of the rules, the learned ones as points."""
    lines = {
        line: (line, 5.0, sorted((_means(of)[0], _share(of)) for of in points.values()))
        for line, points in played.items()
    }
    title = f"scenes in which the ego ({ego}) collides, %"
    plot_lines({title: lines}, "move of the guided plan at 2 s, m, mean over plans", path)


def _share(of: Figures) -> tuple[float, float, float]:
    share, low, high = (100.0 * value for value in _interval(of["is_success"]))
    return share, low, high
