"""Planning networks, CCDiff and its rivals: training, loading, planning."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import (
    CheckpointError,
    ConfigError,
    DatasetNotFoundError,
    MissingFeatureError,
)
from ccdiff_env.models.curves import Curves
from ccdiff_env.models.training_loop import run_training
from ccdiff_env.scenes import Scene
from ccdiff_env.system.files import reading
from ccdiff_env.traffic import KINDS

__all__ = [
    "ScenePlan",
    "TrajectoryModel",
    "guidance_preset",
    "require_networks",
    "shipped_weights",
    "train",
]

#: The release of torch whose libtorch the networks are built with.
TORCH = "2.11.0"
WEIGHTS = "weights.safetensors"
STATE = "state.safetensors"
LICENCE = "CC-BY-NC-SA-4.0"
_DATA = Path(__file__).parents[1] / "data"
_RIVALS = "ccdiff_env_rivals"


def require_networks() -> None:
    """Load torch and the extension module of networks, both of which nothing else needs.

    Raises
    ------
    MissingFeatureError
        If torch is not there or is another release, or the package was built without networks; the
        message names the cure.
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

    Raises
    ------
    DatasetNotFoundError
        There is no such file.
    MissingFeatureError
        The file is one of CCDiff's rivals, whose package is not there.
    CheckpointError
        The file is damaged or does not fit; the message names the tensor or field.
    """
    _require_rivals(Path(weights))
    with reading("weights", weights, CheckpointError):
        return device != "cpu" or _native.needs_torch(os.fspath(weights))


def shipped_weights(model: str = "ccdiff", *, one_step: bool = False, routes: bool = False) -> Path:
    """Return the weight file of the shipped ``fast`` network of a kind.

    With ``one_step`` that of the network which was taught to plan in one denoising step, with
    ``routes`` that of the network which may know where its vehicles go, with both that of the
    network which was taught both.

    Those of CCDiff's rivals are in a package of their own (``ccdiff-env[rivals]``), and the path
    may be of no file where it is absent.

    Derived from nuScenes: CC BY-NC-SA 4.0, non-commercial (docs/model_card.md).
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
    """Refuse weights of a package that is not there."""
    if weights.parent == _rivals() and not weights.is_file():
        raise MissingFeatureError(
            f"weights {weights.stem} are in a package of their own: "
            "pip install 'ccdiff-env[rivals]'"
        )


def guidance_preset(name: str) -> dict[str, Any]:
    """Return the settings of a preset: ``"paper"``, ``"released"``, ``"rl"``, ``"strive_target"``.

    docs/method.md says what they mean; every one of them may be changed.
    """
    settings: dict[str, Any] = json.loads(_native.guidance_preset(name))
    return settings


