"""E worlds in which adversaries are selected, one decision per plan of the background."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig, unknown
from ccdiff_env.envs.key_agents import KeyRanking
from ccdiff_env.envs.selection.episode import Outcome, SelectionEpisode
from ccdiff_env.envs.selection.options import ActionMode, SelectionActions, SelectionReward
from ccdiff_env.envs.selection.view import observation_space
from ccdiff_env.errors import ConfigError, ResetNeededError
from ccdiff_env.policies.planners import Ego, ego_driver
from ccdiff_env.worlds import Scenes, Worlds, scene_set, world_config

__all__ = ["BASELINES", "SelectionBatch"]

#: Adversary policies to compare with: nobody, chance, nearest to the ego, soonest contact with the
#: ego, the causal ranking (clique occurrences).
BASELINES: dict[str, KeyRanking | None] = {
    "none": None,
    "random": "random",
    "nearest": "nearest",
    "ttc": "ttc",
    "causal": "cliques",
}


class SelectionBatch:
    """E worlds, their egos' planner, and the episode of each.

    Parameters
    ----------
    num_worlds
        Number of worlds E.
    scenes, config
        As for :class:`~ccdiff_env.envs.single.EgoEnv`.
    ego
        The ego's planner, see :func:`ccdiff_env.policies.planners.ego_driver`.
    action_mode, max_agents, budget, criticality
        See :class:`SelectionActions`.
    reward
        Weights.
    num_threads, trails
        As for :class:`~ccdiff_env.worlds.Worlds`.
    options
        Fields of :class:`~ccdiff_env.config.WorldConfig`; ``traffic`` is ``"ccdiff"`` of
        criticality 1 by default.

    Raises
    ------
    ConfigError
        In traffic that nothing guides.
    """

    def __init__(
        self,
        num_worlds: int,
        *,
        scenes: Scenes,
        config: WorldConfig | None,
        ego: Ego,
        action_mode: ActionMode,
        max_agents: int,
        budget: int,
        criticality: tuple[float, float] | None,
        reward: SelectionReward,
        num_threads: int | None,
        trails: bool,
        options: Mapping[str, Any],
    ) -> None:
        for name in ("controlled", "num_slots", "autoreset", "driver", "decision_steps"):
            if name in options:
                raise ConfigError(f"{name} is not an option of adversary selection")
        self.actions = SelectionActions(action_mode, max_agents, budget, criticality)
        self.observation_space = observation_space(max_agents)
        driver, self._act = ego_driver(ego)
        chosen = scene_set(scenes)
        options = {"traffic": "ccdiff", **options}
        base = config
        if config is None and self._act is not None:
            # a policy says what it observes and what its actions mean
            base, options = self._act.config, {"dt_s": chosen[0].dt, **options}
        resolved = world_config(chosen, base, options)
        given = options.get("ccdiff", {})
        unsaid = isinstance(given, dict) and "criticality" not in given
        if config is None and unsaid and resolved.takes_ccdiff():
            resolved = resolved.with_options(ccdiff={"criticality": 1.0})
        resolved = resolved.with_options(driver=driver, autoreset="disabled", decision_steps=1)
        networks = resolved.guided_traffic("adversary selection")
        #: Whether whom an action chooses is guided, though it does not say how strongly.
        self._guides = max(one.criticality for one in networks) > 0.0
        self.decision_steps, *others = dict.fromkeys(one.replan_steps for one in networks)
        if others:
            raise ConfigError(
                f"adversary selection: replan_steps are {self.decision_steps} and {others[0]}, "
                "expected one number for all traffic"
            )
        self.worlds = Worlds(
            chosen, resolved, num_worlds=num_worlds, num_threads=num_threads, trails=trails
        )
        self._began = False
        self.episodes: list[SelectionEpisode | None] = [None] * num_worlds
        self._ended = np.ones(num_worlds, np.bool_)
        self._obs = np.zeros((num_worlds, self.worlds.layout.size), np.float32)
        self._reward = reward
        #: Called after every step of the worlds, of which a decision has several.
        self.on_step: Callable[[], object] | None = None

    def episode(self, world_idx: int) -> SelectionEpisode:
        """Return the episode of a world.

        Raises
        ------
        ResetNeededError
            Before its first reset.
        """
        found = self.episodes[world_idx]
        if found is None:
            raise ResetNeededError(f"world {world_idx} was never reset")
        return found

    def reset(
        self,
        seeds: Sequence[int | None],
        scenes: Sequence[int | None],
        mask: npt.NDArray[np.bool_] | None = None,
    ) -> None:
        """Begin episodes in the worlds of a mask."""
        which = np.ones(self.worlds.num_worlds, np.bool_) if mask is None else mask
        out = self.worlds.arrays()
        self.worlds.native.reset(list(seeds), list(scenes), which.tolist(), out)
        for e in np.flatnonzero(which):
            self.episodes[e] = SelectionEpisode(self.worlds, int(e), self._reward)
            self._obs[e] = out.obs[e, 0]
        self._ended[which] = False
        if self._act is not None:
            if self._began:
                self._act.reset(np.flatnonzero(which))
            else:
                self._act.begin(self.worlds)
            self._began = True

    def observe(self, world_idx: int) -> dict[str, npt.NDArray[Any]]:
        """Return what the adversary policy of a world sees."""
        return self.episode(world_idx).observe(self.actions.num_rows)

    def mask(self, world_idx: int) -> npt.NDArray[np.bool_]:
        """Return which rows [M] of a world hold an agent."""
        rows = self.actions.num_rows
        present = len(self.episode(world_idx).rows(rows))
        return np.arange(rows) < present

    def baseline(self, world_idx: int, name: str, seed: int = 0) -> Any:
        """Return the action that an adversary policy of :data:`BASELINES` would take in a world."""
        if name not in BASELINES:
            raise unknown("baseline", str(name), BASELINES)
        ranking = BASELINES[name]
        episode = self.episode(world_idx)
        place = {agent: row for row, agent in enumerate(episode.rows(self.actions.num_rows))}
        ranked = [] if ranking is None else episode.rank(ranking, seed)
        rows = [place[agent] for agent in ranked if agent in place]
        return self.actions.action(rows[: self.actions.budget])

    def fork_gaps(self, steps: int) -> npt.NDArray[np.float32]:
        """Try every candidate in forks of the worlds; the worlds stay where they are.

        Parameters
        ----------
        steps
            Steps of the world that a fork lasts.

        Returns
        -------
        gaps
            Least distance of centres of the ego and a candidate while that one alone is guided, m;
            -1 where the two come into contact, infinite for rows without an agent, [E, M].

        Raises
        ------
        ConfigError
            If the ego is a policy, whose memory a fork does not hold.
        """
        if self._act is not None:
            raise ConfigError("forks need an ego that worlds drive themselves, such as idm")
        native, num_worlds = self.worlds.native, self.worlds.num_worlds
        saved = [native.snapshot(e) for e in range(num_worlds)]
        episodes = [self.episode(e) for e in range(num_worlds)]
        rows = [episode.rows(self.actions.num_rows) for episode in episodes]
        gaps = np.full((num_worlds, self.actions.num_rows), np.inf, np.float32)
        for row in range(max(len(found) for found in rows)):
            running = np.array([row < len(found) for found in rows])
            for e in np.flatnonzero(running):
                native.restore(int(e), saved[e])
                native.override_plan(int(e), guided=rows[e][row : row + 1], criticality=None)
            for _ in range(steps):
                out = self.worlds.arrays()
                native.step(self._ego_actions(running), out, running)
                for e in np.flatnonzero(running):
                    gap = _gap(native, int(e), episodes[e].ego, rows[e][row])
                    gaps[e, row] = min(gaps[e, row], gap)
                running &= ~out.done
        for e in range(num_worlds):
            native.restore(e, saved[e])
        return gaps

    def decide(self, actions: Sequence[Any]) -> list[Outcome]:
        """Advance all worlds by one decision.

        Parameters
        ----------
        actions
            One per world.

        Returns
        -------
        list
            What it led to. Worlds that ended are to be reset before the next decision.

        Raises
        ------
        ActionError
            If an action does not fit; nothing has moved then.
        ConfigError
            If somebody is chosen and nothing says how strongly to guide: a criticality of 0.
        ResetNeededError
            If a world has ended or was never reset.
        """
        if self._ended.any():
            world = int(np.flatnonzero(self._ended)[0])
            raise ResetNeededError(f"world {world} has ended or was never reset")
        native, num_worlds = self.worlds.native, self.worlds.num_worlds
        chosen = []
        for e, action in enumerate(actions):
            rows = self.episode(e).rows(self.actions.num_rows)
            mask = np.arange(self.actions.num_rows) < len(rows)
            chosen.append([rows[row] for row in self.actions.rows(action, mask)])
        strengths = [self.actions.criticality(action) for action in actions]
        for adversaries, strength in zip(chosen, strengths, strict=True):
            if adversaries and strength is None and not self._guides:
                raise ConfigError(
                    "adversary selection: ccdiff.criticality is 0, expected more: nobody whom an "
                    "action chooses is guided"
                )
        for e, adversaries in enumerate(chosen):
            self.episode(e).begin(adversaries)
            native.override_plan(e, guided=adversaries, criticality=strengths[e])
        terminated, truncated = np.zeros((2, num_worlds), np.bool_)
        for _ in range(self.decision_steps):
            running = ~self._ended
            if not running.any():
                break
            out = self.worlds.arrays()
            native.step(self._ego_actions(running), out, running)
            for e in np.flatnonzero(running):
                self.episode(int(e)).step()
                self._obs[e] = out.obs[e, 0]
            terminated |= out.terminated[:, 0]
            truncated |= out.truncated[:, 0]
            self._ended |= out.done
            if self.on_step is not None:
                self.on_step()
        return [
            self.episode(e).finish(bool(terminated[e]), bool(truncated[e]))
            for e in range(num_worlds)
        ]

    def _ego_actions(self, running: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
        shape = (self.worlds.num_worlds, *self.worlds.action_shape)
        if self._act is None:
            width = self.worlds.native.action_width
            return np.zeros((self.worlds.num_worlds, 1, width), np.float32)
        return self.worlds.actions(self._act(self._obs, running), shape)


def _gap(native: Any, world_idx: int, ego: int, agent: int) -> float:
    """Distance of two agents' centres, m; -1 in contact, infinite where one is not there."""
    if any((i, j) == (ego, agent) for i, j, *_ in native.contacts(world_idx)):
        return -1.0
    states = native.states(world_idx)
    if not (states["active"][ego] and states["active"][agent]):
        return float("inf")
    return float(np.linalg.norm(states["position"][ego] - states["position"][agent]))
