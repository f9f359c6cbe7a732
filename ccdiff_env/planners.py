"""Planners of the ego: policies of the world by name, functions, policies saved to a file."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import unknown
from ccdiff_env.errors import DatasetError, DatasetNotFoundError, MissingFeatureError
from ccdiff_env.traffic import driver_names

__all__ = ["Act", "Ego", "ego_driver", "load_sb3"]

#: From flat observations [N, D] to actions [N, W], or indices [N].
Act: TypeAlias = Callable[[npt.NDArray[np.float32]], npt.NDArray[Any]]


class _Predicts(Protocol):
    """A policy of stable-baselines3."""

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[Any, Any]:
        """Return actions and states."""


#: A driver of the world by name, a function, a policy with ``predict``, or a file of one.
Ego: TypeAlias = str | os.PathLike[str] | Act | _Predicts

_WORLD_DRIVERS = driver_names()
#: Part of a policy class's module, and the algorithm that loads it.
_ALGORITHMS = {
    "sac": "SAC",
    "td3": "TD3",
    "dqn": "DQN",
    "common": "PPO",
}


def load_sb3(path: str | os.PathLike[str]) -> Act:
    """Load a policy that stable-baselines3 saved (PPO, A2C, SAC, TD3, DQN).

    Files of stable-baselines3 hold pickles: load files that you trust only.

    Raises
    ------
    DatasetNotFoundError
        If there is no such file.
    DatasetError
        If it is no file of stable-baselines3.
    MissingFeatureError
        If stable-baselines3 is not installed.
    """
    if not Path(path).is_file():
        raise DatasetNotFoundError(f"no policy at {os.fspath(path)}")
    try:
        with zipfile.ZipFile(path) as file:
            data = json.loads(file.read("data"))
        module = str(data["policy_class"]["__module__"]).split(".")[1]
        algorithm = _ALGORITHMS[module]
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, IndexError) as error:
        message = f"no policy of stable-baselines3 ({error}): {os.fspath(path)}"
        raise DatasetError(message) from None
    try:
        import stable_baselines3
    except ImportError as error:
        raise MissingFeatureError(
            "policies of stable-baselines3 need it: pip install stable-baselines3"
        ) from error
    return _acting(getattr(stable_baselines3, algorithm).load(path, device="cpu"))


def _acting(policy: _Predicts) -> Act:
    def act(obs: npt.NDArray[np.float32]) -> npt.NDArray[Any]:
        return np.asarray(policy.predict(obs, deterministic=True)[0])

    return act


def ego_driver(ego: Ego) -> tuple[str, Act | None]:
    """Return the driver of the ego's slot, and the function that makes its actions if it needs one.

    Parameters
    ----------
    ego
        ``"replay"``, ``"idm"``, ``"constant_velocity"`` or ``"ccdiff"``; a function from
        observations [N, D] to actions [N, ...]; an object with ``predict`` as those of
        stable-baselines3; or the path of a policy that stable-baselines3 saved.

    Raises
    ------
    ConfigError
        For another name.
    """
    if isinstance(ego, str) and ego in _WORLD_DRIVERS:
        return ego, None
    if isinstance(ego, str) and not ego.endswith(".zip"):
        raise unknown("ego", ego, _WORLD_DRIVERS)
    if isinstance(ego, (str, os.PathLike)):
        return "external", load_sb3(ego)
    if hasattr(ego, "predict"):
        return "external", _acting(cast("_Predicts", ego))
    return "external", ego
