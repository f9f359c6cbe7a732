"""Actions and models of motion, as frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

__all__ = [
    "DYNAMICS",
    "ActionConfig",
    "ActionGrid",
    "AssistedLimits",
    "BicycleLimits",
    "DeltaPoseLimits",
    "Dynamics",
    "UnicycleLimits",
]


@dataclass(frozen=True, kw_only=True)
class UnicycleLimits:
    """Limits of the unicycle: actions are acceleration (m/s²) and yaw rate (rad/s)."""

    #: Lowest and highest acceleration, m/s².
    acceleration_mps2: tuple[float, float] = (-10.0, 8.0)
    #: Lowest and highest speed, m/s. Vehicles brake to a stop and do not reverse.
    speed_mps: tuple[float, float] = (0.0, 30.0)
    #: Yaw rate that is allowed at any speed, rad/s, > 0.
    min_yaw_rate_radps: float = 0.1
    #: Highest yaw rate per speed, 1/m, > 0.
    max_curvature_1pm: float = 0.5
    #: Highest yaw rate times speed, m/s², > 0.
    max_lateral_acceleration_mps2: float = 6.2831855


@dataclass(frozen=True, kw_only=True)
class BicycleLimits:
    """Limits of the kinematic bicycle: actions are acceleration (m/s²) and steering angle (rad)."""

    #: Lowest and highest acceleration, m/s².
    acceleration_mps2: tuple[float, float] = (-10.0, 8.0)
    #: Lowest and highest speed, m/s. Vehicles brake to a stop and do not reverse.
    speed_mps: tuple[float, float] = (0.0, 30.0)
    #: Largest steering angle of the front wheel, rad, below π/2.
    max_steering_rad: float = 0.6
    #: Highest yaw rate times speed, m/s², > 0.
    max_lateral_acceleration_mps2: float = 6.2831855
    #: Wheelbase as a share of the length.
    wheelbase_share: float = 0.6


@dataclass(frozen=True, kw_only=True)
class DeltaPoseLimits:
    """Limits of one step of the delta-pose model: actions are dx, dy (m) and turn (rad)."""

    #: Least and most way forward per step, m.
    dx_m: tuple[float, float] = (-1.0, 4.0)
    #: Least and most way to the left per step, m.
    dy_m: tuple[float, float] = (-1.0, 1.0)
    #: Least and most turn to the left per step, rad.
    dheading_rad: tuple[float, float] = (-0.5, 0.5)


@dataclass(frozen=True, kw_only=True)
class AssistedLimits:
    """Limits of assisted driving: actions change what IDM would do on the route.

    The vehicle is a unicycle with IDM's acceleration plus a change, steered to a distance from its
    route; the action zero is IDM on the route.
    """

    #: Change of IDM's acceleration at -1 and +1, m/s².
    delta_mps2: tuple[float, float] = (-6.0, 2.0)
    #: Distance from the route at -1 and +1, m, left positive.
    offset_m: tuple[float, float] = (-1.5, 1.5)
    #: Lowest and highest acceleration, m/s².
    acceleration_mps2: tuple[float, float] = (-8.0, 2.4)
    #: The acceleration changes no faster than this, except where IDM brakes, m/s³, > 0.
    max_jerk_mps3: float = 8.0
    #: Lowest and highest speed, m/s.
    speed_mps: tuple[float, float] = (0.0, 30.0)


Dynamics: TypeAlias = UnicycleLimits | BicycleLimits | DeltaPoseLimits | AssistedLimits

DYNAMICS: dict[str, type[Dynamics]] = {
    "unicycle": UnicycleLimits,
    "bicycle": BicycleLimits,
    "delta_pose": DeltaPoseLimits,
    "assisted": AssistedLimits,
}


@dataclass(frozen=True, kw_only=True)
class ActionGrid:
    """Physical actions to choose from: every value of one axis with every value of the other.

    The action of an index is ``first[index // len(second)]``, ``second[index % len(second)]``.
    """

    #: Accelerations, m/s² (delta pose: dx, m).
    first: tuple[float, ...]
    #: Yaw rates, rad/s (bicycle: steering angles, rad; delta pose: turns, rad).
    second: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class ActionConfig:
    """Actions. Continuous ones are normalised: each column lies in [-1, 1], and zero means zero."""

    #: Model of motion with its limits; also by name or as ``{name: limits}``.
    dynamics: Dynamics = field(default_factory=UnicycleLimits)
    #: Whether actions are indices of ``grid``, not numbers.
    discrete: bool = False
    #: Physical actions to choose from; the dynamics' default 7 x 9 grid if ``None``.
    grid: ActionGrid | None = None
    #: Acceleration at +1, m/s², > 0.
    max_acceleration_mps2: float = 4.0
    #: Deceleration at -1, m/s², > 0.
    max_deceleration_mps2: float = 8.0
    #: Unicycle: yaw rate at +1, rad/s, > 0.
    max_yaw_rate_radps: float = 1.0
    #: Bicycle: front wheel angle at +1, rad, in (0, 1.5).
    max_steering_rad: float = 0.5
    #: Delta pose: displacement at +1, m per step, > 0.
    max_displacement_m: float = 3.0
    #: Delta pose: turn at +1, rad per step, > 0.
    max_turn_rad: float = 0.1
