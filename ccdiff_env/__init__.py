"""Multi-agent driving environment on nuScenes scenes with causal-diffusion traffic."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ccdiff_env import _native as _native
from ccdiff_env import causal, config, errors, metrics, traffic
from ccdiff_env.bank import load_bank, record_bank
from ccdiff_env.certificate import Certificate
from ccdiff_env.config import WorldConfig
from ccdiff_env.embedded import embedded_scenes
from ccdiff_env.envs import (
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
from ccdiff_env.envs.replay import replay
from ccdiff_env.gpudrive import load_gpudrive
from ccdiff_env.recorder import Recorder
from ccdiff_env.rollout import Rollout, RolloutEvent
from ccdiff_env.scenes import Scene, SceneSet, load_nuscenes, load_scenarionet
from ccdiff_env.sources import load
from ccdiff_env.version import __version__
from ccdiff_env.view import notebook

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
    "Scene",
    "SceneSet",
    "WorldConfig",
    "__version__",
    "aec_env",
    "causal",
    "config",
    "embedded_scenes",
    "errors",
    "load",
    "load_bank",
    "load_gpudrive",
    "load_nuscenes",
    "load_scenarionet",
    "make_vec",
    "metrics",
    "parallel_env",
    "record_bank",
    "replay",
]

#: Former names of classes, for one release.
_FORMER = {"RolloutPlan": "TrafficPlan"}
#: Parts that are imported when they are first named.
_LAZY = ("bench", "counterfactual", "models")

register()
notebook.install()


def __getattr__(name: str) -> Any:
    if name in _FORMER:
        return getattr(traffic, errors.renamed("class", name, _FORMER))
    if name in _LAZY:
        return import_module(f"ccdiff_env.{name}")
    raise AttributeError(f"module 'ccdiff_env' has no attribute {name!r}")
