"""Where nuplan-devkit is, and what replaces the packages of clouds and databases that it imports.

The devkit's modules of maps, planners and metrics import packages that read its database and its
maps from discs and clouds, which scenes of this package do not need. Those of :data:`STANDS_IN`
that are not installed become modules that can be imported and nothing else: a call into one raises
:class:`~ccdiff_env.errors.MissingFeatureError`.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import types
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

from ccdiff_env.errors import DatasetNotFoundError, MissingFeatureError

#: Variable of the environment: checkouts of nuplan-devkit and of planners, separated as in PATH.
VARIABLE = "CCDIFF_NUPLAN"
#: Packages that the devkit imports and that scenes of this package do without.
STANDS_IN = (
    "geopandas", "fiona", "pyogrio", "rasterio", "aiofiles", "aioboto3", "boto3", "botocore",
    "retry", "ujson", "hydra", "omegaconf", "urllib3",
)  # fmt: skip
INSTALL = "pip install 'ccdiff-env[nuplan]'"


class _Absent(type):
    """A name of a package that is not installed: can be passed on, not used."""

    def __getattr__(cls, name: str) -> Any:
        return _absent(f"{cls.__module__}.{cls.__name__}", name)

    def __call__(cls, *_: Any, **__: Any) -> Any:
        package = cls.__module__.partition(".")[0]
        raise MissingFeatureError(
            f"nuplan-devkit calls {cls.__module__}.{cls.__name__}: pip install {package}"
        )


def _absent(module: str, name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    if module == "retry":  # decorates functions while modules are imported
        return lambda *_, **__: lambda function: function
    return _Absent(name, (), {"__module__": module})


class _Finder(MetaPathFinder, Loader):
    """The last finder: finds modules of packages that no other one found."""

    def __init__(self, packages: frozenset[str]) -> None:
        self._packages = packages

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        known = name.partition(".")[0] in self._packages
        return ModuleSpec(name, self, is_package=True) if known else None

    def exec_module(self, module: types.ModuleType) -> None:
        found: Any = module
        found.__path__, found.__getattr__ = [], lambda name: _absent(module.__name__, name)


def checkouts() -> list[Path]:
    """Return the folders that :data:`VARIABLE` names; raises if one of them is no folder."""
    found = [Path(part) for part in os.environ.get(VARIABLE, "").split(os.pathsep) if part]
    if lost := [folder for folder in found if not folder.is_dir()]:
        raise DatasetNotFoundError(f"{VARIABLE} names {lost[0]}, which is no folder")
    return found


def find_devkit() -> None:
    """Make nuplan-devkit importable: from the checkouts that are named, else as installed.

    Raises:
        DatasetNotFoundError: If a folder that is named is not there.
        MissingFeatureError: If the devkit, or a package that it needs, is missing; names it.
    """
    named = [str(folder.resolve()) for folder in checkouts()]
    sys.path[:0] = [folder for folder in named if folder not in sys.path]
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        missing = frozenset(p for p in STANDS_IN if importlib.util.find_spec(p) is None)
        sys.meta_path.append(_Finder(missing))
    try:
        importlib.import_module("nuplan.planning.simulation.planner.abstract_planner")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "nuplan":
            raise MissingFeatureError(
                f"no nuplan-devkit ({error}): name your checkout by --nuplan or {VARIABLE}, or "
                "install it: https://github.com/motional/nuplan-devkit"
            ) from error
        raise MissingFeatureError(f"nuplan-devkit needs {error.name}: {INSTALL}") from error
