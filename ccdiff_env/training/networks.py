"""Training of planning networks."""

from __future__ import annotations

import csv
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ccdiff_env.errors import CheckpointError, ConfigError
from ccdiff_env.models.trajectory_model import TrajectoryModel, own_generator
from ccdiff_env.models.weights import require_networks
from ccdiff_env.scenes import Scene
from ccdiff_env.system.files import read_bytes, read_text, reading, write_aside
from ccdiff_env.system.progress import EVERY_S
from ccdiff_env.system.settings import keep_settings, kept_settings, refuse_others, sha256

if TYPE_CHECKING:
    from ccdiff_env import _models

_CHUNK = 20  #: Training steps between looks at the clock.
_COOLDOWN_SHARE = 0.2
LICENCE = "CC-BY-NC-SA-4.0"


def licence_of(*sources: object) -> dict[str, str]:
    """Return the note of weights that saw these sources: nuScenes is not for commercial use."""
    return {"licence": LICENCE} if any("nuscenes:" in str(place) for place in sources) else {}


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
    progress: bool = True,
) -> Path:
    """Train a planning network and write its weights.

    A run in ``out`` is resumed, exactly, with the settings it was started with; others are refused.
    The learning rate is constant and falls to zero over the last fifth of the steps or minutes. A
    run that has ended goes on if ``steps`` is more: the rate falls from its peak to zero over the
    added steps. A run that is interrupted, or diverges, keeps its last finite state.

    Args:
        scenes: Scenes to train on. Keep every validation scene out.
        out: Folder of the run: ``weights.safetensors`` (moving average, for use),
            ``state.safetensors`` (for resuming), ``run.json`` (settings and hashes), ``loss.csv``,
            ``validation.csv``.
        held_out: Scenes for the validation curve.
        model: Which network, one of :data:`ccdiff_env.traffic.NETWORKS` (docs/rivals.md).
        preset: ``"fast"``, or ``"paper"`` (``ccdiff`` and ``ctgpp`` alone).
        steps, minutes: When to stop; exactly one of them. Minutes count this call alone.
        device: ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.
        settings: Training settings that differ from the preset's, such as ``{"batch_scenes": 8,
            "seed": 1}``.
        network: Parts of the network that differ from the preset's, such as ``{"width": 128}`` or
            ``{"map": {"feature_width": 32}}``; the names are those of the weight file's header.
        teacher: Weights of a denoising network. The run begins with them and learns to make its
            plans in one denoising step instead of ``settings["teacher_steps"]`` (5): for
            ``denoising_steps=1``. Preset and network are the teacher's. A resumed run needs it
            again.
        start: Weights that the run begins with; preset and network are theirs. Parts that
            ``network`` adds to them begin fresh.
        notes: Kept in the weight file's header.
        checkpoint_minutes: Time between checkpoints and validations.
        progress: Whether to print step and loss; without a terminal, a line every ten seconds.

    Returns:
        Path: The weight file.

    Raises:
        ConfigError: A setting is out of range, no scene gives a sample, or the run in ``out`` is of
            other scenes, settings or weights.
        CheckpointError: The run in ``out`` is damaged.
    """
    if (steps is None) == (minutes is None):
        raise ConfigError("give steps or minutes, exactly one of them")
    length = steps if minutes is None else minutes
    if length is None or not 0 <= length < math.inf:
        raise ConfigError(f"steps or minutes: {length}, expected a number of at least 0")
    require_networks()
    from ccdiff_env import _models

    folder = Path(out)
    state, weights = folder / "state.safetensors", folder / "weights.safetensors"
    resumed = state.exists()
    with reading("training state", state, CheckpointError):
        config, training = (
            _models.training_settings(os.fspath(state))
            if resumed
            else _models.model_preset(preset, model)
        )
    given = {
        "model": model,
        "scenes": sha256(*(scene.hash for scene in scenes)),
        "held_out": sha256(*(scene.hash for scene in held_out)),
        "teacher": None if teacher is None else _digest(teacher),
        **({} if start is None else {"start": _digest(start)}),
    }
    if not resumed and teacher is not None:
        config = json.dumps(TrajectoryModel(teacher).header["model"])
        settings = {"teacher_steps": 5, "learning_rate": 3e-4, **(settings or {})}
    elif not resumed and start is not None:
        config = json.dumps({**json.loads(config), **TrajectoryModel(start).header["model"]})
    was = {"training": json.loads(training), "network": json.loads(config)}
    changed = {
        "training": _merge("training setting", was["training"], settings or {}),
        "network": _merge("part of the network", was["network"], network or {}),
    }
    if resumed:
        kept_settings(folder / "run.json", given)
        refuse_others(folder, {"model": was["network"]["kind"], **was}, {"model": model, **changed})
    training, config = (json.dumps(changed[part]) for part in ("training", "network"))
    with own_generator(int(json.loads(training)["seed"])):
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
    keep_settings(folder / "run.json", given)
    notes = {"licence": LICENCE, "num_scenes": len(scenes), **(notes or {})}
    curves = Curves(folder, run.step)
    solver_steps, said = 5 if teacher is None else 1, ""

    def checkpoint() -> None:
        run.save(os.fspath(state))
        run.export(os.fspath(weights), json.dumps(notes))
        errors = run.validate(96, solver_steps=solver_steps, num_samples=5, guidance_weight=1.0)
        if errors is not None:
            curves.write("validation", run.step, errors)
            nonlocal said
            said = (
                f", minADE {errors['min_ade_m']:.2f} m, constant velocity "
                f"{errors['constant_velocity_ade_m']:.2f} m"
            )
            if "nats" in errors:
                said += f", {errors['nats']:.3f} nats, {errors['nats_untold']:.3f} without routes"

    begin = last = time.monotonic()
    first = run.step
    total = float(minutes or 0) * 60.0 if steps is None else float(max(steps - first, 0))
    told, live = begin, sys.stderr.isatty()
    try:
        while steps is None or run.step < steps:
            elapsed = time.monotonic() - begin
            if run.cooldown is not None and run.step >= run.cooldown[1]:
                if steps is None:
                    break
                run.cool_down(steps - run.step)
            count = _CHUNK if steps is None else min(_CHUNK, steps - run.step)
            if run.cooldown is None:
                _maybe_cool_down(run, first, steps, total, elapsed)
            if run.cooldown is not None:
                count = max(min(count, run.cooldown[1] - run.step), 1)
            losses = run.run(count)
            now = time.monotonic()
            loss = sum(losses) / len(losses)
            if progress and (live or now - told >= EVERY_S):
                line, told = f"step {run.step:,}, loss {loss:.3f}{said}", now
                print("\r" * live + line, end="" if live else "\n", file=sys.stderr, flush=True)
            curves.write("loss", run.step, {"loss": loss, "seconds": now - begin})
            if now - last > checkpoint_minutes * 60.0:
                checkpoint()
                last = time.monotonic()
    except BaseException:
        # also on Ctrl-C, so that nothing is lost; a run that diverged keeps its last finite state
        with suppress(CheckpointError):
            checkpoint()
        raise
    finally:
        if progress and live:
            print(file=sys.stderr)
    checkpoint()
    return weights


