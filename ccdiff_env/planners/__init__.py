"""Policies that come with the package, and those of files."""

from __future__ import annotations

import os

from ccdiff_env.planners.ego import EgoPolicy
from ccdiff_env.system.files import reading
from ccdiff_env.worlds.policy_file import SHIPPED, read_policy

__all__ = ["SHIPPED", "EgoPolicy", "load"]


def load(name: str | os.PathLike[str]) -> EgoPolicy:
    """Return a policy of :data:`SHIPPED` by name, or that of a safetensors file.

    Raises:
        DatasetNotFoundError, DatasetError: If there is no such file, or it is damaged.
        ConfigError: If the observations that this version makes are not those that it was trained
            on.

    Examples:
        >>> import ccdiff_env.planners
        >>> ego = ccdiff_env.planners.load("ego")
        >>> env = ccdiff_env.make_vec(2, scenes="val", traffic="idm", **ego.env_options)
        >>> obs, _ = env.reset(seed=0)
        >>> ego.act(obs).shape
        (2, 2)
    """
    found = read_policy(name)
    with reading("policy", found.path):
        return EgoPolicy(found)
