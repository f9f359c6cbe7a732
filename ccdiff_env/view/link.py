"""Links of the playground: a drive is its scene, its traffic and the keys that were held."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.scenes import Scene
from ccdiff_env.scenes.sources import Place
from ccdiff_env.traffic import KINDS, NETWORKS, SWIFT

HORIZON_STEPS = 150
#: Who drives the others, as the page offers it.
TRAFFIC = {
    **{name: KINDS[name].title for name in ("ccdiff", "tokens", SWIFT, "idm")},
    "replay": "as recorded",
}
#: Most that the steering moves in a step: full lock in a quarter of a second.
STEER_PER_STEP = 4 * 0.1
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
    from ccdiff_env.envs import EgoEnv
    from ccdiff_env.record.recorder import Recorder
    from ccdiff_env.scenes.sources import DEFAULT, load

    drive = read_drive(link)
    scene = load(place or DEFAULT, names=[drive.scene])[0]
    env = EgoEnv(scenes=scene, config=world_config(drive.traffic, drive.criticality))
    env.reset(seed=0)
    recorder = Recorder(env, planner="you")
    recorder.start()
    ego, top_mps, steer = scene.agent_ids.index("ego"), top_speed_mps(scene), 0.0
    for held in drive.keys:
        # as the page computes it
        wanted = float(bool(held & 4)) - float(bool(held & 8))
        steer += min(max(wanted - steer, -STEER_PER_STEP), STEER_PER_STEP)
        x, y = map(float, env.worlds.native.states(0)["velocity"][ego])
        gas = float(held & 1 and x * x + y * y < top_mps**2)
        action = np.array([-1.0 if held & 2 else gas, steer], np.float32)
        _, _, terminated, truncated, _ = env.step(action)
        recorder.step()
        if terminated or truncated:
            break
    env.close()
    return recorder.rollout()
