"""Planners of nuPlan: any class of its ``AbstractPlanner`` drives the ego unmodified.

nuplan-devkit itself is the user's: installed, or a checkout that ``CCDIFF_NUPLAN`` names. Nothing
here imports it before a planner is asked for. docs/nuplan.md shows the use.
"""

from __future__ import annotations

from typing import Any

from ccdiff_env.interop.nuplan.devkit import find_devkit
from ccdiff_env.interop.nuplan.settings import Settings

__all__ = ["PREFIX", "Settings", "nuplan_planner"]

PREFIX = "nuplan:"  #: What names of nuPlan's planners begin with.


def nuplan_planner(name: str) -> Any:
    """Return what drives the first slots of worlds by a planner of nuPlan.

    ``nuplan:package.module.Class``, ``nuplan:`` and the name of a planner's settings, as nuPlan's
    ``planner=`` takes it, or their file (``.yaml``); ``?option=value&option=value`` may follow.

    Raises:
        ConfigError: If there is no such planner or option, or the planner asks for what scenes do
            not have.
        MissingFeatureError: If there is no nuplan-devkit, or a package that it needs is missing.
    """
    find_devkit()
    settings = Settings.of(name)
    from ccdiff_env.interop.nuplan.driving import NuPlanPlanner

    return NuPlanPlanner(settings)
