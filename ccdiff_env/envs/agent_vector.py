"""Vector environment of several vehicles in many worlds: every controlled vehicle is a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.agent_selection import Adversaries, Agents
from ccdiff_env.envs.as_vector import AsVector
from ccdiff_env.envs.parts import AGENT_OPTIONS, InfoLevel, OnWorlds, reset_options
from ccdiff_env.traffic.options import VehicleRanking
from ccdiff_env.worlds import Scenes, StepArrays
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.spaces import F32, U8, Bool, Form

Info = dict[str, Any]


class AgentVectorEnv(OnWorlds, AsVector):
    """E worlds of C slots in Rust as E x C rows; row i is slot ``i % C`` of world ``i // C``.

    A row's episode ends when its vehicle's does. It then waits, with observations and rewards of
    zero and ``infos["active"]`` false, until its world has ended and restarts within the step
    (SAME_STEP); the wait itself ends there as an episode whose ``final_info["played"]`` is false.
    Slots for which a scene has no vehicle wait likewise.

    Args:
        num_worlds: Number of worlds E.
        scenes, config, agents, ranking, adversaries, adversary_shaping: As for
            :class:`~ccdiff_env.envs.parallel.MultiAgentEnv`.
        observation, info, num_threads, render_mode, render_options, criticality: As for
            :class:`~ccdiff_env.envs.vector.EgoVectorEnv`.
        **options: Fields of :class:`~ccdiff_env.config.WorldConfig` by name.
    """

    reset_option_names = AGENT_OPTIONS
    _own = ("criticality", "num_slots")
    metadata = {  # noqa: RUF012 (Gymnasium's form)
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_worlds: int = 1,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        agents: Agents = "all",
        ranking: VehicleRanking = "nearest",
        adversaries: Adversaries = None,
        adversary_shaping: float = 0.0,
        observation: Form | Mapping[str, Any] = "flat",
        info: InfoLevel = "end",
        num_threads: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Any,
    ) -> None:
        options = self._take(options, observation, info, render_mode, render_options)
        chosen, config = self._select_agents(
            scenes, config, options, adversary_shaping,
            agents=agents, ranking=ranking, adversaries=adversaries,
        )  # fmt: skip
        self._play(chosen, config, criticality, num_worlds, num_threads, "same_step")
        self.num_worlds, self.num_slots = num_worlds, self.worlds.num_slots
        self._offer_spaces(num_worlds * self.num_slots)
        self._active = np.zeros((num_worlds, self.num_slots), np.bool_)

    def active_masks(self) -> Bool:
        """Return the rows [E x C] whose vehicles are driven by the next actions."""
        return self._active.ravel().copy()

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """Begin new episodes in all worlds.

        Args:
            seed: Any integer n (world i gets n + i), or one per world or row (then that of its
                first).
            options: ``scene``: name or index; ``drivers``: drivers of single vehicles by id, for
                these episodes. Each is one for all (drivers then of those vehicles that a world's
                scene has), or a list of one per world or row; rows of one world must agree.

        Returns:
            obs, infos: Observations [E x C, ...]; ``active``, ``agent_id``, ``role``, ``scene``,
                ``scene_token``, ``seed``, ``episode_idx``.
        """
        given = reset_options(options, AGENT_OPTIONS)
        named, drivers = (self._per_world(name, given.get(name)) for name in AGENT_OPTIONS)
        scenes = [self.worlds.scene_index(one) for one in named]
        drivers = [self.worlds.agent_drivers(one) for one in drivers]
        out = self.worlds.arrays()
        self.worlds.native.reset(self._seeds(seed), scenes, None, out)
        for_all = isinstance(given.get("drivers"), Mapping)
        for world_idx, one in enumerate(drivers):
            self.worlds.assign(world_idx, one, passing_over=for_all)
        self._active = out.alive.copy()
        infos: Info = {}
        self._begin(infos, np.ones(self.num_worlds, np.bool_))
        return self._seen(out), infos

    def step(self, actions: Any) -> tuple[Any, F32, Bool, Bool, Info]:
        """Advance all worlds by one step.

        Args:
            actions: Actions [E x C, W], or indices [E x C]; those of rows that wait are ignored.

        Returns:
            obs, rewards, terminations, truncations, infos: Arrays [E x C, ...]. ``infos`` holds
                ``active``; ``final_obs`` and ``final_info`` of rows that ended (with ``played``,
                info columns and ``metrics``); with ``info="full"`` the info columns of every row
                that played.

        Raises:
            ShapeError, ActionError: If the actions are invalid; the worlds are unchanged.
            ResetNeededError: Before the first reset.
        """
        checked = self.worlds.actions(actions, self._action_shape)
        played = self._active
        out = self.worlds.arrays()
        self.worlds.native.step(checked, out)
        ended = out.terminated | out.truncated
        last = _last(out, ended)
        self._active = out.alive.copy()
        out.obs[~self._active] = 0.0
        if out.bev is not None:
            out.bev[~self._active] = 0
        waited = ~played & out.done[:, None] & self._active
        infos: Info = {}
        if (over := (ended | waited).ravel()).any():
            final: Info = {"played": ended.ravel(), "_played": over.copy()}
            if self._info != "none":
                final |= self._figures(out.columns, ended.ravel())
                final |= self._metrics(ended, out.done) | self._episodes(ended.ravel())
            infos.update(self._final(*last, over, final))
        if self._info == "full":
            infos.update(self._figures(out.columns, played.ravel()))
        self._begin(infos, out.done)
        terminated = (out.terminated | waited).ravel()
        return self._seen(out), out.reward.ravel(), terminated, out.truncated.ravel(), infos

    def _begin(self, infos: Info, begun: Bool) -> None:
        """Note who plays in the worlds that began an episode; say so, and in all rows who acts."""
        for e in np.flatnonzero(begun):
            names, adversaries = self._in_slots(int(e))
            common = self.worlds.begin_episode(int(e), self._info)
            for c, name in enumerate(names):
                role = "adversary" if adversaries[c] else "ego"
                texts = {} if self._info == "none" else {"agent_id": name, "role": role}
                values = {**common, **texts}
                self._put(infos, int(e) * self.num_slots + c, values)
        infos["active"], infos["_active"] = self.active_masks(), np.ones(self.num_envs, np.bool_)


def _last(out: StepArrays, ended: Bool) -> tuple[F32, U8 | None]:
    """Observations and rasters [N, ...] before any world restarted, zero where nobody ended."""

    def rows(now: npt.NDArray[Any], final: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
        assert final is not None
        found = np.where(out.done.reshape(-1, *[1] * (now.ndim - 1)), final, now)
        found[~ended] = 0
        return found.reshape(-1, *now.shape[2:])

    return rows(out.obs, out.final_obs), None if out.bev is None else rows(out.bev, out.final_bev)