def _maybe_cool_down(
    run: _models.Trainer, first: int, steps: int | None, total_s: float, elapsed_s: float
) -> None:
    if steps is not None:
        if run.step >= steps - max(round(steps * _COOLDOWN_SHARE), 1):
            run.cool_down(steps - run.step)
    elif elapsed_s >= total_s * (1.0 - _COOLDOWN_SHARE):
        pace = elapsed_s / (run.step - first) if run.step > first else 1.0
        run.cool_down(max(int((total_s - elapsed_s) / pace), 1))


def _digest(weights: str | os.PathLike[str]) -> str:
    with reading("weights", weights, CheckpointError):
        return sha256(read_bytes(weights))


def _merge(what: str, preset: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    unknown = sorted(set(changes) - set(preset))
    if unknown:
        raise ConfigError(f"unknown {what} {unknown[0]!r}, expected one of {', '.join(preset)}")
    for key, value in changes.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{what} {key} is {value}, expected a number")
    parts = {
        key: {**preset[key], **value} if isinstance(value, dict) else value
        for key, value in changes.items()
    }
    return {**preset, **parts}


class Curves:
    """Loss and validation curves: CSV files."""

    def __init__(self, out: Path, step: int) -> None:
        self._out = out
        for path in (out / "loss.csv", out / "validation.csv"):
            if path.exists():  # a killed run wrote rows after its last checkpoint
                rows = [(row.split(",")[0], row) for row in read_text(path).splitlines(True)]
                kept = [row for at, row in rows if not at.isdigit() or int(at) <= step]
                write_aside(path, "".join(kept))

    def write(self, name: str, step: int, values: dict[str, float]) -> None:
        """Append a row to ``<name>.csv``."""
        path = self._out / f"{name}.csv"
        fresh = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", *values])
            writer.writerow([step, *(f"{v:.6g}" for v in values.values())])
