"""Methods against one another: paired differences, and the order that the paper found."""

from __future__ import annotations

import numpy as np
import pytest

from ccdiff_env.bench.traffic_report import (
    PAPER,
    PAPER_COLUMNS,
    Condition,
    comparison,
    difference,
    paper_pairs,
    summarise,
)
from ccdiff_env.metrics import PAPER_BOUNDS, scores
from ccdiff_env.system.table import document

HISTOGRAM = np.full((3, 20), 0.05).tolist()
LOG = [{"comfort": HISTOGRAM, "comfort_reference_impl": HISTOGRAM} for _ in range(40)]


def figures(collided, fde, seed=0):
    """Figures of scenes that collide or not, with a final displacement each."""
    rows = [
        {
            "collision": {"all": bool(hit), "new": bool(hit), "controlled_new": bool(hit)},
            "collision_rate": {"new": 0.0}, "over_speed": False, "off_road": 0.0, "fde_m": metres,
            "comfort": HISTOGRAM, "comfort_reference_impl": HISTOGRAM,
        }
        for hit, metres in zip(collided, fde, strict=True)
    ]  # fmt: skip
    return summarise(rows, LOG, seed=seed)


def test_the_papers_scores_follow_from_its_figures():
    # tables 1 and 2 of the paper, CCDiff and STRIVE
    printed = {
        "ccdiff": (
            [0.33, 0.48, 0.44, 0.56, 0.67, 0.74, 0.33, 0.48, 0.67, 0.89, 0.78],
            [0.97, 0.94, 0.91, 0.88, 0.80, 0.76, 0.81, 0.74, 0.63, 0.54, 0.49],
        ),
        "strive": (
            [0.67, 0.67, 0.81, 0.81, 0.93, 0.85, 0.67, 0.37, 0.37, 0.30, 0.26],
            [0.49, 0.38, 0.29, 0.22, 0.19, 0.13, 0.49, 0.36, 0.17, 0.12, 0.22],
        ),
    }
    for method, (control, realism) in printed.items():
        cs, rs = scores(**PAPER[method], bounds=PAPER_BOUNDS)
        assert np.allclose(cs, control, atol=0.02)
        assert np.allclose(rs, realism, atol=0.01)
    assert all(
        len(values) == len(PAPER_COLUMNS) for row in PAPER.values() for values in row.values()
    )


def test_differences_are_paired_over_scenes():
    rng = np.random.default_rng(1)
    hits, metres = rng.random(40) < 0.5, rng.normal(15.0, 8.0, 40)
    one, other = figures(hits, metres + 2.0), figures(hits, metres)
    # the same shift in every scene has no spread, however much scenes differ
    assert difference(one, other, "fde") == pytest.approx((2.0, 2.0, 2.0))
    _, low, high = other.figure("fde")
    assert high - low > 3.0
    # ten scenes of forty collide in one alone: the binomial interval of the difference
    more = hits.copy()
    more[np.flatnonzero(~hits)[:10]] = True
    value, low, high = difference(figures(more, metres), figures(hits, metres), "scr")
    spread = 1.96 * np.sqrt(0.25 * 0.75 / 40)
    assert value == pytest.approx(0.25)
    assert (low, high) == pytest.approx((0.25 - spread, 0.25 + spread), abs=0.05)


def test_pairs_are_counted_in_the_papers_order():
    at = PAPER_COLUMNS.index((5, 5))
    names = list(PAPER)

    def table(sign):
        return {
            Condition(n, 5, 5): figures([False] * 40, 10.0 + sign * PAPER[n]["fde"][at] + jitter)
            for n in names
        }

    jitter = np.random.default_rng(0).normal(0, 0.01, 40)
    assert paper_pairs(table(1.0), (5, 5), "fde", "ccdiff") == (15, 15, 15, 15)
    assert paper_pairs(table(-1.0), (5, 5), "fde", "ccdiff") == (15, 0, 15, 0)
    # nobody collides: no pair is in anybody's order, and none is clear
    assert paper_pairs(table(1.0), (5, 5), "scr", "ccdiff") == (15, 0, 0, 0)


def test_the_page_holds_differences_to_ccdiff_and_the_papers_figures():
    hits = [True] * 20 + [False] * 20
    table = {
        Condition("replay", 0, 5): figures([False] * 40, np.zeros(40)),
        Condition("ctg", 5, 5): figures([True] * 40, np.full(40, 9.0)),
        Condition("ccdiff_equal", 5, 5): figures(hits, np.full(40, 8.0)),
        Condition("ccdiff", 5, 5): figures(hits, np.full(40, 7.0)),
    }
    text = document(*comparison(table))
    assert "### Less CCDiff, equal training" in text
    ctg = next(line for line in text.splitlines() if line.startswith("| CTG | 5 |"))
    assert "+0.50 [" in ctg
    assert "+1.00 [+1.00, +1.00]" in ctg
    assert "| CTG | 1.00, 0.42 | 0.00, 1.09 | 9.00, 7.40 |" in text
    assert "| CCDiff, equal training | 0.50, 0.46 |" in text
    assert comparison({}) == ["One method alone."]
