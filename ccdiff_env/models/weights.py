"""Weight files: which there are, and what computes them."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

from ccdiff_env import _native
from ccdiff_env.errors import CheckpointError, DatasetNotFoundError, MissingFeatureError
from ccdiff_env.system.files import reading
from ccdiff_env.traffic import KINDS

TORCH = "2.11.0"  #: The release of torch whose libtorch the networks are built with.
_DATA = Path(__file__).parents[1] / "data"
_RIVALS = "ccdiff_env_rivals"


def require_networks() -> None:
    """Load torch and the extension module of networks, both of which nothing else needs.

    Raises:
        MissingFeatureError: If torch is not there or is another release, or the package was built
            without networks; the message names the cure.
    """
    try:
        # torch comes first: it loads libtorch into the process, and the libraries that the
        # extension names then resolve to it. No rpath or LD_LIBRARY_PATH is needed.
        import torch
    except ModuleNotFoundError as error:
        raise MissingFeatureError(
            f"networks need torch {TORCH}: pip install 'ccdiff-env[models]'"
        ) from error
    if torch.__version__.split("+")[0] != TORCH:
        raise MissingFeatureError(
            f"networks need torch {TORCH}, found {torch.__version__}: "
            f"pip install 'ccdiff-env[models]', or use an environment of their own for them"
        )
    try:
        from ccdiff_env import _models as _loaded  # noqa: F401
    except ImportError as error:
        raise MissingFeatureError(
            f"networks cannot be loaded ({error}): was the package built without them? "
            f"With torch {TORCH} installed: pip install --no-build-isolation ."
        ) from error


def needs_torch(weights: str | os.PathLike[str], device: str = "cpu") -> bool:
    """Whether torch computes a network: on a graphics card, or with layers that own kernels lack.

    Shipped networks on the processor need no torch, and have the same bits on every machine, in
    every batch and on any number of threads.

    Raises:
        DatasetNotFoundError: There is no such file.
        MissingFeatureError: The file is one of CCDiff's rivals, whose package is not there.
        CheckpointError: The file is damaged or does not fit; the message names the tensor or field.
    """
    _require_rivals(Path(weights))
    with reading("weights", weights, CheckpointError):
        return device != "cpu" or _native.needs_torch(os.fspath(weights))


def shipped_weights(model: str = "ccdiff", *, one_step: bool = False, routes: bool = False) -> Path:
    """Return the weight file of the shipped ``fast`` network of a kind.

    It was taught to plan in ``one_step`` of denoising, may know the ``routes`` of its vehicles, or
    both. Those of CCDiff's rivals are in a package of their own (``ccdiff-env[rivals]``), and the
    path is of no file where it is absent or holds none of this network. Derived from nuScenes: CC
    BY-NC-SA 4.0, non-commercial (docs/model_card.md).
    """
    parts = [part for part, has in (("routes", routes), ("one_step", one_step)) if has]
    name = "_".join([model, *(parts or ["fast"])])
    path = _DATA / f"{name}.safetensors"
    return path if path.is_file() else _rivals() / path.name


def weight_files() -> list[Path]:
    """Return the weight files that are there, of CCDiff and its rivals, by name."""
    files = [file for folder in (_DATA, _rivals()) for file in folder.glob("*.safetensors")]
    return sorted(files, key=lambda file: file.name)


def _rivals() -> Path:
    """Return the folder of the rivals' weights: a clone's, or that of their package."""
    clone = _DATA.parents[1] / "tools" / "rivals" / _RIVALS
    spec = None if clone.is_dir() else find_spec(_RIVALS)
    return clone if spec is None or spec.origin is None else Path(spec.origin).parent


def _require_rivals(weights: Path) -> None:
    """Refuse weights of a rival that are not there."""
    if weights.parent == _rivals() and not weights.is_file():
        raise MissingFeatureError(
            f"weights {weights.stem} are not there: pip install 'ccdiff-env[rivals]', or train "
            f"them with ccdiff-env train --model {weights.stem.split('_')[0]}"
        )


def weights_path(
    weights: str | os.PathLike[str],
    model: str = "ccdiff",
    denoising_steps: int | None = 5,
    follow_route: bool = False,
) -> Path:
    """Return the file of weights of a kind given by name (``"fast"``) or path.

    Some have ``fast`` networks of their own for one denoising step, for routes, and for both.

    Raises:
        DatasetNotFoundError: There is no such file.
        MissingFeatureError: The network is a rival of CCDiff whose package is not there.
    """
    if weights != "fast":
        _require_rivals(Path(weights))
        if not Path(weights).is_file():
            raise DatasetNotFoundError(f'weights: no file {weights}; "fast" is the shipped network')
        return Path(weights)
    known = KINDS[model].weights
    one_step = "one_step" in known and denoising_steps == 1
    path = shipped_weights(model, one_step=one_step, routes="routes" in known and follow_route)
    _require_rivals(path)
    return path
