"""One world in which adversaries are chosen, as a plain Gymnasium environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.drawing import FPS, DrawnWorld, check_render_mode, checked_render_options
from ccdiff_env.envs.selection.vector import STRENGTHS, AdversarySelectionVectorEnv
from ccdiff_env.errors import ConfigError
from ccdiff_env.policies.planners import Ego
from ccdiff_env.traffic.options import SelectionReward
from ccdiff_env.worlds import Scenes

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import SelectionKeywords

__all__ = ["AdversarySelectionEnv"]


class AdversarySelectionEnv(DrawnWorld, gymnasium.Env[Any, Any]):
    """Choose, once per plan of the background, which vehicle becomes an adversary of the ego.

    It is :class:`~ccdiff_env.AdversarySelectionVectorEnv` with one world, which does not begin
    anew by itself.

    Parameters
    ----------
    scenes, config, ego, max_candidates, strengths, reward, render_options, **options
        As there.
    render_mode
        ``None``, ``"rgb_array"`` or ``"human"`` (needs pygame).
    """

    _title = "ccdiff_env/AdversarySelection"
    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": FPS}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        ego: Ego = "idm",
        max_candidates: int = 8,
        strengths: Sequence[float] = STRENGTHS,
        reward: SelectionReward | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[SelectionKeywords],
    ) -> None:
        check_render_mode(render_mode, ("human", "rgb_array"))
        self._render_options = checked_render_options(render_options)
        self.vector = AdversarySelectionVectorEnv(
            1,
            scenes=scenes,
            config=config,
            ego=ego,
            max_candidates=max_candidates,
            strengths=strengths,
            reward=reward,
            num_threads=1,
            render_mode=None if render_mode is None else "rgb_array",
            **options,
        )
        self.worlds = self.vector.worlds
        self.render_mode = render_mode
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    @property
    def on_step(self) -> Callable[[], object] | None:
        """Function called after every step of the world, such as ``Recorder(env).step``."""
        return self.vector.on_step

    @on_step.setter
    def on_step(self, function: Callable[[], object] | None) -> None:
        self.vector.on_step = function

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a new episode; ``options`` may name the ``scene``, by name or index.

        Returns
        -------
        obs, info
            First observation [R, F]; ``scene``, ``scene_token``, ``seed``, ``episode_idx`` and
            ``agent_ids``, who is in which row.
        """
        super().reset(seed=None if seed is None else seed % 2**63)
        obs, _ = self.vector.reset(seed=seed, options=options)
        if self.render_mode == "human":
            self.render()
        return obs[0], {**self.worlds.reset_info(0, "full"), "agent_ids": self.agent_ids()}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Choose an adversary and advance until the next plan.

        Parameters
        ----------
        action
            Index of the space.

        Returns
        -------
        obs, reward, terminated, truncated, info
            ``info`` holds the info columns of the decision, ``adversary`` (id or ``None``),
            ``agent_ids`` of the next rows and, at the end of an episode, ``metrics`` and
            ``is_success``.

        Raises
        ------
        ActionError
            If the action does not fit; nothing has moved then.
        ResetNeededError
            Before the first reset and after the end of an episode.
        """
        self.vector.check_running()
        table, terminated, truncated = self.vector.decide(self.vector.chosen([action]))
        info: dict[str, Any] = {
            name: float(values[0]) for name, values in table.items() if name != "adversary"
        }
        info |= {"adversary": table["adversary"][0], "agent_ids": self.agent_ids()}
        if terminated[0] or truncated[0]:
            info["metrics"] = self.vector.metrics(0)
            info["is_success"] = info["metrics"]["is_success"]
        if self.render_mode == "human":
            self.render()
        reward = info["reward_collision"] + info["reward_shift"]
        return self.vector.observation()[0], reward, bool(terminated[0]), bool(truncated[0]), info

    def agent_ids(self) -> tuple[str, ...]:
        """Return the ids of the vehicles in the rows that actions choose from."""
        ids = self.scene.agent_ids
        return tuple(ids[agent] for agent in self.vector.candidates[0])

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return which actions are legal [R S + 1], as MaskablePPO of sb3-contrib takes them."""
        masks: npt.NDArray[np.bool_] = self.vector.action_masks()[0]
        return masks

    def __reduce__(self) -> Any:
        """Refuse copies: the ego's planner is any function."""
        raise ConfigError("AdversarySelection environments cannot be pickled; make another one")
