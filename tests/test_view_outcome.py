"""What became of the ego, and what is worth a flag, in words."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from test_view import shown_events
from view_rollouts import NUM_STEPS, planned_rollout

from ccdiff_env.record.rollout import RolloutEvent
from ccdiff_env.scenes import with_tracks
from ccdiff_env.view import log_rollout
from ccdiff_env.view.outcome import outcome


def test_whoever_follows_the_log_into_what_stands_is_no_deed_of_traffic():
    run = planned_rollout()
    kinds, ids = run.scene.agent_types, run.agent_ids
    walker = next(i for i, kind in enumerate(kinds) if kind != "static" and i > 2)
    velocity = run.velocity.copy()
    event = RolloutEvent(20, ids[walker], ids[2], "collision_front")
    shown = shown_events(replace(run, velocity=velocity, events=(event,)))
    assert (shown[0]["kind"], shown[0]["lane"]) == ("collision", "guided")
    velocity[2, 19] = 0.0
    shown = shown_events(replace(run, velocity=velocity, events=(event,)))
    assert (shown[0]["kind"], shown[0]["lane"]) == ("overlap", "others")
    assert outcome(replace(run, velocity=velocity, events=(event,))).others == 0


def test_an_ego_that_waits_as_its_log_does_is_not_late():
    run = planned_rollout()
    tracks = {name: values.copy() for name, values in run.scene.tracks().items()}
    tracks["position"][0] = tracks["position"][0, :1]
    waiting = replace(
        run,
        scene=with_tracks(run.scene, tracks),
        position=np.concatenate([tracks["position"][:1, :NUM_STEPS], run.position[1:]]),
        events=(RolloutEvent(NUM_STEPS - 1, "ego", None, "time_limit"),),
    )
    assert outcome(waiting).text == "ego waited, as in its log"
    assert shown_events(waiting)[0]["text"] == "ego waited, as in its log"


def test_who_stands_does_not_drive_into_anybody():
    run = planned_rollout()
    velocity = run.velocity.copy()
    velocity[0, 29] = 0.0
    events = (RolloutEvent(30, "ego", run.agent_ids[1], "collision_front", False),)
    shown = shown_events(replace(run, velocity=velocity, events=events))
    said = r"ego had stopped and was hit in front by 1 \(\w+\), not at fault"
    assert re.fullmatch(said, shown[0]["text"])


@pytest.mark.parametrize(
    ("kinds", "tone", "text"),
    [
        ([(20, "goal")], "good", "ego reached its goal at 2.0 s"),
        ([(13, "off_road")], "bad", "ego left the road at 1.3 s"),
        ([(80, "time_limit")], "plain", "ego not at its goal in 8.0 s"),
        ([], "plain", "ego drove 8.0 s, hit nobody"),
        ([(13, "off_road"), (40, "goal")], "bad", "ego left the road at 1.3 s, reached its goal"),
        ([(13, "goal"), (40, "off_road")], "good", "ego reached its goal at 1.3 s"),
    ],
)
def test_the_outcome_says_what_became_of_the_ego(kinds, tone, text):
    events = tuple(RolloutEvent(step, "ego", None, kind) for step, kind in kinds)
    found = outcome(replace(planned_rollout(), events=events))
    assert (found.tone, found.text, found.others) == (tone, text, 0)


def test_a_collision_of_the_ego_is_told_apart_from_those_of_others():
    run = planned_rollout()
    ids = run.agent_ids
    events = (
        RolloutEvent(9, ids[1], ids[2], "collision_front"),
        RolloutEvent(9, ids[2], ids[1], "collision_rear"),
        RolloutEvent(50, "ego", ids[2], "collision_rear", False),
    )
    found = outcome(replace(run, events=events))
    assert re.fullmatch(r"ego hit from behind by 2 \(\w+\) at 5.0 s, not at fault", found.text)
    assert (found.tone, found.others, found.opening_s) == ("bad", 1, pytest.approx(3.0))
    assert found.line.endswith("others: 1 collision")
    assert outcome(log_rollout(run.scene)).text == "as recorded"
