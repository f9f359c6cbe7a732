"""What is said of what happened follows the motion, measured here by polygons of shapely."""

import re
from dataclasses import replace

import numpy as np
import pytest
from shapely import Polygon
from shapely.affinity import rotate, translate
from shapely.ops import nearest_points
from view_rollouts import NUM_STEPS, planned_rollout

from ccdiff_env import EgoEnv
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.record.rollout import RolloutEvent
from ccdiff_env.view.contact import impact
from ccdiff_env.view.link import play_drive
from ccdiff_env.view.outcome import happenings, outcome

AT = 30  #: Step of the contacts that are made up.


def polygon(rollout, agent, step, share=0.0):
    """Box of an agent at a share of the way from a step to the next, turned as at the step."""
    x, y = rollout.scene.sizes[agent, :2] / 2
    box = Polygon([(x, y), (-x, y), (-x, -y), (x, -y)])
    box = rotate(box, float(rollout.heading[agent, step]), origin=(0, 0), use_radians=True)
    here, there = rollout.position[agent, step], rollout.position[agent, step + (share > 0.0)]
    return translate(box, *(here + share * (there - here)).astype(float))


def oracle(rollout, step, one, other):
    """Speeds that two bring to their contact along the shortest way between their boxes, just
    before these touch.
    """
    apart, touching = 0.0, 1.0  # shares of the step
    for _ in range(20):
        share = (apart + touching) / 2.0
        p, q = (polygon(rollout, i, step - 1, share) for i in (one, other))
        apart, touching = (share, touching) if p.distance(q) > 0.0 else (apart, share)
    p, q = nearest_points(*(polygon(rollout, i, step - 1, apart) for i in (one, other)))
    way = np.array([q.x - p.x, q.y - p.y])
    first, second = rollout.velocity[[one, other], step] @ way / np.linalg.norm(way)
    return first, -second


def met(places, headings, speeds, *, pair=(0, 1), fault=False, name="left-turn-00"):
    """A rollout in which two agents meet at step AT: centres [2, 2] there, and how they drive."""
    run, pair = planned_rollout(name), list(pair)
    tracks = {key: getattr(run, key).copy() for key in ("position", "heading", "velocity", "valid")}
    forwards = np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    velocity = np.array(speeds)[:, None] * forwards
    times = (np.arange(NUM_STEPS) - AT)[:, None] * run.dt_s
    tracks["position"][pair] = np.array(places)[:, None] + times * velocity[:, None]
    tracks["heading"][pair] = np.array(headings)[:, None]
    tracks["velocity"][pair] = velocity[:, None]
    tracks["valid"][pair] = True
    one, other = (run.agent_ids[i] for i in pair)
    events = (
        RolloutEvent(AT, one, other, "collision_front", fault),
        RolloutEvent(AT, other, one, "collision_side"),
    )
    return replace(run, events=events, **tracks)


def test_the_speeds_of_a_contact_are_those_along_the_shortest_way_between_the_boxes():
    rng = np.random.default_rng(3)
    compared = 0
    while compared < 40:
        places = np.stack([np.zeros(2), rng.uniform(-6.0, 6.0, 2)])
        run = met(places, rng.uniform(-3.2, 3.2, 2), rng.uniform(0.0, 14.0, 2))
        now, before = ([polygon(run, i, step) for i in (0, 1)] for step in (AT, AT - 1))
        if not now[0].intersects(now[1]) or before[0].intersects(before[1]):
            continue
        _, brought = impact(run, AT, 0, 1)
        assert brought == pytest.approx(oracle(run, AT, 0, 1), abs=0.02)
        _, turned_round = impact(run, AT, 1, 0)
        assert turned_round == pytest.approx(brought[::-1])
        compared += 1


