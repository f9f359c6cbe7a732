"""Many worlds in which adversaries are selected; the background plans for all of them at once."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.as_vector import AsVector
from ccdiff_env.envs.drawing import FPS, check_render_mode, checked_render_options
from ccdiff_env.envs.reset_options import SELECTION_OPTIONS, reset_options
from ccdiff_env.envs.selection.batch import SelectionBatch
from ccdiff_env.envs.selection.episode import INFO_COLUMNS
from ccdiff_env.envs.selection.options import ActionMode, SelectionReward
from ccdiff_env.envs.selection.single import selection_reward
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.policies.planners import Ego
from ccdiff_env.worlds import Scenes

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import SelectionKeywords

__all__ = ["AdversarySelectionVectorEnv"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Info = dict[str, Any]


class AdversarySelectionVectorEnv(AsVector):
    """E worlds; ended ones begin anew within the step (SAME_STEP).

    World i of ``reset(seed=n)`` gets the seed n + i and then runs as the single environment.

    Parameters
    ----------
    num_envs
        Number of worlds E.
    num_threads
        Worker threads, as for :class:`~ccdiff_env.envs.vector.EgoVectorEnv`.
    scenes, config, ego, action_mode, max_agents, budget, criticality, reward, render_options
        As for :class:`~ccdiff_env.envs.selection.single.AdversarySelectionEnv`.
    render_mode
        ``None`` or ``"rgb_array"``.
    """

    reset_option_names = SELECTION_OPTIONS
    metadata = {  # noqa: RUF012 (Gymnasium's form)
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        ego: Ego = "idm",
        action_mode: ActionMode = "multibinary",
        max_agents: int = 16,
        budget: int = 2,
        criticality: tuple[float, float] | None = None,
        reward: SelectionReward | Mapping[str, Any] | None = None,
        num_threads: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[SelectionKeywords],
    ) -> None:
        check_render_mode(render_mode, ("rgb_array",))
        self._render_options = checked_render_options(render_options)
        self._batch = SelectionBatch(
            num_envs,
            scenes=scenes,
            config=config,
            ego=ego,
            action_mode=action_mode,
            max_agents=max_agents,
            budget=budget,
            criticality=criticality,
            reward=selection_reward(reward),
            num_threads=num_threads,
            trails=render_mode is not None,
            options=options,
        )
        self.worlds = self._batch.worlds
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space: gymnasium.Space[Any] = self._batch.observation_space
        self.single_action_space: gymnasium.Space[Any] = copy.deepcopy(self._batch.actions.space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """Begin new episodes in all worlds.

        Parameters
        ----------
        seed
            Any integer n (world i gets n + i), or one per world.
        options
            ``scene``: name or index, or one per world.

        Returns
        -------
        obs, infos
            Observations [E, ...]; ``scene``, ``scene_token``, ``seed``, ``episode_idx``.
        """
        given = reset_options(options, SELECTION_OPTIONS)
        listed = self._per_world("scene", given.get("scene"))
        scenes = [self.worlds.scene_index(one) for one in listed]
        self._batch.reset(self._seeds(seed), scenes)
        infos: Info = {}
        self._reset_infos(infos, np.ones(self.num_envs, np.bool_))
        return self._observations(), infos

    def step(self, actions: Any) -> tuple[Any, F32, Bool, Bool, Info]:
        """Choose adversaries in all worlds and advance until the next plans.

        Parameters
        ----------
        actions
            Actions [E, ...].

        Returns
        -------
        obs, rewards, terminations, truncations, infos
            Arrays [E, ...]; ``infos`` holds the info columns of the decision, and ``final_obs`` and
            ``final_info`` (with ``metrics`` and ``is_success``) of episodes that ended.
        """
        if len(actions) != self.num_envs:
            raise ShapeError(f"{len(actions)} actions, expected {self.num_envs}")
        outcomes = self._batch.decide(list(actions))
        rewards = np.array([outcome.reward for outcome in outcomes], np.float32)
        terminated = np.array([outcome.terminated for outcome in outcomes])
        truncated = np.array([outcome.truncated for outcome in outcomes])
        done = terminated | truncated
        table = {c.name: np.array([o.info[c.name] for o in outcomes]) for c in INFO_COLUMNS}
        infos: Info = {}
        for name, values in table.items():
            infos[name], infos["_" + name] = values, ~done
        if done.any():
            final_obs = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(done):
                final_obs[i] = self._batch.observe(int(i))
            infos["final_obs"], infos["_final_obs"] = final_obs, done.copy()
            infos["final_info"] = self._final_info(table, done)
            infos["_final_info"] = done.copy()
            empty: list[int | None] = [None] * self.num_envs
            self._batch.reset(empty, empty, done)
            self._reset_infos(infos, done)
        return self._observations(), rewards, terminated, truncated, infos

    def _final_info(self, table: Mapping[str, Any], done: Bool) -> Info:
        final: Info = {}
        for name, values in table.items():
            final[name], final["_" + name] = np.where(done, values, 0.0), done.copy()
        metrics = [self._batch.episode(i).metrics() for i in range(self.num_envs)]
        episode: Info = {}
        for name in metrics[0]:
            values = np.array([one[name] for one in metrics])
            episode[name], episode["_" + name] = np.where(done, values, 0.0), done.copy()
        final["metrics"], final["_metrics"] = episode, done.copy()
        final["is_success"], final["_is_success"] = episode["is_success"] > 0.5, done.copy()
        return final

    def _reset_infos(self, infos: Info, which: Bool) -> None:
        for i in np.flatnonzero(which):
            self._put(infos, int(i), self.worlds.reset_info(int(i), "full"))

    def _observations(self) -> dict[str, npt.NDArray[Any]]:
        rows = [self._batch.observe(i) for i in range(self.num_envs)]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def action_masks(self) -> Bool:
        """Return which actions are legal in each world [E, ...]."""
        masks = [self._batch.actions.masks(self._batch.mask(i)) for i in range(self.num_envs)]
        return np.stack(masks)

    def baseline(self, name: str, seed: int = 0) -> npt.NDArray[Any]:
        """Return what an adversary policy would do in each world [E, ...]; seeds are seed + i."""
        return np.stack([self._batch.baseline(i, name, seed + i) for i in range(self.num_envs)])

    def fork_gaps(self, steps: int) -> F32:
        """Return how near each candidate comes to the ego in forks where it alone is guided.

        Parameters
        ----------
        steps
            Steps of the world that a fork lasts.

        Returns
        -------
        gaps
            Least distance of centres [E, M], m; -1 in contact, infinite for rows without an agent.
            The worlds do not change.

        Raises
        ------
        ConfigError
            If the ego is a policy.
        """
        return self._batch.fork_gaps(steps)

    def __reduce__(self) -> Any:
        """Refuse copies: the ego's planner is any function."""
        raise ConfigError("AdversarySelection environments cannot be pickled; make another one")
