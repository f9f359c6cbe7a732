"""What became of an episode: the ego's fate in one sentence, and the events that deserve a flag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.view.captions import agent_titles, guided_agents, is_collision, is_log, reach_m

Lane = Literal["ego", "guided", "others"]
Tone = Literal["bad", "good", "plain"]

STATIONARY_MPS = 0.1  #: Who is slower when boxes meet did not drive into anybody.
LEAD_S = 2.0  #: Replays open so long before what they open for.
ENDS = ("goal", "time_limit")
WAITED_M = 2.0  #: An ego that moves less than this, as its log does, waited.
#: What is said of collisions.
COLLISIONS = {
    "collision_front": "{one} {went} into {other}",
    "standing": "{one} hit in front by {other}",
    "collision_rear": "{one} hit from behind by {other}",
    "collision_side": "{one} hit in the side by {other}",
    "static": "{one} hit {other}",
}
#: What is said of those of the ego that are its fault, and of one in front that is not.
AT_FAULT = {
    "collision_front": "{one} drove into {other}",
    "collision_rear": "{one} backed into {other}",
    "collision_side": "{one} brushed against {other}",
    "static": "{one} hit {other}",
}
STOPPED = "{one} had stopped and was hit in front by {other}"
GOES = {"pedestrian": "walked", "cyclist": "rode", "motorcycle": "rode"}  #: How kinds of agents go.


@dataclass(frozen=True)
class Happening:
    """One thing that happened at a recorded step to an agent and a partner (indices, -1 for none).

    Both sides of a collision are one. ``lane`` says whose it is: the ego's, that of a guided
    vehicle, or that of the others. ``kind`` is ``"collision"``, ``"off_road"``, ``"goal"`` or
    ``"time_limit"``.
    """

    step: int
    agent: int
    partner: int
    lane: Lane
    kind: str
    text: str


@dataclass(frozen=True)
class Outcome:
    """What became of the ego in words, whether it is bad or good, and collisions of others alone.

    ``opening_s`` is a moment before what matters most, ``decided_s`` when it is known; both count
    from the start.
    """

    tone: Tone
    text: str
    others: int
    opening_s: float
    decided_s: float

    @property
    def mishap(self) -> str:
        """What befell the ego: it "is hit", "drives into somebody", "leaves the road", or ""."""
        if self.tone != "bad":
            return ""
        if "not at fault" in self.text:
            return "is hit"
        return "drives into somebody" if "at fault" in self.text else "leaves the road"

    @property
    def line(self) -> str:
        """The text, and the number of collisions among the others."""
        s = "s" * (self.others != 1)
        return f"{self.text} · others: {self.others} collision{s}" if self.others else self.text


def happenings(rollout: Rollout) -> list[Happening]:
    """Return what happened, by step.

    Left out: boxes of two that follow the log, and of one that does and another that stands;
    vehicles that leave the road unguided, since many do in their logs.
    """
    return sorted(_happenings(rollout), key=lambda h: (h.step, h.lane != "ego", h.agent))


def outcome(rollout: Rollout) -> Outcome:
    """Say what became of the ego, and count the collisions of the others."""
    found = happenings(rollout)
    others = sum(h.kind == "collision" and h.lane != "ego" for h in found)
    tone, text, moment = _fate(rollout, [h for h in found if h.lane == "ego"])
    decided_s = (rollout.num_steps - 1 if moment is None else moment.step) * rollout.dt_s
    if moment is None:
        moment = next((h for h in found if h.kind == "collision"), None)
    step = 0 if moment is None or moment.kind in ENDS else moment.step
    return Outcome(tone, text, others, max(0.0, step * rollout.dt_s - LEAD_S), decided_s)


def _fate(rollout: Rollout, own: list[Happening]) -> tuple[Tone, str, Happening | None]:
    """Tone, words, and the happening of the ego that decides."""
    if "ego" not in rollout.agent_ids:
        return "plain", "no ego", None
    if is_log(rollout):
        return "plain", "as recorded", None
    ends = {h.kind: h for h in own}
    goal, seconds = ends.get("goal"), (rollout.num_steps - 1) * rollout.dt_s
    driven = [h for h in own if goal is None or h.step <= goal.step]
    bad = next((h for h in driven if h.kind in ("collision", "off_road")), None)
    if bad is not None:
        what, comma, fault = bad.text.partition(", ")
        text = f"{what} at {bad.step * rollout.dt_s:.1f} s{comma}{fault}"
        return "bad", text if goal is None else f"{text}, reached its goal", bad
    if goal is not None:
        return "good", f"ego reached its goal at {goal.step * rollout.dt_s:.1f} s", goal
    if "time_limit" in ends:
        return "plain", ends["time_limit"].text, ends["time_limit"]
    return "plain", f"ego drove {seconds:.1f} s, hit nobody", None


def _happenings(rollout: Rollout) -> Iterator[Happening]:
    number = {name: i for i, name in enumerate(rollout.agent_ids)}
    guided = guided_agents(rollout)
    kinds = rollout.scene.agent_types
    names = _names(rollout)
    standing = np.linalg.norm(rollout.velocity, axis=-1) < STATIONARY_MPS
    replays = [name == "replay" for name in rollout.driver_names]
    sides: dict[tuple[int, frozenset[int]], list[RolloutEvent]] = {}
    for event in rollout.events:
        agent, lane = number[event.agent_id], _lane(guided, event.agent_id)
        if event.partner_id is not None:
            if is_collision(rollout, event):
                pair = frozenset((agent, number[event.partner_id]))
                sides.setdefault((event.step, pair), []).append(event)
        elif event.kind != "off_road" or lane != "others":
            words = _WORDS.get(event.kind, event.kind.replace("_", " "))
            if event.kind == "time_limit":
                words = _late(rollout, agent)
            yield Happening(event.step, agent, -1, lane, event.kind, f"{names[agent]} {words}")
    for (step, _), events in sides.items():
        first = min(events, key=_importance)
        agent, partner = number[first.agent_id], number[str(first.partner_id)]
        stood = standing[:, max(step - 1, 0)]
        lane = _lane(guided, first.agent_id, str(first.partner_id))
        # the log walks and drives through what stands where nobody stood
        blind = any(replays[i] and stood[j] for i, j in ((agent, partner), (partner, agent)))
        if blind and lane != "ego":
            continue
        went = GOES.get(kinds[agent], "drove")
        text = _collision(first, bool(stood[agent]), names[agent], names[partner], went)
        yield Happening(step, agent, partner, lane, "collision", text)


_WORDS = {"off_road": "left the road", "goal": "reached its goal"}


def _late(rollout: Rollout, agent: int) -> str:
    """What is said of an agent whose time has run out."""
    log = rollout.scene.tracks()
    steps = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    own = rollout.position[agent, rollout.valid[agent]]
    logged = log["position"][agent, steps][log["valid"][agent, steps]]
    if max(reach_m(own), reach_m(logged)) < WAITED_M:
        return "waited, as in its log"
    return f"not at its goal in {(rollout.num_steps - 1) * rollout.dt_s:.1f} s"


def _importance(event: RolloutEvent) -> tuple[bool, bool, str]:
    """The ego's side of a collision comes first, then that of who drives into the other."""
    return event.agent_id != "ego", event.kind != "collision_front", event.agent_id


def _collision(event: RolloutEvent, stood: bool, one: str, other: str, went: str) -> str:
    """A collision in words; of the ego's it says whose fault it is, and agrees with it."""
    own, front = event.agent_id == "ego", event.kind == "collision_front"
    kind = "standing" if stood and front else event.kind
    text = COLLISIONS.get(kind, "{one} and {other} touch")
    if own and event.at_fault:
        text = AT_FAULT.get(event.kind, text)
    elif own and front:
        text = STOPPED
    text = text.format(one=one, other=other, went=went)
    return f"{text}, {'at fault' if event.at_fault else 'not at fault'}" if own else text


def _lane(guided: set[str], *names: str) -> Lane:
    if "ego" in names:
        return "ego"
    return "guided" if guided.intersection(names) else "others"


def _names(rollout: Rollout) -> list[str]:
    """``ego``, ``4 (bus)``."""
    titles = (long.partition(" · ") for _, long in agent_titles(rollout.scene))
    return [f"{label} ({what})" if what else label for label, _, what in titles]