@pytest.mark.parametrize(
    ("places", "headings", "speeds", "said"),
    [
        ([(0, 0), (4.4, 0)], (0, 0), (8, 3), "drove into 1 (car) at 3.0 s, 5.0 m/s"),
        ([(0, 0), (4.4, 0)], (0, np.pi), (0.1, 4), "hit in front by 1 (car) at 3.0 s, 4.1 m/s"),
        ([(0, 0), (-4.4, 0)], (0, 0), (0.4, 4), "hit from behind by 1 (car) at 3.0 s, 3.6 m/s"),
        ([(0, 0), (-4.4, 0)], (0, 0), (-2, 0), "backed into 1 (car) at 3.0 s, 2.0 m/s"),
        (
            [(0, 0), (0, 3.3)],
            (0, -np.pi / 2),
            (2, 6),
            "hit in the side by 1 (car) at 3.0 s, 6.0 m/s",
        ),
        ([(0, 0), (2.9, 0)], (0, np.pi / 2), (9, 6), "drove into 1 (car) at 3.0 s, 9.0 m/s"),
        ([(0, 0), (0, 1.97)], (0.1, 0), (10, 10), "brushed against 1 (car) at 3.0 s, 1.0 m/s"),
        ([(0, 0), (4.54, 0)], (0, np.pi), (0.1, 0.2), "met 1 (car) at 3.0 s, 0.3 m/s"),
    ],
)
@pytest.mark.parametrize(("fault", "turn"), [(False, 0.0), (True, 2.0)])
def test_who_brings_more_speed_is_who_drives_into_the_other(
    places, headings, speeds, said, fault, turn
):
    """However the scene lies, and whatever nuPlan's class is, which stands beside it."""
    c, s = np.cos(turn), np.sin(turn)
    placed = np.array(places) @ np.array([[c, s], [-s, c]])
    found = outcome(met(placed, np.array(headings) + turn, speeds, fault=fault))
    assert (found.tone, found.text) == ("bad", f"ego {said}")
    assert found.fault == ("at fault" if fault else "not at fault")
    assert found.line == f"ego {said} · {found.fault}"


@pytest.mark.parametrize(
    ("speed", "said"),
    [(8.0, "ego brushed against 1 (adult)"), (2.0, "ego hit in the side by 1 (adult)")],
)
def test_nobody_walks_into_a_car_that_drives(speed, said):
    places, headings = [(0, 0), (0, 1.15)], (0, -np.pi / 2)
    found = outcome(met(places, headings, (speed, 1.2), name="pedestrians-02"))
    assert found.text == f"{said} at 3.0 s, 1.2 m/s"


def test_an_accident_of_others_is_told_of_who_brings_more():
    for speeds, headings, said in (
        ((1, 5), (0, np.pi), "2 (car) drove into 1 (car), 6.0 m/s"),
        ((7, 1), (0, 0), "1 (car) drove into 2 (car), 6.0 m/s"),
    ):
        run = met([(0, 0), (4.9, 0)], headings, speeds, pair=(1, 2))
        (happening,) = happenings(run)
        assert (happening.told(), happening.lane, happening.fault) == (said, "guided", "")


@pytest.mark.parametrize(
    ("drive", "verb"),
    [
        ("scene=cut-in-04&traffic=ccdiff&criticality=1&drive=b10", "drove into 1 (car)"),
        ("scene=free-curve-00&traffic=ccdiff&criticality=1&drive=a13", "hit in front by 1 (car)"),
        ("scene=pedestrians-02&traffic=ccdiff&criticality=1&drive=b60", "drove into 1 (adult)"),
    ],
)
def test_the_words_on_a_drive_agree_with_its_motion(drive, verb):
    run = play_drive(f"#{drive}")
    (first,) = [h for h in happenings(run) if h.kind == "collision" and h.lane == "ego"]
    own, others = oracle(run, first.step, first.agent, first.partner)
    assert (first.role == "hits") == (own > others)
    found = re.fullmatch(r"ego (.*) at ([\d.]+) s, ([\d.]+) m/s", outcome(run).text)
    assert found[1] == verb
    assert float(found[2]) == pytest.approx(first.step * 0.1)
    assert float(found[3]) == pytest.approx(own + others, abs=0.1)


