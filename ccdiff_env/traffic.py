"""What can be chosen about CCDiff traffic, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

__all__ = ["CcdiffConfig"]

Ranking: TypeAlias = Literal["cliques", "greedy", "distance", "first", "random", "gradient"]


@dataclass(frozen=True, kw_only=True)
class CcdiffConfig:
    """CCDiff as a driver: of the traffic (``traffic="ccdiff"``), or of the controlled agents.

    Plans are made for all worlds of a batch at once, anew every ``replan_steps``, and followed in
    between.
    """

    #: Weights: ``"fast"`` (shipped), or a safetensors file.
    weights: str = "fast"
    #: Where the network runs.
    device: Literal["cpu", "cuda"] = "cpu"
    #: Steps from one plan to the next n, 1 to 52.
    replan_steps: int = 5
    #: Network evaluations of the DDIM sampler, >= 1; DDPM with all 100 steps if ``None``.
    denoising_steps: int | None = 5
    #: Samples per plan N, >= 1.
    num_samples: int = 1
    #: Weight w of the conditional branch in classifier-free guidance, in [1, 2).
    cfg_weight: float = 1.0
    #: The decision causal graph G that the network sees; ``"full"`` joins all pairs (ablation).
    graph: Literal["causal", "full"] = "causal"
    #: Vehicles that are guided K; all if ``None``.
    num_guided: int | None = 5
    #: How they are found: cliques of the time-to-contact graph, greedy cliques on G times
    #: attention, cliques of the distance graph, the scene's order, a shuffle, agreement of the
    #: gradients of realism and guidance, or agent ids by scene name.
    ranking: Ranking | Mapping[str, tuple[str, ...]] = "cliques"
    #: Whether they are found anew at every plan, not only at the first one.
    rerank: bool = True
    #: Who drives the vehicles that are not guided.
    others: Literal["ccdiff", "idm", "replay"] = "ccdiff"
    #: Share of each move of the guidance that is made, >= 0: 0 is realistic traffic, 1 the guidance
    #: as configured. Worlds may be told another one at any time.
    criticality: float = 0.0
    #: Guidance: a preset (``"rl"``, ``"released"``, ``"paper"``) or settings, see
    #: :func:`ccdiff_env.models.guidance_preset`.
    guidance: str | Mapping[str, Any] = "rl"
    #: Whether only the K vehicles are moved by guidance; else all (ablation).
    mask_guidance: bool = True
    #: Contacts with whom count in the collision objectives: with the ego and vehicles driven from
    #: outside, or with anybody (paper).
    partners: Literal["ego", "all"] = "ego"
    #: Whether plans keep attention and gradient statistics, at some cost.
    explain: bool = False
    #: Vehicles that never move: those parked in the log, or those slower than 0.5 m/s at the start.
    frozen: Literal["parked", "standing"] = "parked"
