"""Metrics against the paper's tables, shapely, scipy and plain numpy."""

import json
from pathlib import Path

import numpy as np
import pytest
from array_scenes import outline
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from shapely.geometry import Point, Polygon

from ccdiff_env import metrics
from ccdiff_env.errors import ConfigError, ShapeError, UnknownNameError
from ccdiff_env.metrics import Motion

PAPER = json.loads((Path(metrics.__file__).parents[1] / "data/paper_tables.json").read_text())
RAW = {name: np.array(PAPER[name]) for name in ("scr", "orr", "fde", "cfd")}


def test_every_score_of_the_papers_two_tables_follows_from_its_raw_table():
    cs, rs = metrics.scores(**RAW)
    printed_cs, printed_rs = np.array(PAPER["cs"]), np.array(PAPER["rs"])
    assert cs.shape == printed_cs.shape == (6, 11)
    # both tables print two digits
    np.testing.assert_allclose(cs, printed_cs, atol=0.0051)
    np.testing.assert_allclose(rs, printed_rs, atol=0.0051)
    for ours, again in zip(
        (cs, rs), metrics.scores(**RAW, bounds=metrics.PAPER_BOUNDS), strict=True
    ):
        np.testing.assert_allclose(ours, again, atol=1e-12)


def test_given_bounds_keep_scores_of_a_part_on_the_scale_of_the_whole():
    cs, rs = metrics.scores(**RAW)
    part = {name: table[1:2, :3] for name, table in RAW.items()}
    got = metrics.scores(**part, bounds=metrics.PAPER_BOUNDS)
    np.testing.assert_allclose(got[0], cs[1:2, :3])
    np.testing.assert_allclose(got[1], rs[1:2, :3])
    only_scr = metrics.scores(**part, bounds={"scr": (0.31, 0.58)})
    np.testing.assert_allclose(only_scr[0], cs[1:2, :3])
    assert not np.allclose(only_scr[1], rs[1:2, :3])


FIRST = [0.260, 0.336, 0.131, 0.261, 0.089, 0.020], [0.307, 0.327, 0.363, 0.430, 0.344, 0.290]
SECOND = [0.199, 0.138, 0.505, 0.317, 0.124, 0.086], [0.433, 0.370, 0.366, 0.348, 0.158, 0.122]


@pytest.mark.parametrize(("columns", "gd", "igd"), [(slice(0, 6), *FIRST), (slice(6, 11), *SECOND)])
def test_generational_distances_are_the_known_ones(columns, gd, igd):
    # the known values are those of the printed, rounded scores
    cs, rs = np.array(PAPER["cs"])[:, columns], np.array(PAPER["rs"])[:, columns]
    got = metrics.generational_distance(cs=cs, rs=rs)
    np.testing.assert_allclose(got[0], gd, atol=6e-4)
    np.testing.assert_allclose(got[1], igd, atol=6e-4)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 6))
def test_generational_distance_is_the_formula(seed, methods, columns):
    rng = np.random.default_rng(seed)
    cs, rs = rng.integers(0, 6, (2, methods, columns)) / 5
    points = np.stack([cs, rs], -1).reshape(-1, 2)
    beaten = ((points[:, None] <= points).all(-1) & (points[:, None] < points).any(-1)).any(1)
    front = points[~beaten]
    gd, igd = metrics.generational_distance(cs=cs, rs=rs)
    for m in range(methods):
        d = np.linalg.norm(np.stack([cs[m], rs[m]], -1)[:, None] - front, axis=-1)
        assert gd[m] == pytest.approx(np.sqrt((d.min(1) ** 2).mean()))
        assert igd[m] == pytest.approx(np.sqrt((d.min(0) ** 2).mean()))


