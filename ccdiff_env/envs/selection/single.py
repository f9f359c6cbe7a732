"""One world in which adversaries are selected, as a plain Gymnasium environment."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig, unknown
from ccdiff_env.envs.drawing import FPS, DrawnWorld, check_render_mode, checked_render_options
from ccdiff_env.envs.reset_options import SELECTION_OPTIONS, reset_options
from ccdiff_env.envs.selection.batch import SelectionBatch
from ccdiff_env.envs.selection.options import ActionMode, SelectionReward
from ccdiff_env.errors import ConfigError
from ccdiff_env.policies.planners import Ego
from ccdiff_env.worlds import Scenes, normalize_seed

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import SelectionKeywords

__all__ = ["AdversarySelectionEnv", "selection_reward"]


def selection_reward(reward: SelectionReward | Mapping[str, Any] | None) -> SelectionReward:
    """Return weights given as such, or as a dictionary of those to change.

    Raises
    ------
    ConfigError
        If a name is unknown or a value is out of range.
    """
    if isinstance(reward, SelectionReward):
        return reward
    known = SelectionReward.__dataclass_fields__
    for name in reward or {}:
        if name not in known:
            raise unknown("reward", str(name), known)
    return SelectionReward(**(reward or {}))


class AdversarySelectionEnv(DrawnWorld, gymnasium.Env[Any, Any]):
    """Choose, once per plan of the background, which vehicles become adversaries of the ego.

    Parameters
    ----------
    scenes
        A :class:`SceneSet`, scenes, the text of a source (:func:`ccdiff_env.load`), or the name
        of a split of the embedded scenes.
    config
        Configuration of the world to start from.
    ego
        The ego's planner: ``"replay"``, ``"idm"``, ``"constant_velocity"``, ``"ccdiff"``, a
        function from observations [N, D] to actions, a policy with ``predict``, or the path of a
        policy saved by stable-baselines3.
    action_mode
        ``"multibinary"`` (a flag per row), ``"scores"`` (a number per row, the highest count) or
        ``"discrete"`` (one row, the last index for nobody).
    max_agents
        Rows of candidates M: the vehicles nearest to the ego that the background drives.
    budget
        Adversaries at most, K.
    criticality
        Range of the strength of the guidance; a further entry of ``"scores"`` chooses from it.
    reward
        Weights, see :class:`SelectionReward`; also as a dictionary.
    render_mode
        ``None``, ``"rgb_array"`` or ``"human"`` (needs pygame).
    render_options
        Options of images.
    **options
        Fields of :class:`~ccdiff_env.config.WorldConfig` by name, such as
        ``ccdiff={"replan_steps": 5}``, whose plans set the pace of decisions.
    """

    _title = "ccdiff_env/AdversarySelection"
    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": FPS}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        ego: Ego = "idm",
        action_mode: ActionMode = "multibinary",
        max_agents: int = 16,
        budget: int = 2,
        criticality: tuple[float, float] | None = None,
        reward: SelectionReward | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[SelectionKeywords],
    ) -> None:
        check_render_mode(render_mode, ("human", "rgb_array"))
        self._render_options = checked_render_options(render_options)
        self._batch = SelectionBatch(
            1,
            scenes=scenes,
            config=config,
            ego=ego,
            action_mode=action_mode,
            max_agents=max_agents,
            budget=budget,
            criticality=criticality,
            reward=selection_reward(reward),
            num_threads=1,
            trails=render_mode is not None,
            options=options,
        )
        self.worlds = self._batch.worlds
        self.render_mode = render_mode
        self.observation_space: gymnasium.Space[Any] = self._batch.observation_space
        self.action_space: gymnasium.Space[Any] = copy.deepcopy(self._batch.actions.space)
        self._seeded = False

    @property
    def on_step(self) -> Callable[[], object] | None:
        """Function called after every step of the world, such as ``Recorder(env).step``."""
        return self._batch.on_step

    @on_step.setter
    def on_step(self, function: Callable[[], object] | None) -> None:
        self._batch.on_step = function

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a new episode; ``options`` may name the ``scene``, by name or index.

        Returns
        -------
        obs, info
            First observation; ``scene``, ``scene_token``, ``seed``, ``episode_idx`` and
            ``agent_ids``, who sits in which row.
        """
        given = reset_options(options, SELECTION_OPTIONS)
        scene_idx = self.worlds.scene_index(given.get("scene"))
        normalized = None if seed is None else normalize_seed(seed)
        super().reset(seed=normalized)
        if normalized is None and not self._seeded:
            normalized = int(self.np_random.integers(2**63))
        self._seeded = True
        self._batch.reset([normalized], [scene_idx])
        if self.render_mode == "human":
            self.render()
        return self._batch.observe(0), {
            **self.worlds.reset_info(0, "full"),
            "agent_ids": self.agent_ids(),
        }

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Choose adversaries and advance until the next plan.

        Parameters
        ----------
        action
            An action of the space; rows without an agent, and those beyond the budget, are passed
            over.

        Returns
        -------
        obs, reward, terminated, truncated, info
            ``info`` holds the info columns of the decision, ``adversaries`` (ids),
            ``collision_pairs`` (ids), ``agent_ids`` of the next rows and, at the end of an episode,
            ``metrics`` and ``is_success``.

        Raises
        ------
        ActionError
            If the action does not fit; nothing has moved then.
        ResetNeededError
            Before the first reset and after the end of an episode.
        """
        (outcome,) = self._batch.decide([action])
        info: dict[str, Any] = {
            **outcome.info,
            "adversaries": outcome.adversaries,
            "collision_pairs": outcome.pairs,
            "agent_ids": self.agent_ids(),
        }
        if outcome.terminated or outcome.truncated:
            info["metrics"] = self._batch.episode(0).metrics()
            info["is_success"] = info["metrics"]["is_success"]
        if self.render_mode == "human":
            self.render()
        obs = self._batch.observe(0)
        return obs, outcome.reward, outcome.terminated, outcome.truncated, info

    def agent_ids(self) -> tuple[str, ...]:
        """Return the ids of the agents in the rows that actions choose from."""
        episode = self._batch.episode(0)
        return tuple(episode.ids[i] for i in episode.rows(self._batch.actions.num_rows))

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return which actions are legal, as MaskablePPO of sb3-contrib takes it."""
        return self._batch.actions.masks(self._batch.mask(0))

    def baseline(self, name: str, seed: int = 0) -> Any:
        """Return what a simple adversary policy would do now.

        Parameters
        ----------
        name
            ``"none"``, ``"random"``, ``"nearest"``, ``"ttc"`` or ``"causal"``.
        seed
            For ``"random"``.
        """
        return self._batch.baseline(0, name, seed)

    def __reduce__(self) -> Any:
        """Refuse copies: the ego's planner is any function."""
        raise ConfigError("AdversarySelection environments cannot be pickled; make another one")
