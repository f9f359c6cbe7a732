"""Policies that come with the package, and those of files."""

from __future__ import annotations

import os
from collections.abc import Mapping

from ccdiff_env.errors import ConfigError, unknown
from ccdiff_env.planners.ego import EgoPolicy, load_ego
from ccdiff_env.system.named_objects import option_values
from ccdiff_env.worlds.policy_file import NO_STYLE, SHIPPED

__all__ = ["SHIPPED", "EgoPolicy", "find_policy", "load"]


def load(name: str | os.PathLike[str], style: Mapping[str, float] = NO_STYLE) -> EgoPolicy:
    """Return a policy of :data:`SHIPPED` by name, or that of a safetensors file.

    ``style`` sets its dial, see :func:`~ccdiff_env.planners.ego.load_ego`.

    Examples:
        >>> import ccdiff_env.planners
        >>> ego = ccdiff_env.planners.load("ego")
        >>> env = ccdiff_env.make_vec(2, scenes="val", traffic="idm", **ego.env_options)
        >>> obs, _ = env.reset(seed=0)
        >>> ego.act(obs).shape
        (2, 2)
    """
    if isinstance(name, str) and name in SHIPPED:
        return load_ego(SHIPPED[name], style)
    if not os.fspath(name).endswith(".safetensors"):
        raise unknown("policy", os.fspath(name), SHIPPED)
    return load_ego(name, style)


def find_policy(planner: str) -> EgoPolicy | None:
    """Return the policy that the name of a planner stands for; ``None`` if it names none.

    ``ego.safetensors?comfort=4`` sets the dial of one that was trained for it.
    """
    path, _, options = planner.partition("?")
    if path not in SHIPPED and not path.endswith(".safetensors"):
        return None
    style = option_values(options, "policy", planner) if options else {}
    for name, factor in style.items():
        if not isinstance(factor, (int, float)):
            raise ConfigError(f"policy {planner!r}: {name} is {factor!r}, expected a number")
    return load(path, style)
