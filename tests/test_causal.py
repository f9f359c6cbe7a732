"""Measures and rankings against networkx, shapely and the released lists."""

import json
import os
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ccdiff_env.errors import CcdiffError, ConfigError, ShapeError, UnknownNameError
from ccdiff_env.metrics import causal


def released_ranker() -> Path | None:
    roots = [os.environ.get("CCDIFF_DATA"), Path(__file__).parents[1] / "../shared/data"]
    for root in roots:
        if root and (Path(root) / "../reference/ranker/released_top10.json").is_file():
            return Path(root) / "../reference/ranker"
    return None


def networkx_ranking(measure, threshold, min_size, top, top_k):
    """The released procedure word for word: list all cliques, sort by weight, count."""
    counts: dict[int, int] = {}
    for matrix in measure:
        g = nx.Graph()
        for i in range(len(matrix)):
            for j in range(i, len(matrix)):
                if matrix[i, j] > threshold or matrix[j, i] > threshold:
                    g.add_edge(i, j, weight=matrix[i, j] + matrix[j, i])
        cliques = [c for c in nx.enumerate_all_cliques(g) if len(c) >= min_size]
        cliques.sort(
            key=lambda c: (
                g.subgraph(c).size("weight") - sum(g[u][u]["weight"] for u in c if g.has_edge(u, u))
            ),
            reverse=True,
        )
        for clique in cliques[:top]:
            for agent in clique:
                counts[agent] = counts.get(agent, 0) + 1
    return sorted(counts, key=lambda a: -counts[a])[:top_k]


def cliques(measure, threshold=0.0, min_size=2, top=3, top_k=10):
    """Agents that take part in cliques of a measure without absent agents."""
    found = causal.rank(
        "cliques", top_k=top_k, valid=[True] * measure.shape[-1], ttc=measure,
        threshold=threshold, min_size=min_size, top_per_frame=top,
    )  # fmt: skip
    return found.agents[: found.num_named]


def test_released_lists_of_all_real_scenes_are_reproduced():
    folder = released_ranker()
    if folder is None:
        pytest.skip("../shared/reference/ranker is not there (nor beside CCDIFF_DATA)")
    lists = json.loads((folder / "released_top10.json").read_text())
    assert len(lists) == 8
    for scene, expected in lists.items():
        ttc = np.moveaxis(np.load(folder / f"{scene}.npz")["ttc"], -1, 0)
        assert cliques(ttc) == expected, scene
        script = networkx_ranking(ttc.astype(float), 0.5, 3, 3, 10)
        assert cliques(ttc, threshold=0.5, min_size=3) == script, scene


@st.composite
def measures(draw):
    """Often few levels, so that many cliques weigh the same; sums are exact in floating point."""
    m = draw(st.sampled_from([*range(1, 10)] * 3 + [11]))
    t = draw(st.integers(1, 3))
    levels = draw(st.sampled_from([1, 2, 8, 2**20]))
    density = draw(st.floats(0.05, 1.0))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.integers(1, levels + 1, (t, m, m)) / max(8, levels)
    values *= rng.random((t, m, m)) < density
    if draw(st.booleans()):
        values[:, np.arange(m), np.arange(m)] = 1.0
    return values


@settings(max_examples=300, deadline=None)
@given(measures(), st.sampled_from([0.0, 0.3]), st.integers(1, 4), st.integers(1, 5))
def test_rankings_are_those_of_listing_all_cliques_with_networkx(measure, threshold, min_size, top):
    got = cliques(measure, threshold, min_size, top, 10)
    assert got == networkx_ranking(measure, threshold, min_size, top, 10)


def test_a_search_that_is_cut_short_says_so():
    measure = np.random.default_rng(0).random((1, 40, 40))
    measure[0, :20] *= np.random.default_rng(1).random((20, 40)) < 0.5
    options = {"top_k": 3, "valid": [True] * 40, "ttc": measure}
    assert causal.rank("cliques", **options).exact
    assert not causal.rank("cliques", **options, node_limit=2).exact


