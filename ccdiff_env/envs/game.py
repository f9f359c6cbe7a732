"""Who plays in a game of several agents: which vehicles, under which names, in which roles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig, unknown
from ccdiff_env.envs.worlds import Worlds
from ccdiff_env.errors import ConfigError
from ccdiff_env.key_agents import KeyRanking, logged_vehicles, ranking_named
from ccdiff_env.scenes import SceneSet

Agents: TypeAlias = Literal["all"] | int | Sequence[str]
Adversaries: TypeAlias = Literal["others"] | int | Sequence[str] | None
Names: TypeAlias = Literal["token", "slot"]
F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]

#: Most slots of a world.
MAX_SLOTS = 512


@dataclass(frozen=True)
class Cast:
    """Who is controlled from outside, in every scene.

    Parameters
    ----------
    ids
        Controlled agents of each scene, one per slot, the ego first.
    adversaries
        Those among them that play against the others.
    """

    ids: tuple[tuple[str, ...], ...]
    adversaries: tuple[frozenset[str], ...]

    @classmethod
    def of(
        cls,
        scenes: SceneSet,
        step: int,
        *,
        agents: Agents,
        ranking: KeyRanking,
        adversaries: Adversaries,
    ) -> Cast:
        """Choose the agents.

        Parameters
        ----------
        scenes
            The scenes.
        step
            Step of the log at which episodes start.
        agents
            ``"all"`` vehicles that are there at the start, the ego and the first K - 1 others of
            the ranking, or ids.
        ranking
            How the others are ranked.
        adversaries
            ``None``, all ``"others"`` than the ego, the first n others, or ids.

        Raises
        ------
        ConfigError
            If a choice does not exist, or leaves a scene without anybody.
        """
        ranking = ranking_named(ranking)
        count = _count("agents", agents, "all")
        ids = []
        for scene in scenes:
            if count is None and agents != "all":
                chosen = [str(one) for one in agents if one in scene.agent_ids]  # type: ignore[union-attr]
            else:
                ranked = logged_vehicles(scene, min(step, scene.num_steps - 1), ranking)
                chosen = [scene.agent_ids[i] for i in ranked[:count]]
            if not chosen:
                raise ConfigError(f"agents: nobody to control in scene {scene.name!r}")
            ids.append(tuple(chosen[:MAX_SLOTS]))
        return cls(tuple(ids), tuple(_adversaries(adversaries, chosen) for chosen in ids))

    @property
    def num_slots(self) -> int:
        """Most agents that are controlled in any scene."""
        return max(len(ids) for ids in self.ids)

    def config(self, scenes: SceneSet, config: WorldConfig) -> WorldConfig:
        """Return the configuration with these agents in its slots."""
        chosen = dict(zip(scenes.names, self.ids, strict=True))
        return config.with_options(controlled=chosen, num_slots=self.num_slots)

    def names(self, names: Names) -> tuple[str, ...]:
        """Return the names that agents can have: all ids, or one per slot."""
        if names == "slot":
            first = "ego_0" if all(ids[0] == "ego" for ids in self.ids) else "vehicle_0"
            return (first, *(f"vehicle_{i}" for i in range(1, self.num_slots)))
        if names != "token":
            raise unknown("form of names", str(names), ("token", "slot"))
        return tuple(dict.fromkeys(one for ids in self.ids for one in ids))

    def adversary_slots(self, scene_idx: int) -> Bool:
        """Return which slots [C] are adversaries in a scene."""
        slots = np.zeros(self.num_slots, np.bool_)
        for i, one in enumerate(self.ids[scene_idx]):
            slots[i] = one in self.adversaries[scene_idx]
        return slots


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


def _adversaries(choice: Adversaries, ids: tuple[str, ...]) -> frozenset[str]:
    if choice is None:
        return frozenset()
    count = _count("adversaries", choice, "others")
    if choice == "others" or count is not None:
        return frozenset(ids[1:] if count is None else ids[1 : count + 1])
    return frozenset(one for one in ids if one in choice)  # type: ignore[operator]


class Roles:
    """Rewards of egos and adversaries in one game.

    An ego gets its own reward. An adversary gets the mean reward of the egos that played in the
    step, with the opposite sign, and ``shaping`` times its own off-road and comfort components.

    Parameters
    ----------
    worlds
        The worlds.
    shaping
        Weight of what an adversary's own driving costs it.
    """

    def __init__(self, worlds: Worlds, shaping: float) -> None:
        names = worlds.column_names
        self._own = [names.index("reward_off_road"), names.index("reward_comfort")]
        self._shaping = shaping

    def rewards(self, reward: F32, columns: F32, played: Bool, adversary: Bool) -> F32:
        """Return the rewards [E, C] of a step.

        Parameters
        ----------
        reward, columns
            What the step wrote, [E, C] and [E, C, M].
        played
            Slots [E, C] that were alive before the step.
        adversary
            Slots [E, C] that are adversaries.
        """
        egos, others = played & ~adversary, played & adversary
        if not others.any():
            return reward.copy()
        num_egos = np.maximum(egos.sum(axis=-1, keepdims=True), 1)
        against = np.where(egos, reward, 0.0).sum(axis=-1, keepdims=True) / num_egos
        own = columns[..., self._own].sum(axis=-1) * np.float32(self._shaping)
        return np.where(others, own - against, reward).astype(np.float32)

    @staticmethod
    def decided(alive: Bool, adversary: Bool) -> Bool:
        """Return the worlds [E] in which adversaries go on, but no ego is left."""
        left = (alive & adversary).any(axis=-1) & ~(alive & ~adversary).any(axis=-1)
        return np.asarray(left)
