"""Methods against one another: paired differences."""

import numpy as np
import pytest

from ccdiff_env.bench.intervals import mean_interval, permutation_p
from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.traffic_report import (
    Condition,
    at_equal_scr,
    comparison,
    difference,
    plot_at_equal_scr,
    rankings,
    summarise,
)
from ccdiff_env.system.table import document

HISTOGRAM = np.full((3, 20), 0.05).tolist()


def episodes(collided, fde):
    """Scenes that collide or not, with a final displacement each."""
    return [
        {"scr": bool(hit), "scr_controlled": bool(hit), "orr": 0.0, "fde": metres,
         "comfort": HISTOGRAM, "comfort_end_bins": HISTOGRAM, "comfort_reference_impl": HISTOGRAM}
        for hit, metres in zip(collided, fde, strict=True)
    ]  # fmt: skip


LOG = episodes([False] * 40, np.zeros(40))


def test_differences_are_paired_over_scenes():
    rng = np.random.default_rng(1)
    hits, metres = rng.random(40) < 0.5, rng.normal(15.0, 8.0, 40)
    one, other = episodes(hits, metres + 2.0), episodes(hits, metres)
    # the same shift in every scene has no spread, however much scenes differ
    assert difference(one, other, LOG, "fde") == pytest.approx((2.0, 2.0, 2.0))
    _, low, high = mean_interval(other, "fde")
    assert high - low > 3.0
    # ten scenes of forty collide in one alone: the binomial interval of the difference
    more = hits.copy()
    more[np.flatnonzero(~hits)[:10]] = True
    value, low, high = difference(episodes(more, metres), other, LOG, "scr")
    spread = 1.96 * np.sqrt(0.25 * 0.75 / 40)
    assert value == pytest.approx(0.25)
    assert (low, high) == pytest.approx((0.25 - spread, 0.25 + spread), abs=0.05)


@pytest.mark.parametrize("unit", [1e-14, 1.0, 1e9])
def test_ties_of_signs_count_in_any_unit(unit):
    pairs = unit * np.array([0.84, -2.09, -0.48, 0.86, 0.13, *np.zeros(7)])
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 12), -1).reshape(-1, 12)
    exact = (np.abs(signs @ pairs) >= abs(pairs.sum()) - 1e-9 * unit).mean()
    assert permutation_p(pairs) == pytest.approx(exact, abs=0.02)


def test_the_page_holds_differences_to_ccdiff():
    hits = [True] * 20 + [False] * 20
    played = {
        Condition("replay", "0", 0.5): LOG,
        Condition("ctg", "5", 0.5): episodes([True] * 40, np.full(40, 9.0)),
        Condition("ccdiff_equal", "5", 0.5): episodes(hits, np.full(40, 8.0)),
        Condition("ccdiff", "5", 0.5): episodes(hits, np.full(40, 7.0)),
    }
    text = document(*comparison(played, summarise(played)))
    assert "### Less CCDiff, equal training" in text
    ctg = next(line for line in text.splitlines() if line.startswith("| CTG | 5 |"))
    assert "+0.50 [" in ctg
    assert "+1.00 [+1.00, +1.00]" in ctg
    # the front is CTG and CCDiff; CCDiff of equal training is a sixth of the scale from the latter
    assert "| CCDiff, equal training | 0.00 | 0.83 | 0.17 |" in text
    assert "| CTG | 1.00 | 0.67 | 0.00 |" in text
    assert comparison({}, {}) == ["One method alone."]


def test_at_equal_scr_figures_lie_between_two_criticalities(tmp_path):
    """Collisions and metres grow with the criticality, those of one method by half as much."""
    order = np.random.default_rng(2).permutation(40)
    played = {Condition("replay", "0", 0.5): LOG}
    for method, slope in (("ccdiff_equal", 10.0), ("ctg", 5.0)):
        for strength in (0.0, 0.5, 1.0):
            hits = np.isin(np.arange(40), order[: int(20 * strength)])
            rows = episodes(hits, np.full(40, slope * strength))
            played[Condition(f"{method}-{strength:g}", "5", 0.5)] = rows
    found = at_equal_scr(played, [0.125, 0.4, 0.9])
    names = [column.name for column in found.columns]
    at = [names.index(name) for name in ("at_scr", "method", "less", "fde")]
    figures = {tuple(row[i] for i in at[:3]): row[at[3]] for row in found.rows}
    # 20 of 40 scenes at criticality 1: no method reaches 0.9
    assert {scr for scr, *_ in figures} == {"0.125", "0.4"}
    # a quarter and four fifths of the way to criticality 1
    assert figures["0.125", "ccdiff_equal", ""][0] == pytest.approx(2.5)
    assert figures["0.4", "ctg", ""][0] == pytest.approx(4.0)
    value, low, high = figures["0.4", "ctg", "ccdiff_equal"]
    assert value == pytest.approx(-4.0)
    assert low < value < high
    drawn = plot_at_equal_scr(found, tmp_path / "matched").read_text(encoding="utf-8")
    for text in ("CTG", "CCDiff, equal training", "FDE, m", "CFD", "0.125", "0.400"):
        assert text in drawn
    assert plot_at_equal_scr(at_equal_scr(played, [0.9]), tmp_path / "none") is None


def test_rankings_are_compared_where_there_is_a_choice():
    """Chance hits a third of the 30 scenes of 4 movers, reach these and the 10 scenes of 2."""

    def played(hits, draws=1):
        rows = episodes(hits * draws, np.zeros(40 * draws))
        return [
            {
                **row,
                "scr_by_controlled": False,
                "scene": i % 40,
                "num_moving": 4 if i % 40 < 30 else 2,
            }
            for i, row in enumerate(rows)
        ]

    third, reached = [i % 3 == 0 for i in range(30)] + [False] * 10, [True] * 40
    found = rankings(
        {Condition("replay", "0", 0.5): played([False] * 40)}
        | {Condition("ccdiff_random", k, 0.5): played(third, draws=3) for k in "12"}
        | {Condition("ccdiff_reach", k, 0.5): played(reached) for k in "12"}
    )
    figures = {tuple(row[1:5]): row[5][0] for row in found.rows}
    # no scene has five movers; with two guided, those of two leave no choice
    want = {("1", 0.5, 2, 40): 30 / 40, ("2", 0.5, 3, 30): 20 / 30}
    assert figures == pytest.approx(want)


def test_a_guided_method_has_a_name_at_every_criticality():
    assert METHODS["ctg-0.3"].ccdiff == {**METHODS["ctg"].ccdiff, "criticality": 0.3}
    assert METHODS["ccdiff-2"].label == "CCDiff, criticality 2"
    assert "idm-0.5" not in METHODS
    assert "ccdiff-high" not in METHODS
