"""The task of choosing who becomes adversarial: ``ccdiff_env/AdversarySelection-v0``."""

from __future__ import annotations

from ccdiff_env.envs.selection.rules import RULES, fork_actions, rule_actions
from ccdiff_env.envs.selection.single import AdversarySelectionEnv
from ccdiff_env.envs.selection.vector import FEATURES, STRENGTHS, AdversarySelectionVectorEnv

__all__ = [
    "FEATURES",
    "RULES",
    "STRENGTHS",
    "AdversarySelectionEnv",
    "AdversarySelectionVectorEnv",
    "fork_actions",
    "rule_actions",
]
