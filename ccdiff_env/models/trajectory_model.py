"""A planning network that was loaded, and its plans of scenes."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import plain
from ccdiff_env.errors import CheckpointError, ConfigError
from ccdiff_env.models.weights import needs_torch, require_networks
from ccdiff_env.scenes import Scene
from ccdiff_env.system.fields import documented, shapes
from ccdiff_env.system.files import reading


@documented
@dataclass(frozen=True, eq=False, repr=False)
class ScenePlan:
    """Plans for the M vehicles of one scene at one step: N samples of T steps."""

    agents: npt.NDArray[np.int64]  #: Indices of the vehicles in the scene, ``[M]``.
    actions: npt.NDArray[np.float32]  #: Accelerations (m/s²), yaw rates (rad/s), ``[N, M, T, 2]``.
    #: x, y (m) and heading (rad) in the scene frame after each step, as those of
    #: :class:`~ccdiff_env.traffic.TrafficPlan`, ``[N, M, T, 3]``.
    samples: npt.NDArray[np.float32]
    speed_mps: npt.NDArray[np.float32]  #: Speeds along the heading after each step, ``[N, M, T]``.
    graph: npt.NDArray[np.bool_]  #: Decision causal graph: (i, j): j may influence i, ``[M, M]``.
    ttc_s: npt.NDArray[np.float32]  #: Times to contact, seconds, ``[M, M]``.
    #: Attention of vehicle i to vehicle j, zero outside of the graph, ``[M, M]``, if asked for.
    attention: npt.NDArray[np.float32] | None
    #: Sample that guidance selected for each vehicle, ``[M]``; 0 without guidance.
    selected_sample: npt.NDArray[np.int64]
    #: With guidance ``losses [J, N, M]`` of the objectives and ``moved_m [M]`` (by 2 s, metres; NaN
    #: where plans are moved before they are finished, or chosen).
    guidance: dict[str, npt.NDArray[np.float32]] | None

    __repr__ = shapes

    @classmethod
    def of(
        cls,
        *,
        states: npt.NDArray[np.float32],
        poses: npt.NDArray[np.float32],
        ttc: npt.NDArray[np.float32],
        **fields: Any,
    ) -> ScenePlan:
        """Return a plan from states [N, M, T, 6] in the vehicles' frames, which ``poses`` [M, 3]
        place in the scene.
        """
        x, y, speed_mps, yaw = np.moveaxis(states[..., :4].astype(np.float64), -1, 0)
        x0, y0, turned = poses.T[:, None, :, None].astype(np.float64)
        cos, sin = np.cos(turned), np.sin(turned)
        parts = x0 + cos * x - sin * y, y0 + sin * x + cos * y, turned + yaw
        samples = np.stack(parts, axis=-1).astype(np.float32)
        return cls(samples=samples, speed_mps=speed_mps.astype(np.float32), ttc_s=ttc, **fields)


def guidance_preset(name: str) -> dict[str, Any]:
    """Return the settings of a preset: ``"rl"``, the default, or ``"paper"``.

    docs/method.md says what they mean; every one of them may be changed.
    """
    settings: dict[str, Any] = json.loads(_native.guidance_preset(name))
    return settings


@contextmanager
def own_generator(seed: int) -> Iterator[None]:
    """Seed torch's generator for fresh weights and put the caller's back afterwards."""
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed % 2**64)
        yield


def _check(name: str, values: Iterable[int], most: int) -> None:
    """Refuse what is not from 0 to ``most``."""
    for value in values:
        if not 0 <= value <= most:
            raise ConfigError(f"{name} is {value}, expected 0 to {most}")


class TrajectoryModel:
    """A planning network loaded from a weight file.

    Args:
        path: A ``.safetensors`` file written by :func:`train`. Every tensor name and shape is
            checked; nothing is unpickled.
        device: ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.

    Raises:
        MissingFeatureError: The network needs torch (:func:`needs_torch`), which is not there.
        DatasetNotFoundError: There is no such file.
        CheckpointError: The file is damaged or does not fit; the message names the tensor or field.
    """

    def __init__(self, path: str | os.PathLike[str], *, device: str = "cpu") -> None:
        if not needs_torch(path, device):
            with reading("weights", path, CheckpointError):
                self._native = _native.load_network(os.fspath(path))
            return
        require_networks()
        from ccdiff_env import _models

        with reading("weights", path, CheckpointError), own_generator(0):
            self._native = _models.load_network(os.fspath(path), device)

    @property
    def header(self) -> dict[str, Any]:
        """The file's header: model and training settings, steps, notes on data and licence."""
        header: dict[str, Any] = json.loads(self._native.header)
        return header

    @property
    def num_parameters(self) -> int:
        """Numbers in the network."""
        return self._native.num_parameters

    def plan(
        self,
        scenes: Sequence[Scene],
        steps: Sequence[int],
        *,
        seeds: Sequence[int] | None = None,
        solver_steps: int | None = 5,
        num_samples: int = 1,
        guidance_weight: float = 1.0,
        guidance: str | Mapping[str, Any] | None = None,
        guided: Sequence[Sequence[int]] | None = None,
        attention: bool = False,
        follow_route: bool = False,
    ) -> list[ScenePlan]:
        """Plan for all vehicles of some scenes from their logged histories, in one batch.

        Args:
            scenes: Scenes; one may appear several times.
            steps: The current step in each.
            seeds: Noise seed of each; 0, 1, ... by default. A scene's noise depends on its own seed
                alone.
            solver_steps: Network evaluations of the DDIM sampler; ``None`` runs DDPM with all
                steps.
            num_samples: Samples N per plan.
            guidance_weight: w of (1 - w) unconditional + w conditional, in [1, 2); 1 skips the
                unconditional pass.
            guidance: Name of a preset or settings, see :func:`guidance_preset`; settings that are
                absent are those of ``"rl"``.
            guided: Agents of each scene whose plans are guided; needs ``guidance``.
            attention: Whether plans come with the attention between vehicles.
            follow_route: Whether the network knows where the vehicles go, as
                ``CcdiffConfig.follow_route``.

        Raises:
            ConfigError: A setting, a step or an agent is unknown or out of range; the message names
                it.
            ShapeError: There is not one entry per scene.
        """
        if (guidance is None) != (guided is None):
            raise ConfigError("give guidance and guided together, or neither")
        chosen = list(range(len(scenes))) if seeds is None else list(seeds)
        agents = [()] * len(scenes) if guided is None else guided
        for i, (scene, step, seed, own) in enumerate(
            zip(scenes, steps, chosen, agents, strict=False)
        ):
            last, most = scene.num_steps - 1, len(scene.agent_ids) - 1
            _check(f"steps[{i}]", [step], last)
            _check(f"seeds[{i}]", [seed], 2**64 - 1)
            _check(f"guided[{i}]", own, most)
        if isinstance(guidance, str):
            guidance = guidance_preset(guidance)
        plans = self._native.plan_scenes(
            list(scenes),
            list(steps),
            chosen,
            solver_steps=solver_steps,
            num_samples=num_samples,
            guidance_weight=guidance_weight,
            guidance=None if guidance is None else json.dumps(plain(guidance)),
            guided=None if guided is None else [list(g) for g in guided],
            attention=attention,
            follow_route=follow_route,
        )
        return [ScenePlan.of(**plan) for plan in plans]
