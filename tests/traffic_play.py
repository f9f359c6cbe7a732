"""Worlds of planned traffic that tests step."""

from __future__ import annotations

import numpy as np

from ccdiff_env.config import WorldConfig
from ccdiff_env.worlds import Worlds

FIELDS = ("position", "heading", "velocity", "active")


class Play:
    """Worlds of CCDiff traffic, the ego following its log."""

    def __init__(self, scenes, seed=3, ccdiff=None, traffic="ccdiff", **options):
        options = {"driver": "replay", "on_collision": "ignore", **options}
        config = WorldConfig().with_options(
            traffic=traffic,
            ccdiff=ccdiff or {},
            on_off_road="ignore",
            terminate_at_goal=False,
            autoreset="disabled",
            **options,
        )
        self.worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=1)
        self.native, self.out = self.worlds.native, self.worlds.arrays()
        count = len(scenes)
        self.native.reset([seed] * count, list(range(count)), None, self.out)

    def step(self, times=1):
        nothing = np.zeros((self.worlds.num_worlds, 1, self.native.action_width), np.float32)
        for _ in range(times):
            self.native.step(nothing, self.out)

    def states(self, world_idx=0):
        states = self.native.states(world_idx)
        return {name: states[name] for name in FIELDS}
