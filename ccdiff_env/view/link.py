"""Links of the playground: a drive is its scene, its traffic and the keys that were held."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.sources import DEFAULT, Place, load
from ccdiff_env.traffic import KINDS, NETWORKS, SWIFT

HORIZON_STEPS = 150
LIT = "tee-crossing-005"  #: Of the page, with traffic lights: IDM waits and reaches its goal.
#: Who drives the others, as the page offers it.
TRAFFIC = {
    **{name: KINDS[name].title for name in ("ccdiff", "tokens", SWIFT, "idm")},
    "replay": "as recorded",
}
#: Most that the steering moves in a step: full lock in a quarter of a second.
STEER_PER_STEP = 4 * 0.1
ROLLS_MPS = 2.0  #: The ego of a page rolls this fast where its log stands.
LOOK_M = 4.0  #: Who follows the way looks a second ahead, at least so far.
MAX_CRITICALITY = 2.0


def world_config(traffic: str, criticality: float = 0.0) -> WorldConfig:
    """Return the configuration that the page plays with."""
    network: dict[str, Any] = {"criticality": criticality}
    if criticality > 0.0 and traffic != SWIFT:
        network["num_samples"] = 4
    if KINDS[traffic].denoises:
        network["denoising_steps"] = 1
    options: dict[str, Any] = {traffic: network} if traffic in NETWORKS else {}
    return WorldConfig().with_options(
        traffic=traffic, horizon_steps=HORIZON_STEPS, autoreset="disabled", **options
    )


@dataclass(frozen=True)
class Drive:
    """A drive on the page: scene, traffic (of :data:`TRAFFIC`), criticality (0 to 2), and keys of
    each step.

    Keys are numbers added up: accelerate 1, brake 2, left 4, right 8.
    """

    scene: str
    traffic: str
    criticality: float
    keys: tuple[int, ...]


def way(scene: Scene) -> list[list[float]]:
    """Return the way of the ego's log as the page has it: x, y in metres and the speed at which the
    ego rolls there, m/s, rounded to hundredths.
    """
    tracks, ego = scene.tracks(), scene.agent_ids.index("ego")
    there = tracks["valid"][ego]
    position, velocity = (tracks[name][ego, there] for name in ("position", "velocity"))
    speed = np.hypot(*velocity.T).clip(ROLLS_MPS)
    rows: list[list[float]] = np.c_[position, speed].astype(np.float64).round(2).tolist()
    return rows


class Wheel:
    """Steering wheel and pedals of the page: what keys ask for. ``assets/wheel.js`` is the same.

    Without a pedal the ego rolls at the speed that its log has at the nearest place of its way.
    Positions and velocities are x, y in metres and metres a second, as states of worlds are.
    """

    def __init__(self, scene: Scene) -> None:
        self.way, self.top_mps, self.steer = way(scene), top_speed_mps(scene), 0.0

    def _nearest(self, x: float, y: float) -> int:
        far = [(px - x) * (px - x) + (py - y) * (py - y) for px, py, _ in self.way]
        return far.index(min(far))

    def _turned(self, held: int) -> float:
        wanted = float(bool(held & 4)) - float(bool(held & 8))
        return self.steer + min(max(wanted - self.steer, -STEER_PER_STEP), STEER_PER_STEP)

    def action(
        self, held: int, position: Sequence[float], velocity: Sequence[float]
    ) -> npt.NDArray[np.float32]:
        """Return acceleration and yaw rate [2], normalised, for the keys of a step."""
        self.steer = self._turned(held)
        (x, y), (vx, vy) = map(float, position), map(float, velocity)
        squared = vx * vx + vy * vy
        rolls = min(max(self.way[self._nearest(x, y)][2] - math.sqrt(squared), -1.0), 1.0)
        gas = float(squared < self.top_mps**2) if held & 1 else rolls
        return np.array([-1.0 if held & 2 else gas, self.steer], np.float32)

    def along(self, position: Sequence[float], heading_rad: float, speed_mps: float) -> int:
        """Return the keys that steer along the way, whoever is there: no pedal."""
        (x, y), v = map(float, position), float(speed_mps)
        ahead, at, last = max(v, LOOK_M), self._nearest(x, y), len(self.way) - 1
        while at < last and math.hypot(self.way[at][0] - x, self.way[at][1] - y) < ahead:
            at += 1
        dx, dy = self.way[at][0] - x, self.way[at][1] - y
        across = math.cos(heading_rad) * dy - math.sin(heading_rad) * dx
        rate = 2.0 * v * across / max(dx * dx + dy * dy, 1.0)  # of the circle to that place
        return min((0, 4, 8), key=lambda held: abs(self._turned(held) - rate))


def top_speed_mps(scene: Scene) -> int:
    """Return the speed that the ego of a page cannot pass: a fifth above its log's, at least 8."""
    tracks = scene.tracks()
    ego = scene.agent_ids.index("ego")
    speed = np.linalg.norm(tracks["velocity"][ego, tracks["valid"][ego]], axis=1)
    return max(int(np.ceil(1.2 * float(speed.max(initial=0.0)))), 8)


