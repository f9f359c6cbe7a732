"""The reward that multiplies, against its formula on the figures of the step."""

from __future__ import annotations

import numpy as np
import pytest

from ccdiff_env import EgoEnv, WorldConfig
from ccdiff_env.bench.planner_score import COMFORT
from ccdiff_env.config import RewardConfig
from ccdiff_env.errors import ConfigError

WEIGHTS = RewardConfig()


def worth(info, limit_mps):
    """Factors of new progress: comfort, time to contact, speed, distance from the route."""
    limits = (COMFORT[name] for name in ("acceleration", "lateral_acceleration", "jerk"))
    figures = (info[name] for name in ("acceleration", "lateral_acceleration", "jerk"))
    calm = all(low <= x <= high for x, (low, high) in zip(figures, limits, strict=True))
    slow = 1.0 - max(info["speed"] - limit_mps, 0.0) / 5.0
    beside = min(abs(info["route_distance"]), 3.0) / 3.0
    return (0.5 + 0.5 * calm) * (0.5 + 0.5 * (info["ttc"] >= 0.95)) * slow * (1.0 - 0.5 * beside)


def test_new_progress_is_worth_less_where_driving_is_bad(scenes):
    options = {"scenes": scenes, "traffic": "idm", "speed_limit_mps": 5.0}
    env = EgoEnv(reward="product", on_off_road="ignore", **options)
    speed_limit = env.worlds.layout.entries[0].columns.index("speed_limit")
    seen = set()
    for seed in range(8):
        obs, _ = env.reset(seed=seed)
        rng, before, done = np.random.default_rng(seed), 0.0, False
        while not done:
            action = rng.uniform(-1, 1, 2) * [0.6, 0.05]
            obs, reward, terminated, truncated, info = env.step(action.astype(np.float32))
            limit = float(obs[speed_limit]) * 20.0
            factor = worth(info, limit)
            expected = WEIGHTS.progress * (info["progress"] - before) * max(factor, 0.0)
            assert info["reward_progress"] == pytest.approx(expected, abs=2e-4)
            assert info["reward_collision"] == WEIGHTS.collision * info["at_fault"]
            for name in ("comfort", "speed_limit", "lane_keeping"):
                assert info[f"reward_{name}"] == 0.0
            parts = sum(v for name, v in info.items() if name.startswith("reward_"))
            assert reward == pytest.approx(parts, abs=1e-4)
            before, done = info["progress"], terminated or truncated
            seen.add(round(factor, 1))
    assert len(seen) > 4


def test_forms_have_names():
    config = WorldConfig().with_options(reward="product")
    assert config.reward == RewardConfig(form="product")
    with pytest.raises(ConfigError, match=r"reward\.form"):
        WorldConfig().with_options(reward="produkt")
