"""Environments: Gymnasium's single and vector interface on the native worlds."""

from __future__ import annotations

from typing import Any

import gymnasium

from ccdiff_env.envs.single import EgoEnv
from ccdiff_env.envs.vector import EgoVectorEnv

__all__ = ["EGO_ID", "EgoEnv", "EgoVectorEnv", "make_vec", "register"]

#: Id of the ego environment in Gymnasium's registry.
EGO_ID = "ccdiff_env/Ego-v0"


def register() -> None:
    """Enter the environments in Gymnasium's registry."""
    if EGO_ID not in gymnasium.registry:
        gymnasium.register(
            EGO_ID,
            entry_point="ccdiff_env.envs.single:EgoEnv",
            vector_entry_point="ccdiff_env.envs.vector:EgoVectorEnv",
        )


def make_vec(num_envs: int = 1, **options: Any) -> EgoVectorEnv:
    """Return a native vector environment of E worlds.

    Parameters
    ----------
    num_envs
        Number of worlds E.
    **options
        As for :class:`EgoVectorEnv`: ``scenes``, ``traffic``, ``autoreset_mode``,
        ``observation``, ``info``, ``copy``, ``num_threads``, ``render_mode``, and every field of
        :class:`~ccdiff_env.config.WorldConfig`.
    """
    return EgoVectorEnv(num_envs, **options)
