"""Multi-agent driving environment on nuScenes scenes with causal-diffusion traffic."""

from __future__ import annotations

# torch comes first: it loads libtorch into the process, and the extension's libraries then
# resolve to those by name. No rpath or LD_LIBRARY_PATH is needed.
import torch as _torch

_TORCH = "2.11.0"
if _torch.__version__.split("+")[0] != _TORCH:
    raise ImportError(
        f"ccdiff_env is built for torch {_TORCH}, found {_torch.__version__}: "
        f"pip install torch=={_TORCH}"
    )

from ccdiff_env import _native as _native  # noqa: E402
from ccdiff_env import causal, config, errors, metrics  # noqa: E402
from ccdiff_env.bank import load_bank, record_bank  # noqa: E402
from ccdiff_env.certificate import Certificate  # noqa: E402
from ccdiff_env.config import WorldConfig  # noqa: E402
from ccdiff_env.embedded import embedded_scenes  # noqa: E402
from ccdiff_env.envs import (  # noqa: E402
    AdversarySelectionEnv,
    AdversarySelectionVectorEnv,
    AgentVectorEnv,
    EgoEnv,
    EgoVectorEnv,
    aec_env,
    make_vec,
    parallel_env,
    register,
)
from ccdiff_env.envs.replay import replay  # noqa: E402
from ccdiff_env.recorder import Recorder  # noqa: E402
from ccdiff_env.rollout import Rollout, RolloutEvent, RolloutPlan  # noqa: E402
from ccdiff_env.scenes import Scene, SceneSet, load_nuscenes, load_scenarionet  # noqa: E402
from ccdiff_env.version import __version__  # noqa: E402
from ccdiff_env.view import notebook  # noqa: E402

__all__ = [
    "AdversarySelectionEnv",
    "AdversarySelectionVectorEnv",
    "AgentVectorEnv",
    "Certificate",
    "EgoEnv",
    "EgoVectorEnv",
    "Recorder",
    "Rollout",
    "RolloutEvent",
    "RolloutPlan",
    "Scene",
    "SceneSet",
    "WorldConfig",
    "__version__",
    "aec_env",
    "causal",
    "config",
    "embedded_scenes",
    "errors",
    "load_bank",
    "load_nuscenes",
    "load_scenarionet",
    "make_vec",
    "metrics",
    "parallel_env",
    "record_bank",
    "replay",
]

register()
notebook.install()
