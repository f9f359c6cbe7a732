"""Agents of a multi-agent environment: which vehicles, under which names, in which roles."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, unknown
from ccdiff_env.scenes import SceneSet
from ccdiff_env.traffic.options import VehicleRanking

Agents: TypeAlias = Literal["all"] | int | Sequence[str]
Adversaries: TypeAlias = Literal["others"] | int | Sequence[str] | None
Names: TypeAlias = Literal["token", "slot"]
Bool = npt.NDArray[np.bool_]

#: Ways to rank vehicles, see :meth:`Scene.ranked_vehicles`.
RANKINGS: tuple[VehicleRanking, ...] = get_args(VehicleRanking)
MAX_SLOTS = 512  #: Most slots of a world.


@dataclass(frozen=True)
class AgentSelection:
    """Who is controlled from outside, in every scene: ids, one per slot, the ego first, and
    adversaries: by id, and as many of the slots behind the first as ``num_adversaries``.

    Of a ranking at starts that are drawn, ``ids`` are all vehicles that any start has; ``ranking``
    is ``None`` for agents that are chosen beforehand.
    """

    ids: tuple[tuple[str, ...], ...]
    adversaries: tuple[frozenset[str], ...]
    num_slots: int
    ranking: VehicleRanking | None = None
    num_adversaries: int = 0

    @classmethod
    def of(
        cls,
        scenes: SceneSet,
        config: WorldConfig,
        *,
        agents: Agents,
        ranking: VehicleRanking,
        adversaries: Adversaries,
    ) -> AgentSelection:
        """Choose the agents, see :class:`~ccdiff_env.envs.parallel.MultiAgentEnv`.

        ``config`` says at which steps of the log episodes start. K is at most the vehicles that any
        scene ever has at a time. A :class:`ConfigError` refuses a choice that does not exist, is
        more than there are, or leaves a scene without anybody.
        """
        if ranking not in RANKINGS:
            raise unknown("ranking", str(ranking), RANKINGS)
        count = _count("agents", agents, "all")
        named = None if count is not None or isinstance(agents, (str, int)) else tuple(agents)
        if count is not None:
            vehicles = (s.tracks()["valid"][np.array(s.agent_types) == "vehicle"] for s in scenes)
            at_a_time = max(int(there.sum(0).max(initial=0)) for there in vehicles)
            _expect_most("agents", count, min(at_a_time, MAX_SLOTS))
        elif named is not None:
            _expect_known("agents", named, {one for scene in scenes for one in scene.agent_ids})
            _expect_most("agents", len(named), MAX_SLOTS)
        first, spread = config.history_steps, config.start_spread_steps
        drawn, ids, most = spread > 0 and named is None, [], 0
        for scene in scenes:
            if named is not None:
                chosen = [str(one) for one in named if one in scene.agent_ids]
            elif drawn:  # among the vehicles of each start the worlds choose
                starts = slice(first, min(first + spread, scene.num_steps - 2) + 1)
                free = np.array(scene.agent_types) == "vehicle"
                free[[towed for towed, _ in scene.towed]] = False
                there = scene.tracks()["valid"][:, starts] & free[:, None]
                chosen = [scene.agent_ids[i] for i in np.flatnonzero(there.any(1))]
                chosen.sort(key=lambda one: one != "ego")
                most = max(most, int(there.sum(0).max()))
            else:
                ranked = scene.ranked_vehicles(min(first, scene.num_steps - 1), ranking)
                chosen = [scene.agent_ids[i] for i in ranked[: count or MAX_SLOTS]]
            if not chosen:
                raise ConfigError(f"agents: scene {scene.name!r} has no vehicle to control")
            ids.append(tuple(chosen))
        if drawn:
            num_slots = min(most, count or most, MAX_SLOTS)
        else:
            num_slots = max(len(chosen) for chosen in ids)
        against, num = frozenset[str](), 0
        if adversaries is not None:
            by_slot = _count("adversaries", adversaries, "others")
            if by_slot is not None:
                _expect_most("adversaries", by_slot, num_slots - 1)
            if by_slot is not None or adversaries == "others":
                num = by_slot or num_slots - 1
            else:
                _expect_known("adversaries", adversaries, {one for some in ids for one in some})
                against = frozenset(adversaries)  # type: ignore[arg-type]
        roles = tuple(against.intersection(chosen) for chosen in ids)
        return cls(tuple(ids), roles, num_slots, ranking if drawn else None, num)

    def config(self, scenes: SceneSet, config: WorldConfig, shaping: float) -> WorldConfig:
        """Return the configuration with these agents of the scenes in its slots, in their roles.

        ``shaping`` is the share of what its own driving costs it in the reward of an adversary.
        """
        roles = zip(scenes.names, self.ids, self.adversaries, strict=True)
        against = {
            name: [one for one in ids if one in chosen] for name, ids, chosen in roles if chosen
        }
        ids = dict(zip(scenes.names, self.ids, strict=True))
        return config.with_options(
            controlled=ids if self.ranking is None else "vehicles",
            num_slots=self.num_slots,
            ranking=self.ranking or "first",
            num_adversaries=self.num_adversaries,
            adversaries=against,
            adversary_shaping=shaping,
        )

    def names(self, names: Names) -> tuple[str, ...]:
        """Return the names that agents can have: all ids, or one per slot."""
        if names == "slot":
            first = "ego_0" if all(ids[0] == "ego" for ids in self.ids) else "vehicle_0"
            return (first, *(f"vehicle_{i}" for i in range(1, self.num_slots)))
        if names != "token":
            raise unknown("form of names", str(names), ("token", "slot"))
        return tuple(dict.fromkeys(one for ids in self.ids for one in ids))

    def adversary_slots(self, scene_idx: int, slots: Sequence[str | None]) -> Bool:
        """Return which slots [C] are adversaries in a scene, from the ids in the slots."""
        by_slot = range(1, self.num_adversaries + 1)
        against = self.adversaries[scene_idx]
        return np.array(
            [one is not None and (c in by_slot or one in against) for c, one in enumerate(slots)],
            np.bool_,
        )


def _count(name: str, choice: Any, word: str) -> int | None:
    """Return a number of agents; ``None`` for the word and for ids."""
    if isinstance(choice, str) and choice != word:
        raise ConfigError(f"{name} is {choice!r}, expected {word!r}, a number or ids")
    if isinstance(choice, (int, np.integer)) and not isinstance(choice, bool):
        if choice < 1:
            raise ConfigError(f"{name} is {choice}, expected at least 1")
        return int(choice)
    if not isinstance(choice, (str, Sequence)):
        raise ConfigError(f"{name} is {choice!r}, expected {word!r}, a number or ids")
    return None


def _expect_most(name: str, count: int, most: int) -> None:
    if count > most:
        raise ConfigError(f"{name} is {count}, expected 1 to {most}: no scene has more")


def _expect_known(name: str, choice: Any, known: Collection[str]) -> None:
    for one in choice:
        if one not in known:
            raise ConfigError(f"{name}: no scene has an agent {one!r} to choose")
