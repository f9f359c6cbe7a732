"""The original PDM-Closed decides beside ours, which drives: how near their accelerations are.

    CCDIFF_NUPLAN=<nuplan-devkit>:<tuplan_garage> PYTHONPATH=. \\
        python tests/pdm_beside_original.py nuscenes:<dataroot>@v1.0-mini

It is asked every half second, in log replay. Leaders are found at every step, which the original
has a switch for: its default lets every plan brake at first. Needs the packages of
`pip install 'ccdiff-env[nuplan]'`.
"""

import logging
import sys

import numpy as np

import ccdiff_env
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.interop.nuplan import nuplan_planner
from ccdiff_env.planners.rules import PdmClosed
from ccdiff_env.scenes import SceneSet
from ccdiff_env.worlds.worlds_view import behind

#: Way ahead that both have a line for, m; every how many steps the original is asked; where the
#: states of its tracker have the acceleration.
LEAST_LINE_M, EVERY, ACCELERATION_X = 90.0, 5, 5
FOUND: dict[str, list[tuple[float, float]]] = {}


class Both:
    """Ours drives, theirs is asked; the first decision of an episode makes theirs ready."""

    def __init__(self, worlds):
        self.worlds, self.ours = worlds, PdmClosed(worlds)
        self.theirs = nuplan_planner("nuplan:pdm_closed_planner")

    def reset(self, worlds, indices):
        self.theirs.reset(worlds, indices)

    def __call__(self, obs):
        driven, native = self.ours(obs), self.worlds.native
        for i in range(native.num_worlds):
            if native.slot_alive(i)[0] and native.status(i).elapsed_steps % EVERY == 0:
                known = i in self.theirs._drives
                scene_idx = behind(self.worlds).native.status(i).scene_idx
                scene = behind(self.worlds).scenes[scene_idx]
                drive, planner = self.theirs._drives.get(i) or self.theirs._begin(i)
                planner.compute_trajectory(drive.input())
                self._compare(i, FOUND.setdefault(scene.name, []), float(driven[i, 0]), known)
        return driven

    def _compare(self, i, found, ahead, known):
        planner = self.theirs._drives[i][1]
        generator, scorer = planner._generator, planner._scorer
        generator._leading_agent_update = 1
        best = int(np.argmax(scorer._aggregate_scores()))
        way_m = generator._state_idm_array[best, 0, 0]
        if known and planner._centerline.length - way_m > LEAST_LINE_M:
            ours = ahead * (4.0 if ahead > 0 else 8.0)
            found.append((ours, float(scorer._states[best, 1, ACCELERATION_X])))


def main(source):
    """Drive the scenes that have lanes in replayed traffic, and say how near decisions are."""
    logging.disable(logging.WARNING)
    scenes = [scene for scene in ccdiff_env.load(source) if scene.has_lanes]
    drive(SceneSet(scenes), Both, TRAFFIC["replay"], seed=0)
    FOUND["all"] = [one for found in FOUND.values() for one in found]
    for name, found in FOUND.items():
        if not found:
            continue
        apart = np.abs(np.subtract(*np.array(found).T))
        near = [f"{np.mean(apart <= m):.2f} within {m} m/s²" for m in (0.2, 0.5)]
        print(f"{name}: {', '.join(near)}, {len(found)} decisions", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
