"""Policies of stable-baselines3 and sb3-contrib: of files, as planners and by hand."""

from __future__ import annotations

import importlib
import io
import json
import os
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, MissingFeatureError
from ccdiff_env.system.files import read_bytes, reading
from ccdiff_env.worlds.fit import ATTRIBUTE, STATISTICS, Fit

if TYPE_CHECKING:
    from ccdiff_env.worlds import Worlds

_MOST_DATA_BYTES = 64 << 20  #: Bytes of the description in a file of stable-baselines3.
#: Part of a policy class's module; package and algorithm that loads it.
_ALGORITHMS = {
    "recurrent": ("sb3_contrib", "RecurrentPPO"),
    "maskable": ("sb3_contrib", "MaskablePPO"),
    "tqc": ("sb3_contrib", "TQC"),
    "sac": ("stable_baselines3", "SAC"),
    "td3": ("stable_baselines3", "TD3"),
    "dqn": ("stable_baselines3", "DQN"),
    "common": ("stable_baselines3", "PPO"),
    "ccdiff_env": ("stable_baselines3", "PPO"),
}


def algorithm_of(module: str) -> tuple[str, str]:
    """Return package and algorithm that load a policy whose class is in a module.

    Raises:
        ConfigError: If none does.
    """
    parts = module.split(".")
    for part, how in _ALGORITHMS.items():
        if part in parts:
            return how
    names = ", ".join(["A2C", *(name for _, name in _ALGORITHMS.values())])
    raise ConfigError(f"a policy class of {module[:80]} cannot be driven, expected one of {names}")


class Sb3Policy:
    """A policy of stable-baselines3, or of sb3-contrib, for the worlds' own observations.

    What ``VecNormalize`` did to them in the training is done here, by the statistics in the file.

    Args:
        model: The algorithm.
        name: What errors call it.

    Raises:
        ConfigError: If it does not say what it was trained in, or its statistics are missing.
    """

    def __init__(self, model: Any, name: str) -> None:
        self.model = model  #: The algorithm, which takes observations as they were in the training.
        #: What it was trained in.
        self.fit = Fit.read(getattr(model.observation_space, ATTRIBUTE, None), name)
        self.space = model.observation_space
        self._statistics = getattr(model, STATISTICS, None)
        last = None if self._statistics else getattr(model, "_last_obs", None)
        if last is not None and not _inside(model.observation_space, last):
            raise ConfigError(
                f"{name} was trained on normalised observations (VecNormalize), whose statistics "
                "are not in its file: save it with ccdiff_env.envs.sb3.save_policy"
            )
        self.observation = self.fit.form
        #: Configuration of worlds that fit.
        self.config = WorldConfig().with_options(**self.fit.options)
        self._state: Any = None
        self._starts: npt.NDArray[np.bool_] | None = None

    @property
    def env_options(self) -> dict[str, Any]:
        """Keywords of :func:`ccdiff_env.make_vec` that fit, beside :attr:`observation`."""
        return {"config": self.config}

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[Any], Any]:
        """Return actions [N, W], or indices [N], and states, as ``predict`` of the algorithm does.

        Args:
            observation: As the worlds give them, neither normalised nor clipped: [N, D], or
                dictionaries or rasters of N rows.
            state, episode_start: Of recurrent policies: what the last call returned, and the rows
                [N] that begin an episode.
            deterministic: Whether nothing is drawn.
        """
        if self._statistics is not None:
            mean, scale, clip = (np.asarray(part, np.float32) for part in self._statistics)
            observation = np.clip((observation - mean) / scale, -clip, clip)
        found: tuple[npt.NDArray[Any], Any] = self.model.predict(
            observation, state=state, episode_start=episode_start, deterministic=deterministic
        )
        return found

    def act(self, obs: Any) -> npt.NDArray[Any]:
        """Return actions [N, W], or indices [N], for observations of N worlds; nothing is drawn."""
        starts = None if self._starts is None else self._starts.copy()
        actions, self._state = self.predict(obs, self._state, starts)
        if self._starts is not None:
            self._starts[:] = False
        return np.asarray(actions)

    __call__ = act

    def reset(self, worlds: Worlds, indices: npt.NDArray[np.int64]) -> None:
        """Forget what a recurrent policy remembers of the episodes of some worlds."""
        if self._starts is None or len(self._starts) != worlds.num_worlds:
            self._state, self._starts = None, np.ones(worlds.num_worlds, np.bool_)
        self._starts[indices] = True


def _inside(space: Any, obs: Any) -> bool:
    """Whether a batch of observations lies in its space, but for rounding."""
    if isinstance(obs, dict):
        return all(_inside(space[name], part) for name, part in obs.items())
    low, high = getattr(space, "low", 0), getattr(space, "high", 1)
    return bool(((obs >= low - 1e-3) & (obs <= high + 1e-3)).all())


def read_sb3(path: str | os.PathLike[str]) -> Sb3Policy:
    """Read a policy that an algorithm of :data:`_ALGORITHMS` saved.

    Files of stable-baselines3 hold pickles, which run code: load files that you trust only.

    Raises:
        DatasetNotFoundError: If there is no such file.
        DatasetError: If it is no file of stable-baselines3.
        ConfigError: If the file does not say what the policy was trained in, its statistics are
            missing, or no algorithm is known that loads it.
        MissingFeatureError: If stable-baselines3 is not installed.
    """
    name = Path(path).name
    with reading("policy of stable-baselines3", path):
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as file:
            if file.getinfo("data").file_size > _MOST_DATA_BYTES:
                raise DatasetError(f"data of more than {_MOST_DATA_BYTES} bytes")
            data = json.loads(file.read("data"))
        package, algorithm = algorithm_of(str(data["policy_class"]["__module__"]))
        said = data["observation_space"].get(ATTRIBUTE)
    Fit.read(said, name)
    try:
        learners = importlib.import_module(package)
    except ImportError as error:
        raise MissingFeatureError(
            f"policies of {package} need it: pip install {package.replace('_', '-')}"
        ) from error
    try:
        model = getattr(learners, algorithm).load(path, device="cpu")
    except ModuleNotFoundError as error:
        other = "1" if str(error.name).startswith("numpy._core") else "2"
        why = f"it was saved under another NumPy than {other}" if "numpy" in str(error.name) else ""
        raise MissingFeatureError(
            f"policy {name}: its pickles need the module {error.name!r}; "
            f"{why or 'install it'}: load it where it was saved, or save it again there"
        ) from error
    return Sb3Policy(model, name)
