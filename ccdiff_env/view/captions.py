"""Captions of rollouts and their agents, the same on pages and images."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.scenes import Scene
from ccdiff_env.system.named_objects import title_of
from ccdiff_env.system.terminal import counted
from ccdiff_env.traffic import driver_titles
from ccdiff_env.view.render import LOOK

#: Titles of drivers, in the order of the legend; names are those of images.
DRIVER_TITLES = {**driver_titles(), "static": "obstacle"}
#: Titles of planners of the ego, where they are no drivers.
PLANNER_TITLES = {
    "ego": "trained ego",
    "ego_replay": "ego trained in log replay",
    "lane_idm": "IDM on lanes",
    "noop": "no action",
    "pdm": "PDM-Closed",
    "ppo": "PPO from nothing",
}


#: What tables call planners of the package that drive by the log, where drivers have other titles.
LOG_TITLES = {"idm": "IDM on the log's path", "replay": "Log replay"}


def is_taken(name: str) -> bool:
    """Return whether a name, or one that looks like it, is of a planner or driver of the package:
    nobody else's is called so.
    """
    titles = (PLANNER_TITLES, DRIVER_TITLES, LOG_TITLES)
    own = (text for known in titles for text in (*known, *known.values()))
    return _letters(name) in {_letters(text) for text in own}


def _letters(text: str) -> str:
    return "".join(letter for letter in text.casefold() if letter.isalnum())


def planner_title(name: str) -> str:
    """Return in words who drives the ego: a title that it was given (``?title=Ours``), else of a
    file its name without folder and suffix.

    A file keeps its suffix where its name is one of the package.
    """
    if (title := title_of(name)) is not None:
        return title
    path, asked, options = name.partition("?")
    if ":" in path:  # of one's own
        return name
    file = path.rpartition("/")[2]
    stem = file.rpartition(".")[0] if file.endswith((".zip", ".safetensors")) else path
    if stem != path and is_taken(stem):
        stem = file
    return (PLANNER_TITLES.get(path) or DRIVER_TITLES.get(path, stem)) + asked + options


def driver_of(rollout: Rollout, agent: int) -> str:
    """Return who drives an agent as images have it: the ego is its own driver, agents that a
    plan guides are adversaries.
    """
    name = rollout.agent_ids[agent]
    if name == "ego":
        return "ego"
    return "adversary" if name in guided_agents(rollout) else rollout.driver_kinds[agent]


def driver_title(rollout: Rollout, agent: int) -> str:
    """Return in words who moves an agent, the ego too."""
    driver = driver_of(rollout, agent)
    name = rollout.driver_names[agent]
    if driver in ("ego", rollout.driver_kinds[agent]):
        driver = name
    return DRIVER_TITLES.get(driver, name)


def guided_agents(rollout: Rollout) -> set[str]:
    """Return the ids of agents that follow a guided plan at some time."""
    return {
        rollout.agent_ids[agent]
        for plan in rollout.plans
        for agent in plan.agents[plan.guided & plan.follows_plan]
    }


def still(rollout: Rollout) -> npt.NDArray[np.bool_]:
    """Return which agents [A] never leave the place at which they are first; never the ego."""
    reach = [
        reach_m(way[there]) for way, there in zip(rollout.position, rollout.valid, strict=True)
    ]
    own = np.array(rollout.agent_ids) == "ego"
    stays: npt.NDArray[np.bool_] = (np.array(reach) <= LOOK["PARKED_M"]) & ~own
    return stays


def reach_m(way: npt.NDArray[np.float32]) -> float:
    """Return how far points [T, 2] are from the first of them, at most, metres."""
    return float(np.linalg.norm(way - way[:1], axis=-1).max(initial=0.0))


def agent_titles(scene: Scene) -> list[tuple[str, str]]:
    """Return a short and a longer name for each agent, such as ``("12", "12 · bus")``."""
    titles = []
    names = zip(scene.agent_ids, scene.agent_types, scene.agent_categories, strict=True)
    for index, (name, kind, category) in enumerate(names):
        # vehicle.bus.rigid is a bus, human.pedestrian.adult an adult
        first, *parts = category.split(".")
        short = parts[0 if first == "vehicle" else -1] if parts else ""
        what = (short or kind or "agent").replace("_", " ")
        titles.append(("ego", "ego") if name == "ego" else (str(index), f"{index} · {what}"))
    return titles


def is_log(rollout: Rollout) -> bool:
    """Whether everybody follows the log."""
    return all(name == "replay" for name in rollout.driver_names)


def is_collision(rollout: Rollout, event: RolloutEvent) -> bool:
    """Whether an event is a collision: boxes of two agents that follow the log overlap because
    annotations are not exact.
    """
    if event.partner_id is None:
        return False
    both = (rollout.agent_ids.index(name) for name in (event.agent_id, event.partner_id))
    return any(rollout.driver_names[agent] != "replay" for agent in both)


def ego_title(rollout: Rollout) -> str:
    """Return in words who drives the ego: the planner that was recorded, else its driver."""
    planner = str(rollout.meta.get("planner", ""))
    if planner in ("", "log", "replay"):
        ego = driver_title(rollout, rollout.agent_ids.index("ego"))
        return "as recorded" if ego == DRIVER_TITLES["replay"] else ego
    return planner_title(planner)


def traffic_title(rollout: Rollout) -> str:
    """Return in words who drives most vehicles beside the ego; "" where all follow the log."""
    kinds = rollout.scene.agent_types
    background = Counter(
        DRIVER_TITLES.get(driver, driver)
        for driver, name, kind in zip(rollout.driver_names, rollout.agent_ids, kinds, strict=True)
        if name != "ego" and kind == "vehicle" and not is_log(rollout)
    )
    return " and ".join(name for name, _ in background.most_common(2))


def subtitle(rollout: Rollout) -> str:
    """Return one line on what is shown: where, who drives, how many."""
    parts = [rollout.scene.location]
    if "ego" in rollout.agent_ids and not is_log(rollout):
        parts.append(f"ego: {ego_title(rollout)}")
    if traffic := traffic_title(rollout):
        parts.append(f"traffic: {traffic}")
    if guided := len(guided_agents(rollout)):
        parts.append(f"{guided} guided")
    parts.append(counted(rollout.scene.num_agents, "agent"))
    return " · ".join(part for part in parts if part)
