"""One world in which adversaries are chosen, as a plain Gymnasium environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.drawing import (
    FPS,
    RENDER_MODES,
    DrawnWorld,
    check_render_mode,
    checked_render_options,
)
from ccdiff_env.envs.selection.vector import (
    AdversarySelectionVectorEnv,
    Counts,
    SelectionOptions,
)
from ccdiff_env.policies.planners import Ego
from ccdiff_env.worlds import Worlds

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["AdversarySelectionEnv"]


class SingleOptions(SelectionOptions, total=False):
    """Options of :class:`~ccdiff_env.AdversarySelectionVectorEnv`."""

    ego: Ego
    max_candidates: int
    strengths: Sequence[float]
    num_adversaries: int
    counts: Counts
    shift_cost: float


class AdversarySelectionEnv(DrawnWorld, gymnasium.Env[Any, Any]):
    """Choose, once per plan of the background, which vehicle becomes an adversary of the ego.

    It is :class:`~ccdiff_env.AdversarySelectionVectorEnv` with one world, which does not begin
    anew by itself.

    Parameters
    ----------
    **options
        As there, and ``render_mode="human"`` (needs pygame).
    """

    _title = "ccdiff_env/AdversarySelection"
    metadata = {"render_modes": RENDER_MODES, "render_fps": FPS}  # noqa: RUF012 (Gymnasium's form)

    def __init__(self, **options: Unpack[SingleOptions]) -> None:
        self.render_mode = options.get("render_mode")
        check_render_mode(self.render_mode, ("human", "rgb_array"))
        self._render_options = checked_render_options(options.get("render_options"))
        options["render_mode"] = None if self.render_mode is None else "rgb_array"
        options.setdefault("num_threads", 1)
        self.vector = AdversarySelectionVectorEnv(1, **options)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    @property
    def worlds(self) -> Worlds:  # type: ignore[override]
        """The native world."""
        return self.vector.worlds

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
        """Choose an adversary by an index of the space and advance until the next plan.

        Returns
        -------
        obs, reward, terminated, truncated, info
            ``info`` holds the info columns of the decision, ``adversary`` (id or ``None``),
            ``agent_ids`` of the next rows and, at the end, ``metrics`` and ``is_success``.

        Raises
        ------
        ActionError, ResetNeededError
            If the action does not fit, before the first reset and after the end of an episode.
        """
        rewards, table = self.vector.decide(self.vector.chosen([action]), all_running=True)
        info = {name: values[0] for name, values in table.items()}
        info["agent_ids"], done = self.agent_ids(), bool(self.vector.ended[0])
        if done:
            info["metrics"] = {name: float(of[0]) for name, of in self.vector.metrics().items()}
            info["is_success"] = info["metrics"]["is_success"]
        if self.render_mode == "human":
            self.render()
        return self.vector.observation()[0], float(rewards[0]), done, False, info

    def agent_ids(self) -> tuple[str, ...]:
        """Return the ids of the vehicles in the rows that actions choose from."""
        return tuple(self.scene.agent_ids[agent] for agent in self.vector.candidates[0])

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return which actions are legal [R S + 1], as MaskablePPO of sb3-contrib takes them."""
        masks: npt.NDArray[np.bool_] = self.vector.action_masks()[0]
        return masks
