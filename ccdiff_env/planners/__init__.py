"""Policies that come with the package, and those of files."""

from __future__ import annotations

import os

from ccdiff_env.planners.ego import EgoPolicy
from ccdiff_env.planners.sb3_policy import Sb3Policy, read_sb3
from ccdiff_env.system.files import reading
from ccdiff_env.worlds.policy_file import SHIPPED, read_policy

__all__ = ["SHIPPED", "EgoPolicy", "Sb3Policy", "load", "load_ego"]


def load(name: str | os.PathLike[str]) -> EgoPolicy | Sb3Policy:
    """Return a policy of :data:`SHIPPED` by name, or that of a file.

    ``.safetensors`` is a file of ``ccdiff-env train-ego``, ``.zip`` one of stable-baselines3, which
    holds pickles that run code: load files that you trust only.

    Raises:
        DatasetNotFoundError, DatasetError: If there is no such file, or it is damaged.
        ConfigError: If the observations that this version makes are not those that it was trained
            on, or a file of stable-baselines3 does not say what they were.

    Examples:
        >>> import ccdiff_env.planners
        >>> ego = ccdiff_env.planners.load("ego")
        >>> env = ccdiff_env.make_vec(2, scenes="val", traffic="idm", **ego.env_options)
        >>> obs, _ = env.reset(seed=0)
        >>> ego.act(obs).shape
        (2, 2)
    """
    return read_sb3(name) if os.fspath(name).endswith(".zip") else load_ego(name)


def load_ego(name: str | os.PathLike[str]) -> EgoPolicy:
    """Return what :func:`load` does, except for files of stable-baselines3, which are refused."""
    found = read_policy(name)
    with reading("policy", found.path):
        return EgoPolicy(found)