def test_the_weights_of_absent_agents_do_not_count():
    measure = np.full((2, 4, 4), np.nan)
    measure[:, :2, :2] = 0.5
    found = causal.rank("cliques", top_k=4, valid=[True, True, False, False], ttc=measure)
    assert (found.agents, found.num_named) == ([0, 1], 2)
    assert cliques(np.zeros((0, 4, 4))) == []


CAR = [4.5, 2.0]


def test_agents_that_are_absent_or_have_no_position_meet_nobody():
    p = [[0, 0], [5, 0], [np.nan, 0]]
    got = causal.ttc(p, [0, 0, 0], [10, 0, 0], [CAR] * 3, [True, False, True])
    assert got[0, 0] == 1
    assert np.count_nonzero(got) == 1
    d = causal.distance(p, [True, True, True])
    assert d[0, 1] == 5
    assert np.isinf(d[2]).all()
    assert causal.distance(p, normalised=True)[0].tolist() == [1.0, 0.75, 0.0]


def greedy_reference(weights):
    w = np.maximum(weights, weights.T)
    np.fill_diagonal(w, 0)
    m = len(w)
    vertices = sorted((i for i in range(m) if w[i].any()), key=lambda i: (-w[i].sum(), i))
    cliques = {}
    for i in vertices:
        clique = [i]
        for j in vertices:
            if j != i and all(w[j, k] > 0 for k in clique):
                clique.append(j)
        cliques[i] = clique
    own = {i: w[np.ix_(c, c)].sum() / 2 for i, c in cliques.items()}
    return sorted(vertices, key=lambda i: (-len(cliques[i]), -own[i], i))


@settings(max_examples=150, deadline=None)
@given(measures())
def test_greedy_cliques_follow_the_algorithm(measure):
    valid = [True] * measure.shape[-1]
    found = causal.rank("greedy", top_k=99, valid=valid, weights=measure[0])
    assert found.agents[: found.num_named] == greedy_reference(measure[0])


def test_distance_ranking_counts_cliques_of_near_agents():
    position = np.array([[0, 0], [100, 0], [5, 0], [101, 0], [300, 0]])
    near = causal.distance(position, normalised=True)
    found = causal.rank("distance_cliques", top_k=10, valid=[True] * 5, distance=near)
    named = found.agents[: found.num_named]
    assert named == networkx_ranking(near[None].astype(float), 0, 2, 3, 10)
    assert set(named) == {0, 1, 2, 3}


def test_short_rankings_are_filled_by_contact_then_distance_then_index():
    ttc = np.zeros((4, 4))
    ttc[3, 2] = 0.9
    near = np.zeros((4, 4))
    near[1, 0] = 0.1
    ranking = causal.rank("listed", top_k=4, valid=[True] * 4, ttc=ttc, distance=near, agents=[1])
    assert ranking == causal.Ranking(agents=[1, 2, 3, 0], num_named=1, exact=True)
    assert causal.rank("first", top_k=2, valid=[False, True, True]).agents == [1, 2]
    assert causal.rank("scores", top_k=2, valid=[True] * 3, scores=[0.1, np.nan, 0.3]).agents == [
        2,
        0,
    ]
    shuffles = {
        tuple(causal.rank("random", top_k=3, valid=[True] * 3, seed=s).agents) for s in range(99)
    }
    assert len(shuffles) == 6


def test_bad_input_is_refused_with_the_offending_part():
    with pytest.raises(ShapeError, match="heading"):
        causal.ttc([[0, 0]], [0, 1], [0], [CAR])
    with pytest.raises(ConfigError, match=r"rank\.weights"):
        causal.rank("greedy", top_k=1, valid=[True])
    with pytest.raises(ConfigError, match=r"rank\.threshold"):
        cliques(np.zeros((1, 2, 2)), threshold=-1)
    with pytest.raises(ConfigError, match="normalised"):
        cliques(np.full((1, 2, 2), 20.0))
    with pytest.raises(ShapeError):
        cliques(np.zeros((1, 2, 3)))
    with pytest.raises(UnknownNameError, match="agent"):
        causal.rank("listed", top_k=1, valid=[True], agents=[1])
    assert issubclass(ShapeError, CcdiffError)
