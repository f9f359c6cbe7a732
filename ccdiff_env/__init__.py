"""Multi-agent driving environment on nuScenes scenes with causal-diffusion traffic."""

from __future__ import annotations

from pathlib import Path

try:
    from ccdiff_env import _native as _native
except ImportError as error:
    if any(Path(__file__).parent.glob("_native.*[!i]")):
        raise
    raise ImportError(
        f"{Path(__file__).parent} is the source folder, without compiled modules, before an "
        "installed ccdiff_env on the path: leave this folder, or build them with make setup"
    ) from error
from ccdiff_env import config, errors, metrics
from ccdiff_env import traffic as traffic
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs import (
    AdversarySelectionEnv,
    AdversarySelectionVectorEnv,
    AgentVectorEnv,
    EgoEnv,
    EgoVectorEnv,
    aec_env,
    make_vec,
    parallel_env,
)
from ccdiff_env.envs.replay import replay
from ccdiff_env.metrics import causal
from ccdiff_env.record import counterfactual
from ccdiff_env.record.bank import load_bank, record_bank
from ccdiff_env.record.certificate import Certificate
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.record.rollout import Rollout, RolloutEvent
from ccdiff_env.scenes import Scene, SceneSet, load_nuscenes, load_scenarionet, map_queries
from ccdiff_env.scenes.embedded import embedded_scenes
from ccdiff_env.scenes.gpudrive import load_gpudrive
from ccdiff_env.scenes.py123d import load_py123d
from ccdiff_env.scenes.sources import load
from ccdiff_env.system.version import __version__
from ccdiff_env.view import notebook as notebook

__all__ = [
    "AdversarySelectionEnv", "AdversarySelectionVectorEnv", "AgentVectorEnv", "Certificate",
    "EgoEnv", "EgoVectorEnv", "Recorder", "Rollout", "RolloutEvent", "Scene", "SceneSet",
    "WorldConfig", "__version__", "aec_env", "causal", "config", "counterfactual",
    "embedded_scenes", "errors", "load", "load_bank", "load_gpudrive", "load_nuscenes",
    "load_py123d", "load_scenarionet", "make_vec", "map_queries", "metrics", "parallel_env",
    "record_bank", "replay",
]  # fmt: skip
