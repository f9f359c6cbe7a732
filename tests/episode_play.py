"""Everything that an environment returns, to compare two bit for bit."""

import numpy as np

from ccdiff_env import EgoEnv


def actions(steps: int) -> np.ndarray:
    """Random actions [T, 2], always the same ones."""
    return np.random.default_rng(5).uniform(-0.3, 0.5, (steps, 2)).astype(np.float32)


def played(env: EgoEnv, actions: np.ndarray) -> list[np.ndarray]:
    """Everything that an environment returns while it is given actions [T, 2]."""
    told = []
    for action in actions:
        obs, reward, *ends, info = env.step(action)
        told += [obs, np.float64(reward), np.array(ends)]
        told.append(np.array([v for v in info.values() if isinstance(v, float)]))
        if any(ends):
            break
    return told


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
