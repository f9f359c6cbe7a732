"""The file of an ego's policy: its weights, what it observes, what its actions mean."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import EgosConfig, WorldConfig
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, unknown
from ccdiff_env.system.files import parse_object, reading
from ccdiff_env.system.tensors import read_tensors

F32 = npt.NDArray[np.float32]

FORMAT = "ccdiff-env ego 1"
#: Options that a file of a policy may hold: what it observes, what its actions mean, how long.
FITTING = ("action", "bev", "decision_steps", "discrete", "dt_s", "dynamics", "grid", "observation")
_DATA = Path(__file__).resolve().parents[1] / "data"
#: Policies by name: two that change what a rule does, trained in recorded critical traffic, too, or
#: in log replay and IDM alone; and one without a rule, trained from nothing.
SHIPPED = {name: _DATA / f"{name}.safetensors" for name in ("ego", "ego_replay", "ppo")}

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
    """What a file says."""

    path: Path
    tensors: dict[str, F32]
    #: Fields of :class:`~ccdiff_env.config.WorldConfig`, some of :data:`FITTING`.
    options: dict[str, Any]
    schema: str  #: Digest of the meaning of observations.
    about: dict[str, Any]


def read_policy(name: str | os.PathLike[str]) -> PolicyFile:
    """Read a policy by name or path; :func:`ccdiff_env.planners.load` says what is raised."""
    path = SHIPPED.get(os.fspath(name), Path(name))
    if path.suffix == ".zip":
        raise ConfigError(
            f"policy {os.fspath(name)!r} is one of stable-baselines3, expected "
            f"{', '.join(SHIPPED)} or a .safetensors of ccdiff-env train-ego: traffic and further "
            "training take its network alone"
        )
    if path.suffix != ".safetensors":
        raise unknown("policy", os.fspath(name), SHIPPED)
    tensors, metadata = read_tensors(path)
    with reading("policy", path):
        if metadata.get("format") != FORMAT:
            found = metadata.get("format")
            raise DatasetError(f"format {found!r}, expected {FORMAT!r}")
        options, about = (parse_object(metadata[name]) for name in ("options", "about"))
        # others do not belong to a policy, and some name files, or modules to import
        if others := set(options) - set(FITTING):
            raise ValueError(f"options {sorted(others)}, expected some of {', '.join(FITTING)}")
        return PolicyFile(path, tensors, options, metadata["schema"], about)


def egos_parts(asked: EgosConfig, dt_s: float) -> tuple[str, str, int, dict[str, F32]]:
    """Return what native worlds with steps of ``dt_s`` make traffic of that a policy drives:
    observation, action (JSON), steps of a decision, tensors.

    Raises :class:`DatasetError` where there is no such file or it is damaged, :class:`ConfigError`
    where it fits neither the step nor this version.
    """
    found = read_policy(asked.policy)
    with reading("policy", found.path):
        config = WorldConfig().with_options(**found.options)
        if config.dt_s != dt_s:
            raise ConfigError(f"trained in steps of {config.dt_s} s, the worlds have {dt_s} s")
        whole = json.loads(config.to_json())
        observation, action = (json.dumps(whole[name]) for name in ("observation", "action"))
        tensors = {name: np.ascontiguousarray(array) for name, array in found.tensors.items()}
        return observation, action, config.decision_steps, tensors