def test_who_is_removed_by_a_contact_has_had_it(scenes):
    """The verdict is that on an ego that stays; its speed is that before the contact."""
    options = {"driver": "constant_velocity", "on_off_road": "ignore", "terminate_at_goal": False}
    told = []
    for how in ("terminate", "remove"):
        env = EgoEnv(scenes=scenes, traffic="replay", on_collision=how, **options)
        for scene in range(len(scenes)):
            env.reset(seed=0, options={"scene": scene})
            recorder, done, hits = Recorder(env), False, 0.0
            while not done:
                *_, terminated, truncated, info = env.step(np.zeros(2, np.float32))
                recorder.step()
                done, hits = terminated or truncated, hits + info["collision"]
            run = recorder.rollout()
            assert bool(run.collisions("ego")) == (hits > 0)
            told.append((outcome(run).text.rpartition(",")[0], outcome(run).fault, bool(hits)))
    stays, removed = told[: len(scenes)], told[len(scenes) :]
    assert stays == removed
    assert sum(hit for *_, hit in removed) > 3


def test_an_accident_after_the_goal_decides():
    hit = met([(0, 0), (4.4, 0)], (0, 0), (8, 3))
    goal, late = RolloutEvent(13, "ego", None, "goal"), RolloutEvent(80, "ego", None, "time_limit")
    found = outcome(replace(hit, events=(goal, *hit.events, late)))
    said = "ego reached its goal at 1.3 s, then drove into 1 (car) at 3.0 s, 5.0 m/s"
    assert (found.tone, found.text, found.opening_s) == ("bad", said, pytest.approx(1.0))
    assert found.decided_s == pytest.approx(3.0)
    told = [h.told() for h in happenings(replace(hit, events=(goal, *hit.events, late)))]
    assert told == ["ego reached its goal", "ego drove into 1 (car), 5.0 m/s"]
    told = [h.told() for h in happenings(replace(hit, events=(*hit.events, late)))]
    assert told == ["ego drove into 1 (car), 5.0 m/s"], "who had an accident is not late"
    arrived = outcome(replace(hit, events=(goal, late)))
    assert (arrived.tone, arrived.text) == ("good", "ego reached its goal at 1.3 s")


@pytest.mark.parametrize(
    ("stops", "ahead_m", "tone", "text"),
    [
        (50, 3.0, "blocked", "ego blocked by 1 (car) for 3.0 s"),
        (50, 8.0, "plain", "ego late, 61 % of its way in 8.0 s"),
        (70, 3.0, "plain", "ego late, 61 % of its way in 8.0 s"),
        (99, 3.0, "plain", "ego on its way, 61 % in 8.0 s"),
    ],
)
def test_a_run_that_is_over_says_how_it_goes(stops, ahead_m, tone, text):
    """Three seconds behind a car, behind none, one second behind a car, driving."""
    found = outcome(behind_a_car(stops, ahead_m))
    assert (found.tone, found.text) == (tone, text)


def behind_a_car(stops=50, ahead_m=3.0):
    """A rollout whose ego drives at 5 m/s until a step, then waits so far behind agent 1."""
    run = planned_rollout()
    tracks = {key: getattr(run, key).copy() for key in ("position", "heading", "velocity", "valid")}
    driven = np.minimum(np.arange(NUM_STEPS), stops) * 0.5
    tracks["position"][:2] = 0.0
    tracks["position"][0, :, 0] = driven
    tracks["position"][1, :, 0] = driven[-1] + 4.549 + ahead_m
    tracks["heading"][:2] = tracks["velocity"][:2] = 0.0
    tracks["velocity"][0, :stops, 0] = 5.0
    tracks["valid"][:] = np.arange(len(run.valid))[:, None] < 2
    info = {"route_completion": np.linspace(0.0, 0.617, NUM_STEPS - 1, dtype=np.float32)}
    late = RolloutEvent(NUM_STEPS - 1, "ego", None, "time_limit")
    return replace(run, events=(late,), info=info, plans=(), **tracks)
