"""Report of the realism benchmark: likelihoods of the log by group and feature, calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from ccdiff_env.bench.intervals import (
    FEW,
    are_few,
    brackets,
    difference,
    mean_interval,
    scene_means,
    significance,
)
from ccdiff_env.bench.likelihood import DENSITIES, FEATURES, GROUPS, RANK_BINS, RANK_SECONDS
from ccdiff_env.bench.methods import label_of
from ccdiff_env.bench.plots import plot_densities, plot_dots, plot_ranks
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.system.table import Block, Column, Table, TableRows

LEVEL: float = PROTOCOL.fields["statistics"]["level"]  #: p of a significant difference.
_LIKELIHOODS = ("realism", *GROUPS)  #: Likelihoods.
_PLAIN = (
    Column("own_realism", digits=3, interval=False),
    Column("own_kinematic", digits=3, interval=False),
    Column("ade_m", "ADE m"),
    Column("min_ade_m", "min ADE m"),
    Column("scr", "SCR"),
    Column("orr", "off road", "%", factor=100.0),
    Column("processor_s", "processor s", digits=3, interval=False),
)
COLUMNS = (
    *_LIKELIHOODS,
    *FEATURES,
    *(column.name for column in _PLAIN),
)  #: All figures of a method.


def tables(
    found: Mapping[str, Sequence[Mapping[str, Any]]], num_samples: int
) -> dict[str, list[Block]]:
    """Return the parts of the report from rows per scene of every method."""
    labels = _labels(found)

    def table(columns: Sequence[Column], title: str = "") -> Table:
        rows: TableRows = [
            [labels[method], *(mean_interval(of, column.name) for column in columns)]
            for method, of in found.items()
        ]
        return Table(["method", *columns], rows, title)

    note = (
        f"{brackets(found.values())} Of {num_samples} episodes per scene and method: figures from "
        "another number cannot be compared. "
        "Own: a sample in the place of the log, the ceiling of a calibrated model."
    )
    features = [_likelihood(name) for name in FEATURES]
    groups = table([*map(_likelihood, _LIKELIHOODS), *_PLAIN])
    both: list[Block] = [groups, note, table(features, "By feature")]
    return {
        "Likelihood of the log": both,
        "Calibration": _ranks({labels[method]: of for method, of in found.items()}),
    }


def plots(
    found: Mapping[str, Sequence[Mapping[str, Any]]], folder: Path
) -> tuple[Path | None, ...]:
    """Draw likelihoods against the log's, speeds and gaps over the log's, and the ranks of the
    logged speed among the samples.
    """
    labels = _labels(found)
    titles = {name: name.replace("_half_s", ", 0.5 s") for name in _LIKELIHOODS[:2]}
    titles["interactive"] = "interactive"
    scales = {
        name: (title, np.linspace(bins.low, bins.high, bins.num_bins + 1).tolist())
        for name, title in DENSITIES.items()
        for bins in [FEATURES[name]]
    }
    shares = {
        method: {name: _mean(of, f"{name}_shares") for name in DENSITIES}
        for method, of in found.items()
        if method != "replay"
    }
    log = {name: _mean(next(iter(found.values())), f"log_{name}_shares") for name in DENSITIES}
    ranks = {method: by for method, of in found.items() if (by := _shares(of))}
    return (
        plot_dots(found, labels, titles, folder / "realism"),
        plot_densities(shares, labels, scales, log, folder / "densities"),
        plot_ranks(ranks, labels, folder / "ranks"),
    )


def _labels(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, str]:
    return {method: label_of(method, of[0].get("own_weights", "")) for method, of in found.items()}


def _mean(of: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    """Mean over scenes of shares of bins."""
    return np.mean([row[name] for row in of], axis=0).tolist()  # type: ignore[no-any-return]


def _shares(of: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """Shares of the logged speed in each fifth of the samples', by moment; where known."""
    found = {}
    for seconds in RANK_SECONDS:
        masses = [row[f"ranks_{seconds}s"] for row in of if row.get(f"ranks_{seconds}s")]
        total = np.sum(masses, axis=0) if masses else np.zeros(RANK_BINS)
        if total.sum() > 0.0:
            found[f"after {seconds} s"] = (total / total.sum()).tolist()
    return found


def pairs_table(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Return the likelihoods of each two methods, paired by scene: their difference, and its p by
    the permutation test of signs.
    """
    rows: TableRows = []
    for (one, mine), (other, theirs) in permutations(found.items(), 2):
        for name in _LIKELIHOODS:
            both = scene_means(mine, name), scene_means(theirs, name)
            pairs = np.array([both[0][s] - both[1][s] for s in both[0] if s in both[1]])
            means = mean_interval(mine, name), mean_interval(theirs, name)
            rows.append([one, other, name, *means, *difference(pairs)])
    return Table(["method", "against", "figure", "value", "other", "difference", "p"], rows)


def comparison(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Block]:
    """Return paired differences in realism, of every method and the most realistic other one; the
    log is it where there is no other.
    """
    if len(found) < 2:
        return ["One method alone."]
    if any(map(are_few, found.values())):
        return [FEW]
    label = _labels(found)
    mean = {method: mean_interval(of, "realism")[0] for method, of in found.items()}
    order = sorted(found, key=lambda method: (method == "replay", -mean[method]))
    best = {m: next(other for other in order if other != m) for m in found}
    first, second, *_ = order
    rows: TableRows = []
    for one, other, figure, _, _, less, p in pairs_table(found).rows:
        # the two best are each other's
        if figure == "realism" and best[str(one)] == other and (one, other) != (second, first):
            said = significance(p, LEVEL) if isinstance(p, float) else ""
            rows.append([label[str(one)], label[str(other)], less, p, said])
    columns = (Column("difference", digits=3, sign="+"), Column("p", digits=4))
    return [
        "Realism, same scenes: 95 % intervals of the paired bootstrap over scenes, p of the "
        "permutation test of signs.",
        Table(["method", "against", *columns, "verdict"], rows),
    ]


def _likelihood(name: str) -> Column:
    return Column(name, name.replace("_half_s", ", 0.5 s").replace("_", " "), digits=3)


def _ranks(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Block]:
    """Where the logged speed lies among the samples; nothing without samples."""
    fifths = [f"{100 * k // RANK_BINS} to {100 * (k + 1) // RANK_BINS} %" for k in range(RANK_BINS)]
    rows: TableRows = []
    for label, of in found.items():
        for moment, shares in _shares(of).items():
            off = 100.0 * max(abs(share * RANK_BINS - 1.0) for share in shares)
            rows.append([label, moment.split()[1], *shares, off])
    head = "Rank of the logged speed among the samples': a calibrated model has 0.20 in each fifth."
    columns = [*map(Column, fifths), Column("rank-histogram error", unit="%", digits=0)]
    return [head, Table(["method", "after s", *columns], rows)] if rows else []
