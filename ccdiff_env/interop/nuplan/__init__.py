"""Planners of nuPlan: any class of its ``AbstractPlanner`` drives the ego unmodified.

nuplan-devkit itself is the user's: installed, or a checkout that ``CCDIFF_NUPLAN`` names. Nothing
here imports it before a planner is asked for. docs/nuplan.md shows the use.
"""

from __future__ import annotations

from typing import Any

from ccdiff_env.interop.nuplan.devkit import find_devkit
from ccdiff_env.interop.nuplan.settings import Settings

__all__ = ["PREFIX", "Settings", "nuplan_planner"]

#: What names of nuPlan's planners begin with.
PREFIX = "nuplan:"


def nuplan_planner(name: str) -> Any:
    """Return what drives the first slots of worlds by a planner of nuPlan.

    Parameters
    ----------
    name
        ``nuplan:package.module.Class``, or ``nuplan:`` and the name of a planner's settings, as
        nuPlan's ``planner=`` takes it (``nuplan:idm_planner``), or their file (``.yaml``); with
        ``?option=value&option=value`` after it, see :class:`Settings`.

    Returns
    -------
    NuPlanPlanner
        A :class:`~ccdiff_env.policies.planners.Planner` of worlds with delta-pose actions.

    Raises
    ------
    ConfigError
        If there is no such planner or option, or the planner asks for what scenes do not have.
    MissingFeatureError
        If there is no nuplan-devkit, or a package that it needs is missing.
    """
    find_devkit()
    settings = Settings.of(name)
    from ccdiff_env.interop.nuplan.driving import NuPlanPlanner

    return NuPlanPlanner(settings)
