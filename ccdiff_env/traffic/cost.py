"""Costs of one's own: losses of guidance that are written in Python (docs/configuration.md)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import PolicyError, expect_shape, raised_by
from ccdiff_env.system.named_objects import named_object

F32 = npt.NDArray[np.float32]


@lru_cache
def _function(name: str) -> Any:
    return named_object(name, "cost")


def evaluate(
    name: str, own_gradient: bool, moves: bool, states: F32, batch: dict[str, Any]
) -> tuple[F32, F32]:
    """Call a cost, and return its losses [N, M] and their gradient [N, M, T, 4].

    Args:
        name: ``"module:function"``. It takes the last two, as torch tensors, and returns losses
            [N, M], which torch differentiates.
        own_gradient: Whether it takes arrays and returns losses and the gradient of their sum.
        moves: Whether a gradient is needed; a choice among samples needs none.
        states: [N, M, T, 4] of N samples, M vehicles, T steps: x, y (m), speed (m/s), heading (rad)
            in the scene frame.
        batch: What is known of the vehicles: ``pose`` [M, 3], ``speed_mps`` [M], ``size_m`` [M, 2]
            now, whether each is ``moving``, ``guided``, a ``target`` [M], and ``dt_s``.

    Raises:
        PolicyError: If it raises, or if the answer has another type, is not finite, or has no
            gradient where one is needed.
        ShapeError: If it has another shape.
    """
    with raised_by(f"cost {name!r}", f"plans of shape {states.shape}"):
        answer = _asked(name, own_gradient, moves, states, batch)
        losses, gradient = (np.ascontiguousarray(array, dtype=np.float32) for array in answer)
    expect_shape("losses", losses, states.shape[:2])
    expect_shape("gradient", gradient, states.shape)
    if not (np.isfinite(losses).all() and np.isfinite(gradient).all()):
        raise PolicyError(f"cost {name!r} returns losses or a gradient that are not finite")
    return losses, gradient


def _asked(name: str, own_gradient: bool, moves: bool, states: F32, batch: dict[str, Any]) -> Any:
    if own_gradient:
        return _function(name)(states, batch)
    import torch

    given = torch.from_numpy(states).requires_grad_()
    arrays = {key: of for key, of in batch.items() if isinstance(of, np.ndarray)}
    known = batch | {key: torch.from_numpy(array) for key, array in arrays.items()}
    found = _function(name)(given, known)
    if not isinstance(found, torch.Tensor):
        raise PolicyError(f"cost {name!r} returns {type(found).__name__}, expected a tensor")
    gradient: Any = None if moves else torch.zeros_like(given)
    if moves and found.requires_grad:
        (gradient,) = torch.autograd.grad(found.sum(), given, allow_unused=True)
    if gradient is None:
        raise PolicyError(
            f"cost {name!r} returns losses that torch cannot differentiate by the states; where "
            "there is nothing to lose, return states.sum((2, 3)) * 0.0"
        )
    return found.detach(), gradient