def random_motion(seed, agents=6, steps=4, spread=7.0):
    rng = np.random.default_rng(seed)
    position = rng.uniform(-spread, spread, (agents, steps, 2))
    heading = rng.uniform(-4, 4, (agents, steps))
    size = rng.uniform([2, 1], [6, 3], (agents, 2))
    valid = rng.random((agents, steps)) < 0.8
    return position, heading, size, valid


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_contacts_are_those_of_shapely_and_variants_filter_them(seed):
    position, heading, size, valid = random_motion(seed)
    agents, steps = valid.shape
    rng = np.random.default_rng(seed)
    controlled = rng.random(agents) < 0.3
    log_position = position + rng.choice([0.0, 3.0], (agents, 1, 1))

    def touching(points):
        pairs = set()
        for t in range(steps):
            shapes = [outline(*points[a, t], heading[a, t], size[a]) for a in range(agents)]
            for a in range(agents):
                for b in range(a + 1, agents):
                    if valid[a, t] and valid[b, t] and shapes[a].intersects(shapes[b]):
                        pairs.add((t, a, b))
        return pairs

    want, in_log = touching(position), touching(log_position)
    log = Motion(log_position, heading, size, valid)
    got = Motion(position, heading, size, valid).collisions(controlled=controlled, log=log)
    assert [tuple(row) for row in got.contacts] == sorted(want)
    for row, is_controlled, is_new in zip(got.contacts, got.controlled, got.new, strict=True):
        t, a, b = row
        assert is_controlled == (controlled[a] or controlled[b])
        assert is_new == ((0, a, b) not in want and (t, a, b) not in in_log)
    kept = {
        "all": np.ones(len(want), bool),
        "controlled": got.controlled,
        "new": got.new,
        "controlled_new": got.controlled & got.new,
    }
    for variant, mask in kept.items():
        hit = np.zeros(agents, bool)
        hit[got.contacts[mask][:, 1:].ravel()] = True
        assert got.agents[variant].tolist() == hit.tolist()
        assert got.any(variant) == mask.any()
        assert got.agent_rate[variant] == pytest.approx(hit.sum() / valid.any(1).sum())


def test_who_comes_faster_at_the_first_contact_brings_it_about():
    """A car at 10 m/s runs into the rear of one at 4 m/s; a third one is touched from the start."""
    t = np.arange(0.0, 3.0, 0.1)
    x = np.stack([10.0 * t, 12.0 + 4.0 * t, np.full_like(t, 12.0)])
    y = np.stack([0.0 * t, 0.0 * t, np.full_like(t, 1.9)])
    motion = Motion(np.stack([x, y], axis=-1), np.zeros_like(x), [[4.0, 2.0]] * 3)
    for driven, brings in ((0, True), (1, False)):
        found = motion.collisions(controlled=np.arange(3) == driven)
        assert found.any("controlled_new")
        assert found.any("by_controlled") == brings
    at = np.flatnonzero((found.contacts[:, 1:] == (0, 1)).all(axis=1))[0]
    assert found.approach_mps[at] == pytest.approx([10.0, -4.0], abs=1e-3)
    # both driven: one of them it was
    assert motion.collisions(controlled=[True, True, False]).any("by_controlled")
    assert not motion.collisions(controlled=[False, False, True]).any("by_controlled")


