"""Costs of one's own: losses of guidance that are written in Python (docs/configuration.md)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import PolicyError, expect_shape
from ccdiff_env.system.named_objects import named_object

F32 = npt.NDArray[np.float32]


@lru_cache
def _function(name: str) -> Any:
    return named_object(name, "cost")


def evaluate(name: str, own_gradient: bool, states: F32, batch: dict[str, Any]) -> tuple[F32, F32]:
    """Call a cost, and return its losses [N, M] and their gradient [N, M, T, 4].

    Args:
        name: ``"module:function"``. It takes the last two, as torch tensors, and returns losses
            [N, M], which torch differentiates.
        own_gradient: Whether it takes arrays and returns losses and the gradient of their sum.
        states: [N, M, T, 4] of N samples, M vehicles, T steps: x, y (m), speed (m/s), heading (rad)
            in the scene frame.
        batch: What is known of the vehicles: ``pose`` [M, 3], ``speed_mps`` [M], ``size_m`` [M, 2]
            now, whether each is ``moving``, ``guided``, a ``target`` [M], and ``dt_s``.

    Raises:
        PolicyError: If the answer has another type or is not finite.
        ShapeError: If it has another shape.
    """
    losses: Any
    gradient: Any
    if own_gradient:
        losses, gradient = _function(name)(states, batch)
    else:
        import torch

        given = torch.from_numpy(states).requires_grad_()
        known = {
            key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
            for key, value in batch.items()
        }
        found = _function(name)(given, known)
        if not isinstance(found, torch.Tensor):
            raise PolicyError(f"cost {name!r} returns {type(found).__name__}, expected a tensor")
        losses, gradient = found.detach(), torch.zeros_like(given)
        if found.requires_grad:
            (of_states,) = torch.autograd.grad(found.sum(), given, allow_unused=True)
            gradient = gradient if of_states is None else of_states
    arrays = [np.ascontiguousarray(array, dtype=np.float32) for array in (losses, gradient)]
    expect_shape("losses", arrays[0], states.shape[:2])
    expect_shape("gradient", arrays[1], states.shape)
    if not all(np.isfinite(array).all() for array in arrays):
        raise PolicyError(f"cost {name!r} returns losses or a gradient that are not finite")
    return arrays[0], arrays[1]
