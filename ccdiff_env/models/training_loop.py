"""The loop of a training: steps, cool-down, checkpoints, curves."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ccdiff_env.models.curves import Curves
from ccdiff_env.system.progress import bar

if TYPE_CHECKING:
    from ccdiff_env import _models

__all__ = ["run_training"]

_CHUNK = 20
_COOLDOWN_SHARE = 0.2


def run_training(
    run: _models.Trainer,
    files: tuple[Path, Path],
    curves: Curves,
    steps: int | None,
    minutes: float | None,
    notes: dict[str, Any],
    checkpoint_minutes: float,
    validation_samples: int,
    progress: bool,
    solver_steps: int,
) -> None:
    """Run a training to its end, with checkpoints and validations every ``checkpoint_minutes``.

    ``files`` are state and weights; ``notes`` stand in the header of the weights. It stops at so
    many ``steps``, or after ``minutes`` of this call. ``validation_samples`` are held-out (scene,
    step) pairs, ``solver_steps`` the denoising steps of their plans.
    """
    state, weights = files
    begin = last = time.monotonic()
    first = run.step
    total = float(minutes or 0) * 60.0 if steps is None else float(max(steps - first, 0))
    shown = bar("s" if steps is None else "steps", progress)
    said = ""

    def checkpoint() -> None:
        run.save(os.fspath(state))
        run.export(os.fspath(weights), json.dumps(notes))
        errors = run.validate(
            validation_samples, solver_steps=solver_steps, num_samples=5, guidance_weight=1.0
        )
        if errors is not None:
            curves.write("validation", run.step, errors)
            nonlocal said
            said = (
                f", minADE {errors['min_ade_m']:.2f} m, constant velocity "
                f"{errors['constant_velocity_ade_m']:.2f} m"
            )
            if "nats" in errors:
                said += f", {errors['nats']:.3f} nats, {errors['nats_untold']:.3f} without routes"

    try:
        while True:
            elapsed = time.monotonic() - begin
            if steps is not None and run.step >= steps:
                break
            if run.cooldown is not None and run.step >= run.cooldown[1]:
                break
            if run.cooldown is None:
                _maybe_cool_down(run, first, steps, None if steps else total, elapsed)
            count = _CHUNK if steps is None else min(_CHUNK, steps - run.step)
            if run.cooldown is not None:
                count = max(min(count, run.cooldown[1] - run.step), 1)
            losses = run.run(count)
            now = time.monotonic()
            shown.update(count if steps is not None else now - begin - elapsed)
            loss = sum(losses) / len(losses)
            shown.set_postfix_str(f"step {run.step:,}, loss {loss:.3f}{said}")
            curves.write("loss", run.step, {"loss": loss, "seconds": now - begin})
            if now - last > checkpoint_minutes * 60.0:
                checkpoint()
                last = time.monotonic()
    finally:
        # also on Ctrl-C, so that nothing is lost
        checkpoint()
        shown.close()


def _maybe_cool_down(
    run: _models.Trainer, first: int, steps: int | None, total_s: float | None, elapsed_s: float
) -> None:
    if steps is not None:
        left = max(round(steps * _COOLDOWN_SHARE), 1)
        if run.step >= steps - left:
            run.cool_down(steps - run.step)
    elif total_s is not None and elapsed_s >= total_s * (1.0 - _COOLDOWN_SHARE):
        pace = elapsed_s / max(run.step - first, 1) if run.step > first else 1.0
        run.cool_down(max(int((total_s - elapsed_s) / pace), 1))