def test_harsh_motion_is_beyond_nuplans_limits():
    t = np.arange(0.0, 5.05, 0.1)
    for acceleration, hard in ((2.2, 0.0), (2.6, 1.0), (-3.9, 0.0), (-4.3, 1.0)):
        x = 30.0 * t + 0.5 * acceleration * t * t
        motion = Motion(np.stack([x, 0 * x], axis=-1)[None], 0 * x[None], [[4.0, 2.0]])
        assert motion.harsh() == pytest.approx((hard, 0.0))
    # acceleration of 0 and 3 m/s2 in turns, every half second: ramps of three steps of 10 m/s3
    acceleration = np.where(np.arange(len(t)) // 5 % 2, 3.0, 0.0)
    x = np.cumsum(10.0 + np.cumsum(acceleration) * 0.1) * 0.1
    both = np.stack([np.stack([x, 0 * x], -1), np.stack([20 * t, 0 * t], -1)])
    motion = Motion(both, np.zeros((2, len(t))), [[4.0, 2.0]] * 2)
    speed = np.diff(x) / 0.1
    smooth = np.convolve(np.diff(speed) / 0.1, np.ones(3) / 3, "valid")
    jerk = np.diff(smooth) / 0.1
    want = ((smooth > 2.4).mean(), (np.abs(jerk) > 8.37).sum() / len(smooth))
    assert motion.harsh(counted=[True, False]) == pytest.approx(want, abs=0.05)
    assert motion.harsh(counted=[False, True]) == (0.0, 0.0)
    assert np.isnan(motion.harsh(counted=[False, False])).all()


def test_boxes_that_touch_or_hold_each_other_collide():
    position = np.array([[[0, 0]], [[4, 0]], [[50, 0]], [[50, 0]]], float)
    size = [[4, 2], [4, 2], [8, 4], [1, 1]]
    got = Motion(position, np.zeros((4, 1)), size).collisions()
    assert got.contacts.tolist() == [[0, 0, 1], [0, 2, 3]]
    assert not got.any("new")
    assert not got.any("controlled")


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_off_road_flags_are_those_of_shapely(seed):
    position, heading, size, valid = random_motion(seed, spread=14.0)
    outer = [(-12, -8), (11, -9), (13, 7), (0, 12), (-10, 6)]
    hole = [(-2, -2), (2, -2), (2, 2), (-2, 2)]
    other = [(20, 20), (9, 5), (9, 9)]
    area = Polygon(outer, [hole]).union(Polygon(other))
    got = Motion(position, heading, size, valid).off_road([(outer, [hole]), (other, [])])
    for a, t in np.argwhere(valid):
        shape = outline(*position[a, t], heading[a, t], size[a])
        centre, corners = Point(position[a, t]), [Point(c) for c in shape.exterior.coords]
        # points within 0.1 mm of the boundary count as on it
        if area.boundary.distance(centre) > 2e-4:
            assert got.centroid[a, t] != area.covers(centre)
        if min(map(area.boundary.distance, corners)) > 2e-4:
            assert got.box[a, t] != all(area.covers(c) for c in corners)
    assert not got.centroid[~valid].any()
    count = max(valid.sum(), 1)
    assert got.centroid_rate == pytest.approx(got.centroid.sum() / count)
    assert got.box_rate == pytest.approx(got.box.sum() / count)
    assert got.reference_impl_rate <= 1


def test_who_vanishes_between_plans_counts_as_off_the_road_as_released():
    # the centre leaves at the third step, a corner at the second; gone from the fourth on
    x = np.array([[5.0, 9.0, 11.0, 0.0, 0.0, 0.0], [5.0] * 6])
    motion = Motion(np.stack([x, 0 * x + 5], -1), 0 * x, [[4, 2]] * 2, x > 0)
    square = [([(0, 0), (10, 0), (10, 10), (0, 10)], [])]
    got = motion.off_road(square)
    rates = (got.centroid_rate, got.box_rate, got.reference_impl_rate)
    assert rates == (1 / 9, 2 / 9, 3 / 11)
    assert motion.off_road(square, counted=[False, True]).reference_impl_rate == 0


def test_displacement_is_over_steps_that_both_have():
    position, heading, size, valid = random_motion(5)
    other = position + np.array([3.0, 4.0]) * np.arange(4)[:, None]
    there = np.random.default_rng(1).random(valid.shape) < 0.7
    got = Motion(other, heading, size, there).displacement(Motion(position, heading, size, valid))
    for a in range(len(position)):
        common = np.flatnonzero(valid[a] & there[a])
        if len(common):
            assert got.ade[a] == pytest.approx(5 * common.mean(), abs=1e-4)
            assert got.fde[a] == pytest.approx(5 * common[-1], abs=1e-4)
        else:
            assert np.isnan(got.ade[a])
    ade, fde = got.mean([True] + [False] * 5)
    assert (ade, fde) == pytest.approx((got.ade[0], got.fde[0]), nan_ok=True)
    same = Motion(position, heading, size, valid)
    assert same.displacement(same).mean()[1] == 0


# Check values of the released evaluation: scene-normalised histograms of 100 logged scenes.
LOGGED = np.array(
    [
        [0.0116, 0.00962, 0.01362, 0.02134, 0.02514, 0.03192, 0.04719, 0.06093, 0.08046, 0.29474,
         0.1283, 0.06628, 0.04835, 0.04294, 0.02584, 0.02104, 0.01994, 0.01384, 0.00941, 0.0075],
        [0.00616, 0.00714, 0.01093, 0.0176, 0.02618, 0.03091, 0.0358, 0.05131, 0.0685, 0.27572,
         0.15541, 0.08467, 0.05819, 0.0453, 0.03352, 0.02382, 0.0189, 0.01243, 0.01222, 0.00531],
        [0.01695, 0.02061, 0.0229, 0.02448, 0.03121, 0.03411, 0.02834, 0.04064, 0.03286, 0.29861,
         0.09125, 0.05044, 0.05407, 0.04047, 0.03823, 0.03608, 0.03184, 0.02612, 0.03366, 0.02713],
    ]
)  # fmt: skip


def test_comfort_distances_are_the_known_ones():
    constant = np.zeros((3, 20))
    constant[:, 10] = 0.5
    got = metrics.comfort_distance(constant, LOGGED)
    # the printed histograms are rounded to 1e-5 per bin
    assert (got.longitudinal, got.lateral, got.jerk, got.cfd) == pytest.approx(
        (0.50170, 0.46815, 0.32323, 0.43103), abs=3e-5
    )
    uniform = metrics.comfort_distance(np.full((3, 20), 0.05), LOGGED)
    assert (uniform.longitudinal, uniform.lateral, uniform.jerk, uniform.cfd) == pytest.approx(
        (0.54179, 0.54828, 0.18916, 0.42641), abs=3e-5
    )
    assert metrics.comfort_distance(LOGGED[[1, 0, 2]], LOGGED).longitudinal == pytest.approx(
        0.06666, abs=1e-5
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_comfort_distance_is_scipys_earth_movers_distance(seed):
    one, other = np.random.default_rng(seed).random((2, 3, 20))
    got = metrics.comfort_distance(one, other)
    for k, (value, width) in enumerate(
        zip((got.longitudinal, got.lateral, got.jerk), (0.2, 0.2, 0.1), strict=True)
    ):
        bins = np.arange(20) * width
        assert value == pytest.approx(
            stats.wasserstein_distance(bins, bins, one[k], other[k]), rel=1e-5
        )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["body", "reference_impl"]), st.booleans())