def weights_path(
    weights: str | os.PathLike[str],
    model: str = "ccdiff",
    denoising_steps: int | None = 5,
    follow_route: bool = False,
) -> Path:
    """Return the file of weights of a kind given by name (``"fast"``) or path.

    Some have ``fast`` networks of their own for one denoising step, for routes, and for both.

    Raises
    ------
    DatasetNotFoundError
        There is no such file.
    MissingFeatureError
        The network is a rival of CCDiff whose package is not there.
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


@dataclass(frozen=True)
class ScenePlan:
    """Plans for the vehicles of one scene at one step.

    Attributes
    ----------
    agents
        Indices in the scene of the M planned vehicles, ``[M]``.
    actions
        Accelerations (m/s²) and yaw rates (rad/s), ``[N, M, T, 2]``.
    states
        x, y (m), speed (m/s), yaw (rad) and the actions, ``[N, M, T, 6]``, each vehicle in its own
        frame at the step: origin at its centre, +x along its heading.
    poses
        x, y (m) and heading (rad) of those frames in the scene, ``[M, 3]``.
    graph
        The decision causal graph G, ``[M, M]``; entry (i, j): j may influence i.
    ttc
        Times to contact, seconds, ``[M, M]``.
    attention
        Attention of vehicle i to vehicle j, zero outside of G, ``[M, M]``; ``None``
        if not asked for.
    selected_sample
        Sample that guidance selected for each vehicle, ``[M]``; 0 without guidance.
    guidance
        ``losses [J, N, M]`` of the objectives, ``realism_cost [M]`` (C(τ), total variation in
        [0, 1]), ``shift_sigmas [M]`` (the same in standard deviations) and, if asked for,
        ``alignment``, ``gradient_cosine``, ``conflict_share`` ``[M]`` and
        ``objective_cosine [J, J]``; ``None`` without guidance.
    """

    agents: npt.NDArray[np.int64]
    actions: npt.NDArray[np.float32]
    states: npt.NDArray[np.float32]
    poses: npt.NDArray[np.float32]
    graph: npt.NDArray[np.bool_]
    ttc: npt.NDArray[np.float32]
    attention: npt.NDArray[np.float32] | None
    selected_sample: npt.NDArray[np.int64]
    guidance: dict[str, npt.NDArray[np.float32]] | None

    def positions(self) -> npt.NDArray[np.float32]:
        """Return the planned centres in the scene frame, metres, ``[N, M, T, 2]``."""
        x, y, heading = (self.poses[:, k][None, :, None] for k in range(3))
        ahead, left = self.states[..., 0], self.states[..., 1]
        cos, sin = np.cos(heading), np.sin(heading)
        return np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1)


class TrajectoryModel:
    """A planning network loaded from a weight file.

    Parameters
    ----------
    path
        A ``.safetensors`` file written by :func:`train`. Every tensor name and shape is checked;
        nothing is unpickled.
    device
        ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.

    Raises
    ------
    MissingFeatureError
        The network needs torch (:func:`needs_torch`), which is not there.
    DatasetNotFoundError
        There is no such file.
    CheckpointError
        The file is damaged or does not fit; the message names the tensor or field.
    """

    def __init__(self, path: str | os.PathLike[str], *, device: str = "cpu") -> None:
        if not needs_torch(path, device):
            with reading("weights", path, CheckpointError):
                self._native = _native.load_network(os.fspath(path))
            return
        require_networks()
        from ccdiff_env import _models

        with reading("weights", path, CheckpointError), _own_generator(0):
            self._native = _models.load_network(os.fspath(path), device)

    @property
    def header(self) -> dict[str, Any]:
        """The file's header: model and training settings, steps, notes on data and licence."""
        header: dict[str, Any] = json.loads(self._native.header)
        return header

    @property
    def num_parameters(self) -> int:
        """Numbers in the network."""
        return self._native.num_parameters

    def plan(
        self,
        scenes: Sequence[Scene],
        steps: Sequence[int],
        *,
        seeds: Sequence[int] | None = None,
        solver_steps: int | None = 5,
        num_samples: int = 1,
        guidance_weight: float = 1.0,
        guidance: str | Mapping[str, Any] | None = None,
        guided: Sequence[Sequence[int]] | None = None,
        collision_targets: Sequence[Sequence[int]] | None = None,
        attention: bool = False,
        gradient_statistics: bool = False,
        follow_route: bool = False,
    ) -> list[ScenePlan]:
        """Plan for all vehicles of some scenes from their logged histories, in one batch.

        Parameters
        ----------
        scenes
            Scenes; one may appear several times.
        steps
            The current step in each.
        seeds
            Noise seed of each; 0, 1, ... by default. A scene's noise depends on its own seed alone.
        solver_steps
            Network evaluations of the DDIM sampler; ``None`` runs DDPM with all steps.
        num_samples
            Samples N per plan.
        guidance_weight
            w of (1 - w) unconditional + w conditional, in [1, 2); 1 skips the unconditional pass.
        guidance
            Name of a preset or settings, see :func:`guidance_preset`; settings that are absent are
            those of ``"released"``. Needs two solver steps or more.
        guided
            Agents of each scene whose plans are guided; needs ``guidance``.
        collision_targets
            If given, only contacts with these agents of each scene count in collision objectives.
        attention
            Whether plans come with the attention between vehicles.
        gradient_statistics
            Whether guided plans come with the statistics of gradients.
        follow_route
            Whether the network knows where the vehicles go, as ``CcdiffConfig.follow_route``.

        Raises
        ------
        ConfigError
            A setting is unknown or out of range; the message names it.
        ShapeError
            There is not one entry per scene.
        """
        if (guidance is None) != (guided is None):
            raise ConfigError("give guidance and guided together, or neither")
        chosen = list(range(len(scenes))) if seeds is None else list(seeds)
        if isinstance(guidance, str):
            guidance = guidance_preset(guidance)
        plans = self._native.plan_scenes(
            list(scenes),
            list(steps),
            chosen,
            solver_steps=solver_steps,
            num_samples=num_samples,
            guidance_weight=guidance_weight,
            guidance=None if guidance is None else json.dumps(dict(guidance)),
            guided=None if guided is None else [list(g) for g in guided],
            collision_targets=(
                None if collision_targets is None else [list(rows) for rows in collision_targets]
            ),
            attention=attention,
            gradient_statistics=gradient_statistics,
            follow_route=follow_route,
        )
        return [ScenePlan(**plan) for plan in plans]


@contextmanager
def _own_generator(seed: int) -> Iterator[None]:
    """Seed torch's generator for fresh weights and put the caller's back afterwards."""
    import torch

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


