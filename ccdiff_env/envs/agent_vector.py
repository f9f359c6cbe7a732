"""Vector environment of several vehicles in many worlds: every controlled vehicle is a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.agent_selection import Adversaries, Agents
from ccdiff_env.envs.as_vector import AsVector, with_masks
from ccdiff_env.envs.drawing import FPS
from ccdiff_env.envs.parts import InfoLevel, Shared, agent_parts
from ccdiff_env.envs.reset_options import AGENT_OPTIONS, reset_options
from ccdiff_env.traffic.options import VehicleRanking
from ccdiff_env.worlds import Scenes, StepArrays
from ccdiff_env.worlds.curriculum import Criticality, FollowsTraining
from ccdiff_env.worlds.spaces import Form

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import AgentKeywords

__all__ = ["AgentVectorEnv"]

F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
Info = dict[str, Any]


class AgentVectorEnv(FollowsTraining, AsVector):
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
    metadata = {  # noqa: RUF012 (Gymnasium's form)
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
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
        observation: Form = "flat",
        info: InfoLevel = "end",
        num_threads: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Unpack[AgentKeywords],
    ) -> None:
        shared = Shared(
            scenes, config, observation, info, render_mode, render_options, criticality,
            ("rgb_array",), num_worlds, num_threads, "same_step",
        )  # fmt: skip
        self.worlds, selection, self._render_options = agent_parts(
            shared, options, agents=agents, ranking=ranking, adversaries=adversaries,
            adversary_shaping=adversary_shaping,
        )  # fmt: skip
        self.num_worlds, self.num_slots = num_worlds, self.worlds.num_slots
        self.num_envs = num_worlds * self.num_slots
        self.render_mode = render_mode
        self._form: Form = observation
        self.single_observation_space: gymnasium.Space[Any] = self.worlds.observation_space(
            observation
        )
        self.single_action_space: gymnasium.Space[Any] = self.worlds.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = (self.num_envs, *self.worlds.action_shape)
        self._selection = selection
        self._info = info
        self._active = np.zeros((num_worlds, self.num_slots), np.bool_)
        self._adversary = np.zeros((num_worlds, self.num_slots), np.bool_)

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
        infos["active"], infos["_active"] = self.active_masks(), np.ones(self.num_envs, np.bool_)
        return self._shown(out), infos

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
            ShapeError, ActionError: If the actions do not fit; nothing has moved then.
            ResetNeededError: Before the first reset.
        """
        checked = self.worlds.actions(actions, self._action_shape)
        played = self._active
        out = self.worlds.arrays()
        self.worlds.native.step(checked, out)
        assert out.final_obs is not None
        terminated, truncated = out.terminated.copy(), out.truncated.copy()
        rewards, begun = out.reward.copy(), out.done
        columns, last = out.columns.copy(), _last(out)
        metrics = self._metrics(terminated | truncated, out.done)
        self._active = out.alive.copy()
        out.obs[~self._active] = 0.0
        if out.bev is not None:
            out.bev[~self._active] = 0
        waited = ~played & begun[:, None] & self._active
        ended = terminated | truncated
        terminated |= waited
        infos: Info = {}
        if (ended | waited).any():
            self._final(infos, ended, waited, last, columns, metrics)
        if self._info == "full":
            infos.update(self._figures(columns, played))
        self._begin(infos, begun)
        infos["active"], infos["_active"] = self.active_masks(), np.ones(self.num_envs, np.bool_)
        shown = self._shown(out)
        return shown, rewards.ravel(), terminated.ravel(), truncated.ravel(), infos

    def _metrics(self, ended: Bool, done: Bool) -> dict[tuple[int, int], npt.NDArray[np.float64]]:
        """Metrics of slots whose episode has ended, by world and slot."""
        found = {}
        native = self.worlds.native
        for e in np.flatnonzero(ended.any(axis=1)) if self._info != "none" else ():
            table = native.ended_metrics([int(e)])[0] if done[e] else native.metrics(int(e))
            found.update({(int(e), int(c)): table[c] for c in np.flatnonzero(ended[e])})
        return found

    def _figures(self, columns: F32, mask: Bool) -> Info:
        values = np.where(mask.ravel(), columns.reshape(self.num_envs, -1).T, np.float32(0.0))
        return with_masks(self.worlds.column_names, values, mask.ravel())

    def _final(
        self,
        infos: Info,
        ended: Bool,
        waited: Bool,
        last: tuple[F32, U8 | None],
        columns: F32,
        metrics: dict[tuple[int, int], npt.NDArray[np.float64]],
    ) -> None:
        done = (ended | waited).ravel()
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(done):
            at = (i // self.num_slots, i % self.num_slots)
            row, bev = (None if part is None else part[at] * ended[at] for part in last)
            final_obs[i] = self.worlds.layout.observation(self._form, cast("F32", row), bev)
        final: Info = {"played": ended.ravel().copy(), "_played": done.copy()}
        if self._info != "none":
            final.update(self._figures(columns, ended))
            values = np.zeros((len(self.worlds.metric_names), self.num_envs))
            for (e, c), row_metrics in metrics.items():
                values[:, e * self.num_slots + c] = row_metrics
            final["metrics"] = with_masks(self.worlds.metric_names, values, ended.ravel())
            final["_metrics"] = ended.ravel().copy()
        infos["final_obs"], infos["_final_obs"] = final_obs, done.copy()
        infos["final_info"], infos["_final_info"] = final, done.copy()

    def _begin(self, infos: Info, begun: Bool) -> None:
        """Note who plays in the worlds that began an episode, and say so in their rows."""
        for e in np.flatnonzero(begun):
            scene_idx = self.worlds.native.status(int(e)).scene_idx
            ids = self.worlds.scenes[scene_idx].agent_ids
            agents = self.worlds.native.slot_agents(int(e))
            names = [None if agent is None else ids[agent] for agent in agents]
            self._adversary[e] = self._selection.adversary_slots(scene_idx, names)
            common = self.worlds.reset_info(int(e), self._info)
            for c, name in enumerate(names):
                role = "adversary" if self._adversary[e, c] else "ego"
                texts = {} if self._info == "none" else {"agent_id": name, "role": role}
                values = {**common, **texts}
                self._put(infos, int(e) * self.num_slots + c, values)

    def _shown(self, out: StepArrays) -> Any:
        rows = out.obs.reshape(self.num_envs, -1)
        bev = None if out.bev is None else out.bev.reshape(self.num_envs, *out.bev.shape[2:])
        return self.worlds.layout.observation(self._form, rows, bev)


def _last(out: StepArrays) -> tuple[F32, U8 | None]:
    """Observations [E, C, D] and rasters of this step, before any world restarted."""
    done = out.done
    assert out.final_obs is not None
    rows = np.where(done[:, None, None], out.final_obs, out.obs)
    if out.bev is None or out.final_bev is None:
        return rows, None
    return rows, np.where(done[:, None, None, None, None], out.final_bev, out.bev)
