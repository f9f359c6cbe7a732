"""Environments: Gymnasium's single and vector interface on the native worlds."""

from __future__ import annotations

import multiprocessing
from typing import TYPE_CHECKING, Any

import gymnasium

from ccdiff_env.envs.agent_vector import AgentVectorEnv
from ccdiff_env.envs.selection import AdversarySelectionEnv, AdversarySelectionVectorEnv
from ccdiff_env.envs.single import EgoEnv
from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import MissingFeatureError

__all__ = [
    "EGO_ID", "SELECTION_ID", "AdversarySelectionEnv", "AdversarySelectionVectorEnv",
    "AgentVectorEnv", "EgoEnv", "EgoVectorEnv", "aec_env", "make_vec", "parallel_env",
]  # fmt: skip

EGO_ID = "ccdiff_env/Ego-v0"  #: Id of the ego environment in Gymnasium's registry.
#: Id of the selection of adversaries in Gymnasium's registry.
SELECTION_ID = "ccdiff_env/AdversarySelection-v0"


for _id, _single, _vector in (
    (EGO_ID, "single:EgoEnv", "vector:EgoVectorEnv"),
    (SELECTION_ID, "selection:AdversarySelectionEnv", "selection:AdversarySelectionVectorEnv"),
):
    if _id not in gymnasium.registry:
        gymnasium.register(
            _id,
            entry_point=f"{__name__}.{_single}",
            vector_entry_point=f"{__name__}.{_vector}",
        )

if "forkserver" in multiprocessing.get_all_start_methods():
    # Gymnasium reads no entry points since 1.0: workers of this start method, which is that of
    # stable-baselines3's SubprocVecEnv, know the ids because their server imports this package
    from multiprocessing import forkserver

    _server: Any = forkserver._forkserver
    if "ccdiff_env" not in _server._preload_modules:
        _server.set_forkserver_preload([*_server._preload_modules, "ccdiff_env"])

make_vec = EgoVectorEnv  #: The vector environment, by the name of Gymnasium's function.


if TYPE_CHECKING:
    from ccdiff_env.envs.parallel import MultiAgentEnv as parallel_env
else:

    def parallel_env(**options: Any) -> Any:
        """Return an environment of several vehicles, a PettingZoo ``ParallelEnv``.

        Args:
            **options: As for :class:`~ccdiff_env.envs.parallel.MultiAgentEnv`.

        Raises:
            MissingFeatureError: If PettingZoo is not installed.
        """
        try:
            from ccdiff_env.envs.parallel import MultiAgentEnv
        except ModuleNotFoundError as error:
            raise MissingFeatureError(
                "environments of several agents need PettingZoo: pip install pettingzoo"
            ) from error
        return MultiAgentEnv(**options)


def aec_env(**options: Any) -> Any:
    """Return the same environment as a PettingZoo ``AECEnv``, by PettingZoo's own conversion.

    Args:
        **options: As for :func:`parallel_env`.
    """
    env = parallel_env(**options)
    from pettingzoo.utils.conversions import parallel_to_aec

    return parallel_to_aec(env)