def is_drive(text: str) -> bool:
    """Return whether a word of the command line is a link to a drive."""
    return "#" in text and "drive=" in text


def read_drive(link: str) -> Drive:
    """Read a link that *Share this drive* has made; a :class:`ConfigError` names a part of it that
    is missing, unknown or out of range.
    """
    parts = parse_qs(urlsplit(link).fragment, keep_blank_values=True)
    found = {name: values[0] for name, values in parts.items()}  # as the page reads it
    if missing := {"scene", "traffic", "drive"} - set(found):
        raise ConfigError(f"link: no {min(missing)}, expected scene, traffic and drive")
    if found["traffic"] not in TRAFFIC:
        raise ConfigError(
            f"link: traffic is {found['traffic']!r}, expected one of {', '.join(TRAFFIC)}"
        )
    try:
        criticality = float(found.get("criticality", "0"))
    except ValueError:
        criticality = float("nan")
    if not 0.0 <= criticality <= MAX_CRITICALITY:
        raise ConfigError(f"link: criticality is {found['criticality']!r}, expected 0 to 2")
    drive = found["drive"]
    runs = re.findall(r"([a-p])([1-9][0-9]{0,2})", drive)
    keys = tuple(ord(held) - ord("a") for held, count in runs for _ in range(int(count)))
    if "".join(map("".join, runs)) != drive or len(keys) > HORIZON_STEPS:
        raise ConfigError(
            f"link: drive is {drive[:40]!r}, expected letters a to p, each with its number of "
            f"steps, {HORIZON_STEPS} in all at most"
        )
    return Drive(found["scene"], found["traffic"], criticality, keys)


def play_drive(link: str, place: Place | str | None = None) -> Rollout:
    """Play a link again, in a scene of a place, the embedded ones by default: the states have the
    bits that they had on the page. Raises as :func:`read_drive`, and :class:`UnknownNameError`.
    """
    drive = read_drive(link)
    usual = f"{DEFAULT}/city-lights" if drive.scene == LIT else DEFAULT
    scene = load(place or usual, names=[drive.scene])[0]
    return play_keys(scene, drive.keys, world_config(drive.traffic, drive.criticality))


def play_keys(
    scene: Scene, keys: Sequence[int], config: WorldConfig, *, goes_on: bool = False
) -> Rollout:
    """Play the keys of a drive; one that ``goes_on`` steers along its way after the last of them,
    without avoiding anybody, until the episode ends.
    """
    from ccdiff_env.envs import EgoEnv
    from ccdiff_env.record.recorder import Recorder

    env = EgoEnv(scenes=scene, config=config)
    env.reset(seed=0)
    recorder = Recorder(env, planner="you")
    recorder.start()
    ego, wheel = scene.agent_ids.index("ego"), Wheel(scene)
    for step in range(HORIZON_STEPS if goes_on else len(keys)):
        states = env.worlds.native.states(0)
        position, velocity = states["position"][ego], states["velocity"][ego]
        speed, heading = float(np.hypot(*velocity)), float(states["heading"][ego])
        held = keys[step] if step < len(keys) else wheel.along(position, heading, speed)
        _, _, terminated, truncated, _ = env.step(wheel.action(held, position, velocity))
        recorder.step()
        if terminated or truncated:
            break
    env.close()
    return recorder.rollout()