def test_comfort_histograms_are_those_of_numpy(seed, axes, end_bins):
    rng = np.random.default_rng(seed)
    agents, steps = 4, 61
    acceleration = rng.normal(0, 0.6, (agents, steps, 2)).cumsum(1) * 0.05
    velocity = rng.normal(0, 3, (agents, 1, 2)) + acceleration.cumsum(1) * 0.1
    position = (velocity * 0.1).cumsum(1).astype(np.float32).astype(float)
    heading = rng.uniform(-3, 3, (agents, 1)) + rng.normal(0, 0.05, (agents, steps))
    heading = heading.astype(np.float32).astype(float)
    until = rng.integers(2, steps + 1, agents)
    valid = np.arange(steps) < until[:, None]
    counts = np.zeros((3, 20))
    for a in range(agents):
        p, h = position[a, : until[a] : 5], heading[a, : until[a] : 5]
        if len(p) < 2:
            continue
        v = np.diff(p, axis=0) / 0.5
        v = np.concatenate([v[:1], v])
        acc = np.diff(v, axis=0) / 0.5
        acc = np.concatenate([acc[:1], acc])
        size = np.linalg.norm(acc, axis=1)
        jerk = np.diff(size) / 0.5
        jerk = np.concatenate([jerk[:1], jerk])
        if np.linalg.norm(v[0]) <= 0.5:
            continue
        cos, sin = np.cos(h), np.sin(h)
        if axes == "body":
            rows = (acc[:, 0] * cos + acc[:, 1] * sin, -acc[:, 0] * sin + acc[:, 1] * cos, jerk)
        else:
            rows = (size * cos, size * sin, jerk)
        for k, (row, limit) in enumerate(zip(rows, (2, 2, 1), strict=True)):
            row = np.clip(row, -limit, limit) if end_bins else row
            counts[k] += np.histogram(row, 20, (-limit, limit))[0]
    total = counts.sum(1, keepdims=True)
    want = np.divide(counts, total, where=total > 0, out=np.zeros_like(counts))
    motion = Motion(position, heading, [[4.5, 2]] * agents, valid)
    got = motion.comfort(axes=axes, end_bins=end_bins)
    # a value within rounding of an edge may fall on either side
    np.testing.assert_allclose(got, want, atol=2.1 / max(total.min(), 1))
    assert np.abs(got - want).sum() < 0.2


def test_histograms_without_motion_are_infinitely_far():
    x = np.stack([np.arange(40.0), np.zeros(40)], -1)[None]
    moving = Motion(x, np.zeros((1, 40)), [[4, 2]]).comfort()
    still = Motion(np.zeros((1, 40, 2)), np.zeros((1, 40)), [[4, 2]]).comfort()
    assert metrics.comfort_distance(moving, moving).cfd == 0
    assert metrics.comfort_distance(still, moving).cfd == np.inf


