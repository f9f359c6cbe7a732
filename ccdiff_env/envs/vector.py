"""The native vector environment: E worlds, each with the ego as its one controlled agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from gymnasium.vector import AutoresetMode

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.as_vector import AsVector
from ccdiff_env.envs.parts import EGO_OPTIONS, InfoLevel, OnWorlds, reset_options
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.traffic.options import Autoreset
from ccdiff_env.worlds import Scenes, StepArrays
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.snapshot import Snapshot
from ccdiff_env.worlds.spaces import F32, Bool, Form

Info = dict[str, Any]


def _name(mode: AutoresetMode) -> Autoreset:
    return cast("Autoreset", mode.name.lower())


def _mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return a mode given by name, in Gymnasium's spelling or in snake case."""
    for known in AutoresetMode:
        if mode in (known, known.value, _name(known)):
            return known
    names = ", ".join(map(_name, AutoresetMode))
    raise ConfigError(f"autoreset_mode is {mode!r}, expected one of {names}")


class EgoVectorEnv(OnWorlds, AsVector):
    """E worlds in Rust, the ego of each driven by one row of actions.

    Args:
        num_envs: Number of worlds E.
        scenes, config, observation, info, render_options, criticality: As for
            :class:`~ccdiff_env.EgoEnv`.
        autoreset_mode: When an ended world restarts: ``"next_step"``, ``"same_step"`` or
            ``"disabled"`` (then with ``reset(options={"reset_mask": ...})``), or Gymnasium's
            ``AutoresetMode``.
        copy: Whether every call returns arrays of its own. Without, observations, rewards, flags
            and columns of the step before are overwritten.
        num_threads: Worker threads; by default all processors from 64 worlds on, else the calling
            thread. Results do not depend on it.
        render_mode: ``None`` or ``"rgb_array"``.
        **options: Fields of :class:`~ccdiff_env.config.WorldConfig` by name, such as
            ``traffic="idm"``, ``driver="idm"``, ``dynamics="bicycle"``, ``discrete=True``,
            ``reward={"goal": 5.0}``, ``bev={"size_px": 64}``. ``driver`` names a planner, too, as
            in :class:`~ccdiff_env.EgoEnv`.

    Notes:
        World i of ``reset(seed=n)`` gets the seed n + i. With scenes in random order it then runs
        exactly as ``EgoEnv.reset(seed=n + i)`` would; torch, which computes some networks
        (:func:`~ccdiff_env.models.needs_torch`), rounds by the size of the batch. In sequential
        order its next scene is E further on: together the worlds play each scene once.
        ``reset(options={"scene": ...})`` chooses scenes by name or index, one for all worlds or a
        list with one entry per world (``None``: no choice); so do ``ego`` and ``start``, where egos
        are drawn. Environments can be pickled and deep-copied in the middle of episodes.
    """

    reset_option_names = EGO_OPTIONS
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        observation: Form | Mapping[str, Any] = "flat",
        info: InfoLevel = "full",
        copy: bool = True,
        num_threads: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Any,
    ) -> None:
        mode = _mode(autoreset_mode)
        options = self._take(options, observation, info, render_mode, render_options)
        chosen, config = self._seat_ego(scenes, config, options)
        self._play(chosen, config, criticality, num_envs, num_threads, _name(mode))
        self._offer_spaces(num_envs)
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self._copy = copy
        self._kept = self._arrays_for(mode)
        self._begun = np.zeros(num_envs, np.bool_)

    @property
    def begun(self) -> bool:
        """Whether a world was ever reset."""
        return bool(self._begun.any())

    def _arrays_for(self, mode: AutoresetMode) -> StepArrays | None:
        """Return arrays that all steps write, as DISABLED needs; ``None``: each has its own."""
        return self.worlds.arrays() if not self._copy or mode is AutoresetMode.DISABLED else None

    def set_autoreset_mode(self, autoreset_mode: AutoresetMode | str) -> None:
        """Choose when ended worlds restart, before the first reset.

        Raises:
            ConfigError: If a world has begun, or there is no such mode.
        """
        mode = _mode(autoreset_mode)
        self.worlds.set_autoreset(_name(mode))
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self._kept = self._arrays_for(mode)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Info]:
        """Begin new episodes.

        Args:
            seed: Any integer n (world i gets n + i), one per world, or ``None`` (worlds go on with
                their generators).
            options: Those of :meth:`EgoEnv.reset`, each one for all worlds (drivers then of those
                vehicles that a world's scene has), or a list of one per world, ``None`` for no
                choice. ``reset_mask``: worlds [E] to reset.

        Returns:
            obs, infos: Observations [E, ...]; ``scene``, ``scene_token``, ``scene_idx``, ``seed``,
                ``episode_idx``, ``start_step``, ``criticality`` of guided traffic, of the worlds
                that were reset, and where drawn ``ego`` and ``ego_idx``.
        """
        given = reset_options(options, (*EGO_OPTIONS, "reset_mask"))
        named, *rest, drivers = (self._per_world(name, given.get(name)) for name in EGO_OPTIONS)
        scenes = [self.worlds.scene_index(one) for one in named]
        wanted = [self.worlds.wanted(*one) for one in zip(scenes, *rest, strict=True)]
        drivers = [self.worlds.agent_drivers(one) for one in drivers]
        mask = given.get("reset_mask")
        mask = None if mask is None else self._reset_mask(mask)
        seeds = self._seeds(seed)
        arrays = self._kept or self.worlds.arrays()
        self._keep_others(arrays, mask)
        listed = None if mask is None else mask.tolist()
        self.worlds.native.reset(seeds, scenes, listed, arrays, wanted)
        done = np.ones(self.num_envs, np.bool_) if mask is None else mask
        self._begun[done] = True
        if self._seat is not None:
            self._seat.reset(np.flatnonzero(done))
            self._seat.see(arrays)
        for_all = isinstance(given.get("drivers"), Mapping)
        for i in np.flatnonzero(done):
            self.worlds.assign(int(i), drivers[i], passing_over=for_all)
        return self._observation(arrays), self._reset_infos({}, done)

    def step(
        self, actions: Any, *, active: Bool | None = None
    ) -> tuple[Any, F32, Bool, Bool, Info]:
        """Advance all worlds, or some of them, by one step.

        Args:
            actions: Actions [E, W] in [-1, 1] (beyond, they are clipped), or indices [E] of the
                grid.
            active: Worlds [E] that go on; all by default. The others stay as they are, with their
                present observations, rewards of zero and nothing in the dictionary; ended ones may
                be among them, so that in DISABLED mode the rest of a batch goes on.

        Returns:
            obs, rewards, terminations, truncations, infos: Arrays [E, ...], and a dictionary of
                arrays with ``_key`` masks: the info columns of the step, of rows that end, too, and
                as if nothing happened in rows without a step; ``metrics``, scene and seed of
                episodes that end; scene and seed of those that begin; in SAME_STEP mode
                ``final_obs`` and ``final_info``, which has what is said of those that end.

        Raises:
            ShapeError, ActionError: If the actions or the worlds do not fit; nothing has moved
                then.
            ResetNeededError: Before the first reset, and in DISABLED mode for ended worlds that are
                active.
        """
        if self._seat is not None and self._begun.all():
            actions = self._seat.decide(self.worlds)
        checked = self.worlds.actions(actions, self._action_shape)
        mask = None if active is None else self._mask("active", active)
        out = self._kept or self.worlds.arrays()
        self.worlds.native.step(checked, out, mask)
        self._keep_others(out, mask)
        if self._seat is not None:
            if out.was_reset.any():
                self._seat.reset(np.flatnonzero(out.was_reset))
            self._seat.see(out)
        reward = out.reward[:, 0]
        terminated, truncated = out.terminated[:, 0], out.truncated[:, 0]
        infos = self._step_infos(out, mask)
        if self._copy and self._kept is not None:
            reward, terminated, truncated = reward.copy(), terminated.copy(), truncated.copy()
        return self._observation(out), reward, terminated, truncated, infos

    def _step_infos(self, out: StepArrays, active: Bool | None) -> Info:
        infos: Info = {}
        any_done, done = bool(out.done.any()), out.done
        if any_done and out.final_obs is not None:
            about = {} if self._info == "none" else self._figures(out.columns, done)
            about |= self._ended(out)
            bev = None if out.final_bev is None else out.final_bev[:, 0]
            infos.update(self._final(out.final_obs[:, 0], bev, done, about))
        if self._info == "full":
            running = ~out.was_reset if active is None else active & ~out.was_reset
            infos.update(self._figures(out.columns, running, running | done))
        if any_done and out.final_obs is None:
            if self._info == "end":
                infos.update(self._figures(out.columns, done))
            infos.update(self._ended(out))
        if out.was_reset.any():
            self._reset_infos(infos, out.was_reset.copy())
        return infos

    def _ended(self, out: StepArrays) -> Info:
        if self._info == "none":
            return {}
        return self._episodes(out.done) | self._metrics(out.done[:, None], out.done)

    def _reset_infos(self, infos: Info, which: Bool) -> Info:
        for i in np.flatnonzero(which):
            self._put(infos, int(i), self.worlds.begin_episode(int(i), self._info))
        return infos

    def _observation(self, out: StepArrays) -> Any:
        return self._seen(out, copied=self._copy and self._kept is not None)

    def _keep_others(self, arrays: StepArrays, mask: Bool | None) -> None:
        """Write what worlds show that a call leaves alone, where it writes new arrays."""
        if mask is not None and self._kept is None:
            for i in np.flatnonzero(~mask):
                self._keep(arrays, int(i))

    def _keep(self, arrays: StepArrays, world_idx: int) -> Any:
        """Write a world's present observation into arrays and return it as a single one's."""
        rows, bev = self.worlds.observe(world_idx)
        arrays.obs[world_idx] = rows
        if bev is not None and arrays.bev is not None:
            arrays.bev[world_idx] = bev
        return self.worlds.layout.observation(self._form, rows[0], None if bev is None else bev[0])

    def _mask(self, name: str, mask: Any) -> Bool:
        shape = (self.num_envs,)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != shape:
            raise ShapeError(f"{name} is {mask!r}, expected a bool array of shape {shape}")
        given: Bool = mask.view(np.uint8) != 0  # a byte of an array of bool may be any
        return given

    def _reset_mask(self, given: Any) -> Bool:
        mask = self._mask("reset_mask", given)
        if not mask.any():
            raise ConfigError("reset_mask is False everywhere, expected at least one True")
        if not (self._begun | mask).all():
            raise ConfigError("the first reset must reset all worlds")
        return mask

    def expert_action(self) -> Any:
        """Return the actions [E, W], or indices [E], that lead towards the next logged states."""
        found = np.stack([self.worlds.native.expert_actions(i)[0] for i in range(self.num_envs)])
        return found[:, 0].astype(np.int64) if self.worlds.discrete else found

    def explain(self, world_idx: int) -> TrafficPlan | None:
        """Return the plan that CCDiff follows in a world; ``None`` before the first one.

        Raises:
            UnknownNameError: If the world does not exist, or CCDiff drives nobody.
        """
        return self.worlds.explain(world_idx)

    def snapshot(self, world_idx: int) -> bytes:
        """Return everything that the future of a world depends on."""
        self.worlds.check_world(world_idx)
        return Snapshot.of(self.worlds, world_idx).to_bytes()

    def restore(self, world_idx: int, snapshot: bytes, *, seed: int | None = None) -> Any:
        """Put a world into the state of a snapshot, its own or another world's.

        With a ``seed`` its traffic goes on as another draw, see :meth:`EgoEnv.restore`.

        Returns:
            obs: Its observation, as a single environment would return it.

        Raises:
            SnapshotError: If the bytes are damaged, or belong to another configuration or other
                scenes.
        """
        self.worlds.check_world(world_idx)
        Snapshot.from_bytes(snapshot).put(self.worlds, world_idx, seed)
        if self._seat is not None:
            self._seat.reset([world_idx])
        self._begun[world_idx] = True
        return self._keep(self._kept or self.worlds.arrays(), world_idx)
