"""Bring your own planner: evaluate it beside log replay, constant velocity and IDM.

    python examples/evaluate_planner.py --traffic ccdiff --criticality 1

docs/planners.md says what a planner is. The one below keeps its lane and brakes for what is ahead;
replace it. In its folder ``ccdiff-env bench planners --planners evaluate_planner:MyPlanner`` gives
the whole table with intervals and replays.
"""

from __future__ import annotations

import argparse

import numpy as np

from ccdiff_env.bench.intervals import mean_interval
from ccdiff_env.bench.planners import Traffic, play
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.worlds import Worlds


class MyPlanner:
    """Follows the route and keeps two seconds to whoever is ahead in its way."""

    observation = "dict"

    def __init__(self, worlds: Worlds) -> None:
        entries = {entry.name: entry for entry in worlds.layout.entries}
        self.agent = {name: i for i, name in enumerate(entries["agents"].columns)}
        self.route = {name: i for i, name in enumerate(entries["route"].columns)}
        self.ego = {name: i for i, name in enumerate(entries["ego"].columns)}

    def reset(self, worlds: Worlds, indices: np.ndarray) -> None:
        """A planner with a memory would forget the episodes of these worlds."""

    def __call__(self, obs: dict[str, np.ndarray]) -> np.ndarray:
        parts = [{name: part[i] for name, part in obs.items()} for i in range(len(obs["ego"]))]
        return np.array([self.act(one) for one in parts])

    def act(self, obs: dict[str, np.ndarray]) -> tuple[float, float]:
        """The action of one world."""
        speed = 20.0 * float(obs["ego"][self.ego["speed"]])  # scales: docs/observation.md
        target = 60.0 * obs["route"][min(2 + int(speed / 4), len(obs["route"]) - 1)]
        x, y = target[self.route["x"]], target[self.route["y"]]
        turn = 2.0 * y / max(x * x + y * y, 4.0) * speed
        others = 60.0 * obs["agents"][obs["agents_mask"] > 0]
        ahead = others[:, self.agent["x"]]
        beside = np.abs(others[:, self.agent["y"]])
        gaps = ahead[(ahead > 0) & (beside < 2.0)] - 5.0
        wanted = min(12.0, max(float(gaps.min()) / 2.0, 0.0) if gaps.size else 12.0)
        acceleration = np.clip((wanted - speed) / 1.0, -8.0, 2.0)
        # an action of +1 is 4 m/s², -1 is -8 m/s²; the yaw rate has 1 rad/s at 1
        throttle = acceleration / (4.0 if acceleration > 0 else 8.0)
        return float(np.clip(throttle, -1, 1)), float(np.clip(turn, -1, 1))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--traffic", default="idm")
    parser.add_argument("--criticality", type=float, default=0.0)
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


FIGURES = ("score", "success", "collision", "no_at_fault_collision", "on_road", "progress")


def main() -> None:
    args = arguments()
    scenes = scenes_from(args)
    scenes = scenes[:2] if args.smoke else scenes
    options = {"criticality": args.criticality} if args.traffic == "ccdiff" else {}
    traffic = Traffic(args.traffic, args.traffic, options)
    print(f"{len(scenes)} scenes, {args.traffic} traffic")
    print(f"  {'planner':18s}" + "".join(f"{name:>23s}" for name in FIGURES))
    for planner in (MyPlanner, "idm", "replay", "constant_velocity"):
        rows = play(scenes, planner, traffic)
        name = planner if isinstance(planner, str) else planner.__name__
        means = [mean_interval(rows, figure)[0] for figure in FIGURES]
        print(f"  {name:18s}" + "".join(f"{mean:23.3f}" for mean in means))


if __name__ == "__main__":
    main()
