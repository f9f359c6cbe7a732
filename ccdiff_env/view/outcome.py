"""What became of an episode: the ego's fate in one sentence, and the events that deserve a flag."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.system.terminal import counted
from ccdiff_env.view.captions import agent_titles, guided_agents, is_collision, is_log, reach_m
from ccdiff_env.view.contact import WAITS_MPS, blocker, impact

Lane = Literal["ego", "guided", "others"]
Tone = Literal["bad", "good", "blocked", "plain"]
#: Of a collision, by the speeds along its normal: who brings more hits; who brings less is hit.
Role = Literal["", "hits", "hit", "met"]

STATIONARY_MPS = 0.1  #: Who is slower when the log reaches it stood there.
LEAD_S = 2.0  #: Replays open so long before what they open for.
ENDS = ("goal", "time_limit", "blocked")
WAITED_M = 2.0  #: An ego that moves less than this, as its log does, waited.
#: What befell the ego, in the index of replays.
MISHAPS = {
    "hits": "drives into somebody",
    "hit": "is hit",
    "met": "meets somebody",
    "off_road": "leaves the road",
}
PASSES_MPS = 3.0  #: Nobody walks into a vehicle that is faster: it runs into who walks.
#: What is said on pages, in films and in the playground. In a contact the agent that is spoken of
#: ``hits`` the other one, by how it moves, or is ``hit``, on the side that the other one came to.
WORDS: dict[str, Any] = {
    "hits": {
        "into": "{went} into {other}",
        "back": "backed into {other}",
        "aside": "brushed against {other}",
        "static": "hit {other}",
    },
    "hit": {
        "front": "hit in front by {other}",
        "rear": "hit from behind by {other}",
        "side": "hit in the side by {other}",
    },
    "met": "met {other}",
    "goes": {"pedestrian": "walked", "cyclist": "rode", "motorcycle": "rode", "else": "drove"},
    "fault": ["not at fault", "at fault"],
    "off_road": "left the road",
    "wrong_way": "drove against the traffic",
    "goal": "reached its goal",
    "waited": "waited, as in its log",
    "blocked": "blocked by {other} for {seconds} s",
    "on_its_way": "on its way, {share} % in {seconds} s",
    "late": "late, {share} % of its way in {seconds} s",
    "collided": "collided",  # of the trained ego in the playground
}


@dataclass(frozen=True)
class Happening:
    """One thing that happened at a recorded step to an agent and a partner (indices, -1 for none).

    Both sides of a collision are one. ``lane`` says whose it is: the ego's, that of a guided
    vehicle, or that of the others. ``kind`` is ``"collision"``, ``"off_road"``, ``"wrong_way"``,
    ``"goal"``, ``"blocked"`` or ``"time_limit"``. ``fault`` is nuPlan's word on a collision of the
    ego, and ``closing_mps`` how fast the two of a collision approached.
    """

    step: int
    agent: int
    partner: int
    lane: Lane
    kind: str
    who: str
    did: str
    role: Role = ""
    fault: str = ""
    closing_mps: float | None = None

    def told(self, when: str = "", who: str | None = None) -> str:
        """Return it in words, with a time where it has one."""
        speed = "" if self.closing_mps is None else f", {self.closing_mps:.1f} m/s"
        return f"{self.who if who is None else who} {self.did}{when}{speed}"


@dataclass(frozen=True)
class Outcome:
    """What became of the ego in words, and collisions of others alone.

    ``tone`` is ``"bad"`` after an accident of the ego at any time, else ``"good"`` at its goal.
    ``fault`` is nuPlan's word on its collision, or "". ``mishap`` is what befell it: it "is hit",
    "drives into somebody", "meets somebody", "leaves the road", or "". ``opening_s`` is a moment
    before what matters most, ``decided_s`` when it is known; both count from the start.
    """

    tone: Tone
    text: str
    fault: str
    mishap: str
    others: int
    opening_s: float
    decided_s: float

    @property
    def line(self) -> str:
        """The text, whose fault it was, and the number of collisions among the others."""
        others = f"others: {counted(self.others, 'collision')}" if self.others else ""
        return " · ".join(filter(None, [self.text, self.fault, others]))


def happenings(rollout: Rollout) -> list[Happening]:
    """Return what happened, by step.

    Left out: boxes of two that follow the log, and of one that does and another that stands;
    vehicles that leave the road unguided, since many do in their logs.
    """
    return sorted(
        _happenings(rollout),
        key=lambda h: (h.step, h.lane != "ego", h.agent, h.kind != "collision"),
    )


def outcome(rollout: Rollout) -> Outcome:
    """Say what became of the ego, and count the collisions of the others."""
    found = happenings(rollout)
    others = sum(h.kind == "collision" and h.lane != "ego" for h in found)
    tone, text, moment = _fate(rollout, [h for h in found if h.lane == "ego"])
    decided_s = (rollout.num_steps - 1 if moment is None else moment.step) * rollout.dt_s
    fault = mishap = ""
    if moment is None:
        moment = next((h for h in found if h.kind == "collision"), None)
    else:
        fault, mishap = moment.fault, MISHAPS.get(moment.role or moment.kind, "")
    step = 0 if moment is None or moment.kind in ENDS else moment.step
    opening_s = max(0.0, step * rollout.dt_s - LEAD_S)
    return Outcome(tone, text, fault, mishap, others, opening_s, decided_s)


def _fate(rollout: Rollout, own: list[Happening]) -> tuple[Tone, str, Happening | None]:
    """Tone, words, and the happening of the ego that decides: its first accident, if it has one."""
    if "ego" not in rollout.agent_ids:
        return "plain", "no ego", None
    if is_log(rollout):
        return "plain", "as recorded", None
    when = {h: f" at {h.step * rollout.dt_s:.1f} s" for h in own}
    goal = next((h for h in own if h.kind == "goal"), None)
    bad = next((h for h in own if h.kind in ("collision", "off_road")), None)
    if bad is not None and goal is not None and bad.step > goal.step:
        return "bad", f"{goal.told(when[goal])}, {bad.told(when[bad], 'then')}", bad
    if bad is not None:
        return "bad", bad.told(when[bad]) + (f", {WORDS['goal']}" if goal else ""), bad
    if goal is not None:
        return "good", goal.told(when[goal]), goal
    end = next((h for h in own if h.kind in ENDS), None)
    if end is not None:
        return "blocked" if end.kind == "blocked" else "plain", end.told(), end
    return "plain", f"ego drove {(rollout.num_steps - 1) * rollout.dt_s:.1f} s, hit nobody", None


def _happenings(rollout: Rollout) -> Iterator[Happening]:
    number = {name: i for i, name in enumerate(rollout.agent_ids)}
    guided = guided_agents(rollout)
    names = _names(rollout)
    standing = np.linalg.norm(rollout.velocity, axis=-1) < STATIONARY_MPS
    replays = [name == "replay" for name in rollout.driver_names]
    # who arrived or had an accident is not late
    decided = {
        event.agent_id
        for event in rollout.events
        if event.kind in ("goal", "off_road") or is_collision(rollout, event)
    }
    sides: dict[tuple[int, frozenset[int]], dict[int, RolloutEvent]] = {}
    for event in rollout.events:
        agent, lane = number[event.agent_id], _lane(guided, event.agent_id)
        if event.partner_id is not None:
            if is_collision(rollout, event):
                pair = frozenset((agent, number[event.partner_id]))
                sides.setdefault((event.step, pair), {})[agent] = event
        elif event.kind == "time_limit":
            if event.agent_id not in decided:
                kind, did = _end(rollout, agent, names)
                yield Happening(event.step, agent, -1, lane, kind, names[agent], did)
        elif event.kind != "off_road" or lane != "others":
            did = WORDS.get(event.kind, event.kind.replace("_", " "))
            yield Happening(event.step, agent, -1, lane, event.kind, names[agent], did)
    told = rollout.info.get("wrong_way", ()) if "ego" in number else ()
    wrong = np.r_[False, np.asarray(told) > 0.0]
    for step in np.flatnonzero(wrong[1:] & ~wrong[:-1]) + 1:
        ego = number["ego"]
        yield Happening(int(step), ego, -1, "ego", "wrong_way", "ego", WORDS["wrong_way"])
    for (step, pair), seen in sides.items():
        lane = _lane(guided, *(rollout.agent_ids[i] for i in pair))
        stood = standing[:, max(step - 1, 0)]
        # the log walks and drives through what stands where nobody stood
        blind = any(replays[i] and stood[j] for i in pair for j in pair - {i})
        if not blind or lane == "ego":
            yield _collision(rollout, step, lane, seen, names)


def _end(rollout: Rollout, agent: int, names: list[str]) -> tuple[str, str]:
    """What has become of an agent whose time has run out: its kind, and words."""
    log = rollout.scene.tracks()
    steps = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    own = rollout.position[agent, rollout.valid[agent]]
    logged = log["position"][agent, steps][log["valid"][agent, steps]]
    if max(reach_m(own), reach_m(logged)) < WAITED_M:
        return "time_limit", WORDS["waited"]
    if (found := blocker(rollout, agent)) is not None:
        words = WORDS["blocked"].replace("{seconds}", f"{found[1]:.1f}")
        return "blocked", words.replace("{other}", names[found[0]])
    moves = np.hypot(*rollout.velocity[agent, -1]) >= WAITS_MPS
    seconds = f"{(rollout.num_steps - 1) * rollout.dt_s:.1f}"
    words = WORDS["on_its_way" if moves else "late"].replace("{seconds}", seconds)
    share = rollout.info.get("route_completion")
    if share is None or not len(share):
        return "time_limit", words.partition(",")[0]
    return "time_limit", words.replace("{share}", str(math.floor(100.0 * float(share[-1]))))


def _collision(
    rollout: Rollout, step: int, lane: Lane, seen: dict[int, RolloutEvent], names: list[str]
) -> Happening:
    """A collision that one or both of its agents see, told of the ego, else of who hits."""
    ids, kinds = rollout.agent_ids, rollout.scene.agent_types
    event = next(iter(seen.values()))
    pair = sorted((ids.index(event.agent_id), ids.index(str(event.partner_id))))
    normal, brought = impact(rollout, step, *pair)
    hits, other = pair if brought[0] >= brought[1] else pair[::-1]
    # of who is removed by it, the step before
    at = np.arange(len(ids)), np.where(rollout.valid[:, step], step, max(step - 1, 0))
    velocity, heading = rollout.velocity[at], rollout.heading[at]
    passes = (kinds[hits], kinds[other]) == ("pedestrian", "vehicle")
    if passes and np.hypot(*velocity[other]) > PASSES_MPS:
        hits = other
    own = next((i for i in pair if ids[i] == "ego"), None)
    told = hits if own is None else own
    (other,) = {*pair} - {told}
    forwards = np.array([np.cos(heading[told]), np.sin(heading[told])])
    across = (normal if told == pair[0] else -normal) @ forwards
    role: Role = "met" if brought.max() < WAITS_MPS else "hits" if told == hits else "hit"
    if role == "hit":
        part = "side" if abs(across) < math.sqrt(0.5) else "front" if across > 0.0 else "rear"
    elif "static" in (kinds[told], kinds[other]):
        part = "static"
    else:
        slides = brought[pair.index(told)] < np.hypot(*velocity[told]) / 2.0
        part = "aside" if slides else "into" if velocity[told] @ forwards >= 0.0 else "back"
    words = WORDS["met"] if role == "met" else WORDS[role][part]
    words = words.replace("{went}", WORDS["goes"].get(kinds[told], WORDS["goes"]["else"]))
    did = words.replace("{other}", names[other])
    fault = "" if told not in seen or own is None else WORDS["fault"][seen[told].at_fault]
    speed = max(float(brought.sum()), 0.0)
    return Happening(step, told, other, lane, "collision", names[told], did, role, fault, speed)


def _lane(guided: set[str], *names: str) -> Lane:
    if "ego" in names:
        return "ego"
    return "guided" if guided.intersection(names) else "others"


def _names(rollout: Rollout) -> list[str]:
    """``ego``, ``4 (bus)``."""
    titles = (long.partition(" · ") for _, long in agent_titles(rollout.scene))
    return [f"{label} ({what})" if what else label for label, _, what in titles]