def test_least_time_to_contact_is_that_of_the_causal_measures():
    from ccdiff_env.metrics import causal

    position, heading, size, _ = random_motion(3, agents=5, steps=1, spread=30)
    speed = np.random.default_rng(3).uniform(0, 10, (5, 1))
    step = 0.1 * speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    both = np.concatenate([position, position + step], 1)
    headings = np.repeat(heading, 2, 1)
    got = Motion(both, headings, size).min_ttc()
    seconds = causal.ttc(
        both.swapaxes(0, 1), headings.T, np.repeat(speed, 2, 1).T, size, normalised=False
    )
    seconds[:, np.arange(5), np.arange(5)] = 20
    np.testing.assert_allclose(got, seconds.min((0, 2)), atol=2e-2)


def test_over_speed_needs_half_a_second_without_a_break():
    def track(speeds):
        return np.stack([np.cumsum(speeds) * 0.1, np.zeros(len(speeds))], -1)

    slow, fast = [5.0] * 10, 20.0
    position = np.stack([track(slow + [fast] * 5 + slow), track(slow + [fast] * 4 + [5.0] + slow)])
    motion = Motion(position, np.zeros((2, 25)), [[4, 2]] * 2)
    assert motion.over_speed(15.0).tolist() == [True, False]
    assert motion.over_speed(15.0, counted=[False, True]).tolist() == [False, False]
    speeds = np.array([[0.0, 3.0, np.nan], [7.0, 9.5, 2.0]])
    assert metrics.speed_limit(speeds) == pytest.approx(np.quantile([3, 7, 9.5, 2], 0.75))
    assert np.isnan(metrics.speed_limit([0.2]))


def test_bad_input_is_refused_with_the_offending_part():
    one, two = (Motion(np.zeros((1, n, 2)), np.zeros((1, n)), [[4, 2]]) for n in (3, 4))
    raw = {"scr": [0.1], "orr": [0.1], "fde": [0.1], "cfd": [0.1]}
    for call, error, named in (
        (lambda: metrics.scores(**raw | {"cfd": [0.1, 0.2]}), ShapeError, "cfd"),
        (lambda: metrics.scores(**raw, bounds={"scrr": (0, 1)}), ConfigError, "scrr"),
        (lambda: metrics.scores(**raw, bounds={"scr": (1, 0)}), ConfigError, "bounds of scr"),
        (lambda: metrics.generational_distance(cs=[0.1], rs=[0.1]), ShapeError, None),
        (lambda: Motion(np.zeros((1, 3, 2)), np.zeros((1, 4)), [[4, 2]]), ShapeError, "heading"),
        (lambda: Motion(np.zeros((1, 3, 2)), [[0] * 3], [[4, 2]], dt_s=0), ConfigError, "dt_s"),
        (lambda: one.displacement(two), ShapeError, "log"),
        (lambda: one.collisions(controlled=[True, False]), ShapeError, "controlled"),
        (lambda: one.off_road([]), ShapeError, "drivable"),
        (lambda: one.comfort(axes="world"), UnknownNameError, "axes"),
        (lambda: one.comfort(stride=0), ConfigError, "stride"),
    ):
        with pytest.raises(error, match=named):
            call()


def test_any_byte_but_zero_is_true_in_masks():
    position = np.array([[[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.0], [9.0, 0.0]], [[50.0, 0.0]] * 2])
    bytes_, size = np.array([2, 0, 4], np.uint8), np.full((3, 2), 4.0)

    def figures(mask):
        valid = np.stack([mask, mask], axis=1)
        log = metrics.Motion(position + 1.0, np.zeros((3, 2)), size=size, dt_s=0.1, valid=valid)
        every = metrics.Motion(position, np.zeros((3, 2)), size=size, dt_s=0.1)
        area = [([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]], [])]
        return (
            log.valid.tolist(),
            every.collisions(controlled=mask).agent_rate,
            every.off_road(area, counted=mask).centroid_rate,
            every.displacement(every).mean(mask),
        )

    assert figures(bytes_.view(bool)) == figures(bytes_ != 0)
