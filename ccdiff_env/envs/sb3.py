"""stable-baselines3's ``VecEnv`` over the native vector environment, without subprocesses."""

from __future__ import annotations

import copy
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from ccdiff_env.envs.agent_vector import AgentVectorEnv
from ccdiff_env.envs.parts import reset_options
from ccdiff_env.envs.selection import AdversarySelectionVectorEnv
from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ConfigError, MissingFeatureError
from ccdiff_env.planners.sb3_policy import Sb3Policy, algorithm_of
from ccdiff_env.worlds import exact_seed
from ccdiff_env.worlds.fit import STATISTICS

try:
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise MissingFeatureError(
        "this needs stable-baselines3: pip install 'ccdiff-env[rl]'"
    ) from error


def save_policy(model: BaseAlgorithm, path: str | Path) -> None:
    """Save a policy with the statistics of the ``VecNormalize`` that it was trained under.

    What it was trained in is in the file anyway, as its observation space says it.
    :func:`ccdiff_env.planners.load` reads it.

    Raises:
        ConfigError: If it could not be driven: rasters or dictionaries were normalised, wrappers
            changed observations, or its algorithm is none of those of docs/planners.md. Nothing is
            written then.
    """
    algorithm_of(model.policy_class.__module__)
    norm = model.get_vec_normalize_env()
    if norm is not None and norm.norm_obs:
        form = Sb3Policy(model.policy, "the policy").observation
        if form != "flat":
            raise ConfigError(f"observation is {form!r}, expected 'flat' under VecNormalize")
        assert not isinstance(norm.obs_rms, dict), "the form is flat"
        scale = np.sqrt(norm.obs_rms.var + norm.epsilon)
        setattr(model, STATISTICS, [norm.obs_rms.mean.tolist(), scale.tolist(), norm.clip_obs])
    try:
        Sb3Policy(model, "the policy")
        model.save(path)
    finally:
        vars(model).pop(STATISTICS, None)