def train(
    scenes: Sequence[Scene],
    *,
    out: str | os.PathLike[str],
    held_out: Sequence[Scene] = (),
    model: str = "ccdiff",
    preset: str = "fast",
    steps: int | None = None,
    minutes: float | None = None,
    device: str = "cpu",
    settings: dict[str, Any] | None = None,
    network: dict[str, Any] | None = None,
    teacher: str | os.PathLike[str] | None = None,
    start: str | os.PathLike[str] | None = None,
    notes: dict[str, Any] | None = None,
    checkpoint_minutes: float = 3.0,
    validation_samples: int = 96,
    progress: bool = True,
) -> Path:
    """Train a planning network and write its weights.

    A run in ``out`` is resumed, exactly, with the settings it was started with. The learning rate
    is constant and falls to zero over the last fifth of the steps or minutes.

    Parameters
    ----------
    scenes
        Scenes to train on. Keep every validation scene out.
    out
        Folder of the run: ``weights.safetensors`` (moving average, for use), ``state.safetensors``
        (for resuming), ``loss.csv``, ``validation.csv``, ``tensorboard/``.
    held_out
        Scenes for the validation curve.
    model
        Which network, one of :data:`ccdiff_env.traffic.NETWORKS` (docs/rivals.md).
    preset
        ``"fast"``, or ``"paper"`` (``ccdiff`` and ``ctgpp`` alone).
    steps, minutes
        When to stop; exactly one of them. Minutes count this call alone.
    device
        ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.
    settings
        Training settings that differ from the preset's, such as ``{"batch_scenes": 8, "seed": 1}``.
    network
        Parts of the network that differ from the preset's, such as ``{"width": 128}`` or
        ``{"map": {"encoder": "polylines"}}``; the names are those of the weight file's header.
    teacher
        Weights of a denoising network. The run begins with them and learns to make its plans in one
        denoising step instead of ``settings["teacher_steps"]`` (5): for ``denoising_steps=1``.
        Preset and network are the teacher's. A resumed run needs it again.
    start
        Weights that the run begins with; preset and network are theirs. Parts that ``network`` adds
        to them begin fresh.
    notes
        Kept in the weight file's header.
    checkpoint_minutes
        Time between checkpoints and validations.
    validation_samples
        Held-out (scene, step) pairs per validation.
    progress
        Whether to show a progress bar (needs tqdm).

    Returns
    -------
    Path
        The weight file.

    Raises
    ------
    ConfigError
        A setting is out of range, or no scene gives a sample.
    CheckpointError
        The run in ``out`` is damaged.
    """
    if (steps is None) == (minutes is None):
        raise ConfigError("give steps or minutes, exactly one of them")
    require_networks()
    from ccdiff_env import _models

    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    state = folder / STATE
    resumed = state.exists()
    with reading("training state", state, CheckpointError):
        config, training = (
            _models.training_settings(os.fspath(state))
            if resumed
            else _models.model_preset(preset, model)
        )
    if resumed and json.loads(config)["kind"] != model:
        raise ConfigError(f"model is {model!r}, but {folder} holds a run of another one")
    if not resumed:
        if teacher is not None:
            config = json.dumps(TrajectoryModel(teacher).header["model"])
            settings = {"teacher_steps": 5, "learning_rate": 3e-4, **(settings or {})}
        elif start is not None:
            config = json.dumps({**json.loads(config), **TrajectoryModel(start).header["model"]})
        training = json.dumps(_merged("training setting", json.loads(training), settings or {}))
        config = json.dumps(_merged("part of the network", json.loads(config), network or {}))
    with _own_generator(int(json.loads(training)["seed"])):
        run = _models.Trainer(
            list(scenes),
            list(held_out),
            config,
            training,
            device=device,
            stride=1,
            estimate=not resumed and teacher is None and start is None,
            teacher=None if teacher is None else os.fspath(teacher),
            start=None if resumed or start is None else os.fspath(start),
        )
    if resumed:
        with reading("training state", state, CheckpointError):
            run.resume(os.fspath(state))
            if run.step >= 2**63:
                raise CheckpointError(f"step is {run.step}")
    notes = {"licence": LICENCE, "num_scenes": len(scenes), **(notes or {})}
    curves = Curves(folder, run.step)
    try:
        run_training(
            run,
            (folder / STATE, folder / WEIGHTS),
            curves,
            steps,
            minutes,
            notes,
            checkpoint_minutes,
            validation_samples,
            progress,
            solver_steps=5 if teacher is None else 1,
        )
    finally:
        curves.close()
    return folder / WEIGHTS


def _merged(what: str, preset: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    unknown = sorted(set(changes) - set(preset))
    if unknown:
        raise ConfigError(f"unknown {what} {unknown[0]!r}, expected one of {', '.join(preset)}")
    parts = {
        key: {**preset[key], **value} if isinstance(value, dict) else value
        for key, value in changes.items()
    }
    return {**preset, **parts}
