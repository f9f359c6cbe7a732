"""Worlds that tests step: whatever happens, they go on to their last step."""

import numpy as np
from array_scenes import GOES_ON

from ccdiff_env.config import WorldConfig
from ccdiff_env.worlds import Worlds

FIELDS = ("position", "heading", "velocity", "active")


class Play:
    """A world of each scene, the ego following its log unless options say otherwise."""

    def __init__(self, scenes, traffic="ccdiff", *, seed=3, num_threads=1, **options):
        options = {**GOES_ON, "driver": "replay", "autoreset": "disabled", **options}
        config = WorldConfig().with_options(traffic=traffic, **options)
        count = len(scenes)
        self.worlds = Worlds(scenes, config, num_worlds=count, num_threads=num_threads)
        self.native, self.out = self.worlds.native, self.worlds.arrays()
        self.native.reset([seed] * count, list(range(count)), None, self.out)
        self.nothing = np.zeros((count, 1, self.native.action_width), np.float32)

    def step(self, times=1):
        for _ in range(times):
            self.native.step(self.nothing, self.out)

    def states(self, world_idx=0):
        states = self.native.states(world_idx)
        return {name: states[name] for name in FIELDS}

    def positions(self, steps):
        """Positions of all agents [A, 2] in each world after each of so many steps."""
        found = []
        for _ in range(steps):
            self.step()
            worlds = range(self.worlds.num_worlds)
            found.append([self.native.states(i)["position"].copy() for i in worlds])
        return found
