"""The task of choosing who becomes adversarial: ``ccdiff_env/AdversarySelection-v0``."""

from __future__ import annotations

from ccdiff_env.envs.selection.batch import BASELINES
from ccdiff_env.envs.selection.options import SelectionReward
from ccdiff_env.envs.selection.single import AdversarySelectionEnv
from ccdiff_env.envs.selection.vector import AdversarySelectionVectorEnv

__all__ = [
    "BASELINES",
    "AdversarySelectionEnv",
    "AdversarySelectionVectorEnv",
    "SelectionReward",
]
