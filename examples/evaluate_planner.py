"""Bring your own planner: evaluate it beside log replay, constant velocity and IDM.

    python examples/evaluate_planner.py --traffic ccdiff --criticality 1

A planner is any function from observations to an action. The one below keeps its lane and brakes
for what is ahead; replace it.
"""

from __future__ import annotations

import argparse

import numpy as np

import ccdiff_env


class MyPlanner:
    """Follows the route and keeps two seconds to whoever is ahead in its way."""

    def __init__(self, env: ccdiff_env.EgoEnv) -> None:
        entries = {entry.name: entry for entry in env.worlds.layout.entries}
        self.agent = {name: i for i, name in enumerate(entries["agents"].columns)}
        self.route = {name: i for i, name in enumerate(entries["route"].columns)}
        self.ego = {name: i for i, name in enumerate(entries["ego"].columns)}

    def __call__(self, obs: dict[str, np.ndarray]) -> np.ndarray:
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
        return np.array([acceleration / (4.0 if acceleration > 0 else 8.0), turn], np.float32)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dataroot", help="nuScenes folder; embedded scenes without")
    parser.add_argument("--version", default="v1.0-mini")
    parser.add_argument("--split", default="mini_val")
    parser.add_argument("--traffic", default="idm")
    parser.add_argument("--criticality", type=float, default=0.0)
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


FIGURES = ("is_success", "collision", "at_fault", "off_road", "route_completion")


def episode(env: ccdiff_env.EgoEnv, scene: str, planner) -> dict[str, float]:
    obs, _ = env.reset(seed=0, options={"scene": scene})
    done = False
    while not done:
        action = env.action_space.sample() * 0 if planner is None else np.clip(planner(obs), -1, 1)
        obs, _, terminated, truncated, info = env.step(action)
        done = terminated or truncated
    return info["metrics"]


def main() -> None:
    args = arguments()
    if args.dataroot is None:
        scenes = ccdiff_env.embedded_scenes("val")
    else:
        scenes = ccdiff_env.load_nuscenes(args.dataroot, args.version, args.split)
    scenes = scenes[:2] if args.smoke else scenes
    options = {"scenes": scenes, "observation": "dict", "info": "end", "traffic": args.traffic}
    if args.traffic == "ccdiff":
        options["ccdiff"] = {"criticality": args.criticality}
    print(f"{len(scenes)} scenes, {args.traffic} traffic")
    print(f"  {'planner':18s}" + "".join(f"{name:>18s}" for name in FIGURES))
    for name in ("mine", "idm", "replay", "constant_velocity"):
        env = ccdiff_env.EgoEnv(driver="external" if name == "mine" else name, **options)
        planner = MyPlanner(env) if name == "mine" else None
        rows = [episode(env, scene.name, planner) for scene in scenes]
        means = [np.mean([row[figure] for row in rows]) for figure in FIGURES]
        print(f"  {name:18s}" + "".join(f"{mean:18.3f}" for mean in means))


if __name__ == "__main__":
    main()
