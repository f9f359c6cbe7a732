"""The intelligent driver model: what can be chosen about it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["IdmConfig"]


@dataclass(frozen=True, kw_only=True)
class IdmConfig:
    """Parameters of the intelligent driver model (Treiber, Hennecke, Helbing 2000)."""

    #: Time headway, s, > 0.
    headway_s: float = 1.2
    #: Gap at standstill, m, >= 0.
    min_gap_m: float = 2.0
    #: Greatest acceleration, m/s², > 0.
    acceleration_mps2: float = 1.5
    #: Comfortable deceleration, m/s², > 0.
    deceleration_mps2: float = 2.5
    #: Hardest braking, m/s², > 0.
    max_braking_mps2: float = 8.0
    #: Acceleration exponent, > 0.
    exponent: float = 4.0
    #: Others are also looked for where they will be after this time, s, >= 0.
    anticipation_s: float = 1.0
