"""Ego policies of files: a network over the rows of the observation, with all that it needs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env._native import EgoNetwork
from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, ShapeError
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.system.tensors import write_tensors
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.fit import Fit, fitting_fields, schema_digest
from ccdiff_env.worlds.policy_file import FITTING, FORMAT, PolicyFile

F32 = npt.NDArray[np.float32]

_LAYERS = ("encoder.0", "encoder.2", "policy.0", "policy.2", "policy.4")


def one_world(config: WorldConfig) -> Worlds:
    """Return a world of a configuration, which tells the layout of its observations."""
    return Worlds(embedded_scenes("val")[:1], config, num_worlds=1)


class EgoPolicy:
    """A trained ego, of what a file says."""

    def __init__(self, file: PolicyFile) -> None:
        #: Configuration of worlds that fit.
        self.config = WorldConfig().with_options(**file.options)
        #: How it was trained.
        self.about = file.about
        #: What it was trained in.
        self.fit = Fit(fitting_fields(self.config), "flat", file.schema)
        worlds = one_world(self.config)
        self.check(worlds)
        self.size = worlds.layout.size
        #: Weights by name, and ``mean`` and ``std`` [D] of observations.
        self.tensors = {name: np.ascontiguousarray(a) for name, a in file.tensors.items()}
        observation, action = (json.dumps(self.fit.options[n]) for n in ("observation", "action"))
        self._network = EgoNetwork(observation, action, self.tensors)

    @property
    def env_options(self) -> dict[str, Any]:
        """Keywords of :func:`ccdiff_env.make_vec` that fit; others may stand beside them."""
        return {"config": self.config}

    def check(self, worlds: Worlds) -> None:
        """Refuse worlds that give it something else with a :class:`ConfigError` that says what."""
        self.fit.check(worlds.config, worlds.native.layout_json, "policy")

    def act(self, obs: npt.NDArray[Any]) -> F32:
        """Return actions [N, A] in [-1, 1] for flat observations [N, D]; nothing is drawn.

        Raises:
            ShapeError: If the observations have another width.
        """
        given = np.asarray(obs, np.float32)
        if given.ndim != 2:
            raise ShapeError(f"policy: obs has shape {given.shape}, expected (N, {self.size})")
        return self._network.act(given)

    __call__ = act


def save_ego(
    path: str | os.PathLike[str],
    tensors: Mapping[str, Any],
    options: Mapping[str, Any],
    about: Mapping[str, Any],
) -> None:
    """Write a policy with all that it needs to a safetensors file.

    Args:
        path: File to write.
        tensors: State of the network as :mod:`ccdiff_env.training.ppo` has it, tensors or arrays.
        options: Fields of :class:`~ccdiff_env.config.WorldConfig` that fit the policy:
            :data:`FITTING`.
        about: How it was trained: what JSON can hold.

    Raises:
        ConfigError: If an option is none of these.
    """
    if others := set(options) - set(FITTING):
        raise ConfigError(
            f"policy: options {sorted(others)}, expected some of {', '.join(FITTING)}"
        )
    names = [f"{layer}.{part}" for layer in _LAYERS for part in ("weight", "bias")]
    names.append("mirror")
    kept = {name: np.asarray(tensors[name], np.float32) for name in names if name in tensors}
    kept["mean"] = np.asarray(tensors["mean"], np.float32)
    kept["std"] = np.sqrt(np.asarray(tensors["var"], np.float32) + np.float32(1e-4))
    config = WorldConfig().with_options(**options)
    metadata = {
        "format": FORMAT,
        "options": json.dumps(fitting_fields(config)),
        "schema": schema_digest(one_world(config).native.layout_json),
        "about": json.dumps(about),
    }
    write_tensors(path, kept, metadata)
