"""Images and videos of rollouts: colours, names and marks against the rollout and the page."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from test_view import elements, unpacked
from view_rollouts import plan_of, planned_rollout

from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.view import page_html, render
from ccdiff_env.view.page import part
from ccdiff_env.view.video import Video


def test_images_have_the_ego_in_the_middle_in_its_colour():
    video = Video(planned_rollout(), size=(200, 200), span_m=40.0)
    assert tuple(video.frame(0)[100, 100]) == (0, 87, 184)
    assert sum(1 for _ in video.frames(every=20)) == 5


def test_images_and_pages_have_the_same_colours():
    map_names = {
        "ground": "ground", "road": "drivable area", "kerb": "kerb", "walkway": "walkway",
        "carpark": "car park", "stripe": "crossing", "stop": "stop area", "centre": "centre line",
        "laneDivider": "lane divider", "roadDivider": "road divider",
    }  # fmt: skip
    marks = {"collision": "collision", "arrow": "causal arrow"}
    for file, names in (("ground.js", map_names), ("actors.js", marks)):
        text = part(file)
        for theme in render.THEMES:
            block = re.search(rf"\b{theme}: {{(.*?)}}", text, re.DOTALL)[1]
            found = dict(re.findall(r'(\w+): "(#[0-9a-f]{6})"', block))
            for name, title in names.items():
                assert found[name] == "#{:02x}{:02x}{:02x}".format(*render.legend(theme)[title]), (
                    theme,
                    name,
                )


def test_an_image_says_whom_it_shows_and_what_colours_mean_unless_captions_are_off():
    run = planned_rollout()
    options = {"size": (400, 400), "span_m": 40.0}
    for theme in render.THEMES:
        plain = Video(run, captions=False, theme=theme, **options).frame(20)
        said = Video(run, theme=theme, **options).frame(20)
        legend = render.legend(theme)
        assert tuple(plain[200, 200]) == legend["ego"]
        # the legend: rows of the ego, the network, guided and logged ones, in the corner
        changed = (plain != said).any(-1)[-90:, -120:]
        corner = said[-90:, -120:][changed]
        for driver in ("ego", "ccdiff", "adversary", "replay"):
            assert (corner == legend[driver]).all(-1).any(), driver
        assert not (corner == legend["idm"]).all(-1).any()
        # names: something is written above the ego
        assert (plain != said).any(-1)[170:192, 185:215].any()


def test_a_collision_is_marked_half_way_between_those_that_met():
    run = planned_rollout()
    x, y = run.position[:2, 30].mean(axis=0).tolist()
    video = Video(run, size=(400, 400), span_m=40.0, centre_m=(x, y), captions=False)
    red = np.array(render.legend()["collision"])
    # a ring of three metres and six pixels: 36 pixels from the middle
    rows, columns = np.mgrid[:400, :400] - 199.5
    ring = np.abs(np.hypot(rows, columns) - 36.0) < 0.7
    share = [np.abs(video.frame(step).astype(int) - red).max(-1)[ring] < 40 for step in (29, 30)]
    assert share[0].mean() < 0.05
    assert share[1].mean() > 0.7


def test_arrows_lead_to_the_agent_in_the_middle_within_two_hops(monkeypatch):
    run = planned_rollout()
    graph = np.zeros((4, 4), bool)  # row i, column j: j influences i
    graph[0, 1] = graph[1, 2] = graph[2, 3] = graph[1, 0] = (
        True  # 3 to 2 to 1, 0 and 1 to each other
    )
    samples = np.zeros((1, 4, 5, 3), np.float32)
    plan = plan_of(0, [0, 1, 2, 3], samples[..., :2], graph=graph)
    seen = {}
    monkeypatch.setattr(render, "draw", lambda *_, **options: seen.update(options))
    for follow, expected in (
        (0, {(1, 0): 1.0, (2, 1): 0.4}),
        (1, {(0, 1): 1.0, (2, 1): 1.0, (3, 2): 0.4}),
        (3, {}),
    ):
        valid = np.ones_like(run.valid)
        planned = replace(run, plans=(plan,), valid=valid)
        Video(planned, follow=run.agent_ids[follow], graph=True).frame(0)
        assert {(j, i): weight for j, i, weight in seen["arrows"]} == expected


def test_between_two_steps_agents_are_between_their_poses(monkeypatch):
    run = planned_rollout()
    seen = {}
    monkeypatch.setattr(render, "draw", lambda at, **options: seen.update(options, at=at))
    Video(run).frame(20.25)
    there = run.valid[:, 20]
    both = there & run.valid[:, 21]
    expected = run.position[:, 20] + 0.25 * (run.position[:, 21] - run.position[:, 20])
    np.testing.assert_allclose(seen["at"][both[there]], expected[both], atol=1e-4)
    assert seen["caption"] == "left-turn-00  2.0 s"
    Video(run, title="other").frame(run.num_steps - 1)
    assert seen["caption"].startswith("other  8.0 s  ego drove into 1")


def test_an_ego_at_its_goal_is_drawn_where_it_left_the_scene(monkeypatch):
    run = planned_rollout()
    valid = run.valid.copy()
    valid[0, 40:] = False
    arrived = replace(run, valid=valid, events=(RolloutEvent(40, "ego", None, "goal"),))
    seen = {}
    monkeypatch.setattr(render, "draw", lambda at, **options: seen.update(at=at))
    Video(arrived).frame(40)
    np.testing.assert_allclose(seen["at"][0], run.position[0, 39])
    Video(replace(arrived, events=())).frame(40)
    assert len(seen["at"]) == valid[:, 40].sum()


def test_agents_that_are_absent_now_are_not_drawn(tmp_path):
    run = planned_rollout()
    valid = run.valid.copy()
    valid[1, 40:] = False
    gone = Rollout(**{f: getattr(run, f) for f in run.__dataclass_fields__} | {"valid": valid})
    _, arrays = unpacked(elements(page_html(gone))[0])
    assert arrays["valid"][1, 40:].max() == 0
    assert np.ptp(arrays["x"][1, 39:]) == 0.0
    video = Video(gone, follow=run.agent_ids[1], size=(200, 200), span_m=40.0)
    seen = [bool((video.frame(step) == (0, 158, 115)).all(-1)[100, 100]) for step in (39, 41)]
    assert seen == [True, False]
