"""The file of an ego's policy: its weights, what it observes, what its actions mean, its dial."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.config import EgosConfig, WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, unknown
from ccdiff_env.system.files import parsed_object, reading
from ccdiff_env.system.tensors import read_tensors

F32 = npt.NDArray[np.float32]
#: Lowest and highest factors of weights of the reward, by name.
Ranges: TypeAlias = Mapping[str, tuple[float, float]]

FORMAT = "ccdiff-env ego 1"
#: Options that a file of a policy may hold: what it observes, what its actions mean, how long.
FITTING = ("action", "bev", "decision_steps", "discrete", "dt_s", "dynamics", "grid", "observation")
NO_STYLE: Mapping[str, Any] = MappingProxyType({})
_DATA = Path(__file__).resolve().parents[1] / "data"
#: Policies by name: trained in recorded critical traffic, too; in log replay and IDM alone.
SHIPPED = {name: _DATA / f"{name}.safetensors" for name in ("ego", "ego_replay")}

LEARNED = "learned"  #: Name of the shipped choice of adversaries.


def adversary_policy_path(name: str) -> Path:
    """Return the file of a choice of adversaries, :data:`LEARNED` or a path: it must be there."""
    path = _DATA / "adversary_policy.safetensors" if name == LEARNED else Path(name)
    if not path.is_file():
        raise DatasetNotFoundError(
            f'adversary_policy: no file {name}, expected "{LEARNED}" or a .safetensors'
        )
    return path


class PolicyFile(NamedTuple):
    """What a file says, its dial set."""

    tensors: dict[str, F32]
    #: Fields of :class:`~ccdiff_env.config.WorldConfig`, some of :data:`FITTING`.
    options: dict[str, Any]
    schema: str  #: Digest of the meaning of observations, without the dial.
    about: dict[str, Any]
    styles: Ranges


def read_policy(path: str | os.PathLike[str], style: Mapping[str, float] = NO_STYLE) -> PolicyFile:
    """Read a file of a policy; :func:`~ccdiff_env.planners.ego.load_ego` says what is raised."""
    tensors, metadata = read_tensors(path)
    with reading("policy", path):
        if metadata.get("format") != FORMAT:
            found = metadata.get("format")
            raise DatasetError(f"format {found!r}, expected {FORMAT!r}")
        options, about = (parsed_object(metadata[name]) for name in ("options", "about"))
        # others do not belong to a policy, and some name files, or modules to import
        if others := set(options) - set(FITTING):
            raise ValueError(f"options {sorted(others)}, expected some of {', '.join(FITTING)}")
        ranges = parsed_object(metadata.get("styles", "{}")).items()
        styles = {str(name): (float(low), float(high)) for name, (low, high) in ranges}
        for name, factor in style.items():
            low, high = styles.get(name, (np.nan, np.nan))
            if not low <= factor <= high:
                known = ", ".join(f"{n} {a:g} to {b:g}" for n, (a, b) in styles.items())
                raise ConfigError(f"style: {name} is {factor}, expected {known or 'none'}")
        factors = np.array([style.get(name, 1.0) for name in styles], np.float32)
        tensors = _with_style(tensors, factors)
        return PolicyFile(tensors, options, metadata["schema"], about, styles)


def _with_style(tensors: Mapping[str, F32], factors: F32) -> dict[str, F32]:
    """Tensors of a policy that observes the factors last, as one for which they are constants."""
    found, size = dict(tensors), len(factors)
    if size:
        mean, std, weight = (found[name] for name in ("mean", "std", "policy.0.weight"))
        bias = found["policy.0.bias"]
        if not (std > 0.0).all():
            raise DatasetError(f"std is {std.min()}, expected above 0")
        if len(mean) != len(std) or bias.shape != weight.shape[:1] or len(mean) <= size:
            raise DatasetError(
                f"mean, std, policy.0 have shapes {mean.shape}, {std.shape}, {weight.shape}, "
                f"{bias.shape}, expected (D,), (D,), (N, M), (N,), D above {size}"
            )
        x = np.clip((factors - mean[-size:]) / std[-size:], -5.0, 5.0)
        # what is seen of other agents comes behind
        end = weight.shape[1] - len(found.get("encoder.2.bias", ()))
        dial = slice(end - size, end)
        found["policy.0.bias"] = bias + weight[:, dial] @ x
        found["mean"], found["std"] = mean[:-size], std[:-size]
        found["policy.0.weight"] = np.delete(weight, dial, axis=1)
    return found


def egos_policy(asked: EgosConfig, dt_s: float) -> object:
    """Return traffic of native worlds with steps of ``dt_s`` that a policy drives.

    Raises :class:`DatasetError` where there is no such file or it is damaged, :class:`ConfigError`
    where it fits neither the step, nor this version, nor the style.
    """
    path = SHIPPED.get(asked.policy, Path(asked.policy))
    if path.suffix != ".safetensors":
        raise unknown("policy", asked.policy, SHIPPED)
    found = read_policy(path, asked.style)
    with reading("policy", path):
        config = WorldConfig().with_options(**found.options)
        if config.dt_s != dt_s:
            raise ConfigError(f"trained in steps of {config.dt_s} s, the worlds have {dt_s} s")
        whole = json.loads(config.to_json())
        observation, action = (json.dumps(whole[name]) for name in ("observation", "action"))
        tensors = {name: np.ascontiguousarray(array) for name, array in found.tensors.items()}
        return _native.egos_policy(observation, action, config.decision_steps, tensors)