class SB3VecEnv(VecEnv):
    """The worlds of an :class:`EgoVectorEnv` as stable-baselines3 wants them.

    Done worlds are reset within the step. Their info holds ``terminal_observation``,
    ``TimeLimit.truncated`` (truncated and not terminated), ``episode`` (``r``, ``l``, ``t`` as
    ``VecMonitor`` writes them), ``is_success`` and the info columns of the last step;
    the infos of the others hold ``TimeLimit.truncated`` alone.

    Args:
        env: Put into ``SAME_STEP`` autoreset mode, if it is in another one and has not been reset.
        torch_threads: Threads of torch in this process. Networks of this size are
            slower with more than one, which then take several times the processor time; ``None``
            leaves torch's setting.
        clock_ends: Whether an episode that runs out of time has ended, as for a learner that sees
            the clock (``time_remaining``): ``TimeLimit.truncated`` stays false.

    Raises:
        ConfigError: If the environment is in another autoreset mode and has been reset, or is
            wrapped.
    """

    def __init__(
        self,
        env: EgoVectorEnv | AgentVectorEnv | AdversarySelectionVectorEnv,
        *,
        torch_threads: int | None = 1,
        clock_ends: bool = False,
    ) -> None:
        wanted = getattr(env, "unwrapped", env)
        if isinstance(wanted, AgentVectorEnv) != isinstance(self, AgentSB3VecEnv):
            raise ConfigError(
                "AgentVectorEnv needs AgentSB3VecEnv, and no other environment does: it leaves out "
                "rows of vehicles that have finished"
            )
        if not isinstance(wanted, (EgoVectorEnv, AgentVectorEnv, AdversarySelectionVectorEnv)):
            raise ConfigError(
                f"{type(self).__name__} takes the worlds of make_vec(...), not {env}: give an "
                "environment of one world to the algorithm itself"
            )
        if isinstance(env, EgoVectorEnv) and not env.begun:
            env.set_autoreset_mode(AutoresetMode.SAME_STEP)
        if env.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP:
            raise ConfigError(
                f"autoreset_mode is {env.metadata['autoreset_mode']}, expected SAME_STEP: "
                'make_vec(..., autoreset_mode="same_step")'
            )
        if torch_threads is not None:
            torch.set_num_threads(torch_threads)
        self.env = env
        self.render_mode = env.render_mode
        self._clock_ends = clock_ends
        self._actions: np.ndarray[Any, Any] | None = None
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._start = time.time()
        # VecNormalize changes spaces of rasters in place: those of the worlds stay what they are
        spaces = copy.deepcopy((env.single_observation_space, env.single_action_space))
        super().__init__(env.num_envs, *spaces)
        self.metadata["render_fps"] = env.metadata["render_fps"]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Choose the seeds of the next reset: any integer n, for row i n + i."""
        return super().seed(None if seed is None else exact_seed(seed))

    def reset(self) -> Any:
        """Reset all worlds, with the seeds and options of :meth:`seed` and ``set_options``.

        Options are those of the worlds' own ``reset``, one dictionary for all or one per row.

        Raises:
            ConfigError: For an option that the worlds do not take, or another number of
                dictionaries.
        """
        if len(self._options) != self.num_envs:
            raise ConfigError(f"{len(self._options)} options, expected {self.num_envs}")
        rows = [reset_options(one, self.env.unwrapped.reset_option_names) for one in self._options]
        names = dict.fromkeys(name for one in rows for name in one)
        options = {name: [one.get(name) for one in rows] for name in names}
        obs, infos = self.env.reset(seed=list(self._seeds), options=options)
        self.reset_infos = self._infos_of(infos, np.arange(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = self._lengths[:] = 0
        return obs

    def step_async(self, actions: np.ndarray[Any, Any]) -> None:
        """Remember the actions [E, ...] of the coming :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Step all worlds; observations [E, ...], rewards [E], dones [E], infos."""
        assert self._actions is not None, "step_async comes first"
        obs, rewards, terminated, truncated, infos = self.env.step(self._actions)
        dones = np.logical_or(terminated, truncated)
        self._returns += rewards
        self._lengths += 1
        out: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        seconds = round(time.time() - self._start, 6)
        ended = np.flatnonzero(dones)
        for i, said, fresh in zip(
            ended,
            self._infos_of(infos.get("final_info", {}), ended),
            self._infos_of(infos, ended),
            strict=True,
        ):
            episode = {"r": round(float(self._returns[i]), 6), "l": int(self._lengths[i])}
            out[i] = {
                **said,
                "terminal_observation": infos["final_obs"][i],
                "TimeLimit.truncated": bool(
                    truncated[i] and not terminated[i] and not self._clock_ends
                ),
                "episode": {**episode, "t": seconds},
            }
            self.reset_infos[i] = fresh
        self._returns[dones] = self._lengths[dones] = 0
        return obs, np.asarray(rewards, dtype=np.float32), dones, out

    @staticmethod
    def _infos_of(infos: dict[str, Any], rows: np.ndarray[Any, Any]) -> list[dict[str, Any]]:
        """Entries of rows of Gymnasium's dict of arrays, where its masks say that there are any."""
        found: list[dict[str, Any]] = [{} for _ in rows]
        for key, values in infos.items():
            if key.startswith("_") or key in ("final_obs", "final_info"):
                continue
            if isinstance(values, dict):
                said = SB3VecEnv._infos_of(values, rows)
            else:
                said = values[rows].tolist() if values.ndim == 1 else list(values[rows])
            mask = None if isinstance(values, dict) else infos.get(f"_{key}")
            there = [True] * len(said) if mask is None else mask[rows].tolist()
            for info, value, is_there in zip(found, said, there, strict=True):
                if is_there:
                    info[key] = value
        return found

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def get_images(self) -> Sequence[np.ndarray[Any, Any] | None]:
        """Image of every world, uint8 [H, W, 3]."""
        frames = self.env.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Attribute of the environment, once for each index."""
        found = getattr(self._holder(attr_name), attr_name)
        return [found for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment, or of a wrapper that has it; all worlds share it.

        ``set_attr("criticality", 1.0)`` holds from the next reset of each world; other options are
        refused.
        """
        setattr(self._holder(attr_name), attr_name, value)

    def _holder(self, name: str) -> Any:
        """Return the outermost wrapper that has an attribute, the worlds if none has."""
        layer: Any = self.env
        while layer is not self.env.unwrapped and not hasattr(layer, name):
            layer = layer.env
        return layer

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment once for each index.

        Methods that take the index of a world as first argument are not filled in: pass it.
        """
        method = getattr(self._holder(method_name), method_name)
        return [method(*args, **kwargs) for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether each world is wrapped; episodes are monitored natively, as by ``Monitor``."""
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]


class AgentSB3VecEnv(SB3VecEnv):
    """The vehicles of an :class:`AgentVectorEnv` as rows of a stable-baselines3 ``VecEnv``.

    Every info holds ``active``, whether the row's vehicle is driven by the next action. The end of
    a wait is a done without ``episode``, so that statistics count driven episodes only.
    """

    env: AgentVectorEnv

    def step_wait(self) -> Any:
        """Step all worlds; observations [E x C, ...], rewards, dones [E x C], infos."""
        obs, rewards, dones, infos = super().step_wait()
        active = self.env.active_masks()
        for i, info in enumerate(infos):
            info["active"] = bool(active[i])
            if dones[i] and not info["played"]:
                del info["episode"]
        return obs, rewards, dones, infos


class SelectionSB3VecEnv(SB3VecEnv):
    """The worlds of an :class:`AdversarySelectionVectorEnv`, with masks for MaskablePPO."""

    env: AdversarySelectionVectorEnv

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method; ``action_masks`` gives the mask of each world."""
        if method_name != "action_masks":
            return super().env_method(method_name, *args, indices=indices, **kwargs)
        masks = self.env.action_masks()
        return [masks[i] for i in self._get_indices(indices)]
