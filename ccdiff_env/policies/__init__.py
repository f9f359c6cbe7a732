"""Policies that come with the package, and those of files."""

from __future__ import annotations

import os
from pathlib import Path

from ccdiff_env.config import unknown
from ccdiff_env.policies.ego import EgoPolicy, load_ego

__all__ = ["SHIPPED", "EgoPolicy", "find_policy", "load"]

_DATA = Path(__file__).resolve().parents[1] / "data"
_NAMES = ("ego", "ego_replay", "imitation", "pdm_open")
#: Policies by name: trained in recorded critical traffic, too; in log replay and IDM alone; on what
#: logged drivers did; on their next four seconds, without other agents.
SHIPPED = {name: _DATA / f"{name}.safetensors" for name in _NAMES}


def load(name: str | os.PathLike[str]) -> EgoPolicy:
    """Return a policy of :data:`SHIPPED` by name, or that of a safetensors file.

    Examples
    --------
    >>> import ccdiff_env.policies
    >>> ego = ccdiff_env.policies.load("ego")
    >>> env = ccdiff_env.make_vec(2, scenes="val", traffic="idm", **ego.env_options)
    >>> obs, _ = env.reset(seed=0)
    >>> ego.act(obs).shape
    (2, 2)
    """
    if isinstance(name, str) and name in SHIPPED:
        return load_ego(SHIPPED[name])
    if not os.fspath(name).endswith(".safetensors"):
        raise unknown("policy", os.fspath(name), SHIPPED)
    return load_ego(name)


def find_policy(planner: str) -> EgoPolicy | None:
    """Return the policy that the name of a planner stands for; ``None`` if it names none."""
    return load(planner) if planner in SHIPPED or planner.endswith(".safetensors") else None
