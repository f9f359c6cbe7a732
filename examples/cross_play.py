"""Every ego in every traffic: one table of collision rates and one of route completion.

    python examples/cross_play.py --egos idm replay runs/train_ego/ego.zip

Egos are planners of the world by name or policies saved by stable-baselines3.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import ccdiff_env
from ccdiff_env.policies.planners import ego_driver
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from

TRAFFIC = {
    "replay": {"traffic": "replay"},
    "idm": {"traffic": "idm"},
    "ccdiff": {"traffic": "ccdiff", "ccdiff": {"criticality": 0.0}},
    "critical": {"traffic": "ccdiff", "ccdiff": {"criticality": 1.0, "num_guided": 2}},
}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--egos", nargs="+", default=["constant_velocity", "idm", "replay"])
    parser.add_argument("--traffic", nargs="+", default=list(TRAFFIC), choices=list(TRAFFIC))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def play(scenes, ego: str, rules: dict, worlds: int) -> list[dict[str, float]]:
    """One episode per scene, many worlds at once."""
    driver, act = ego_driver(ego)
    rows = []
    for first in range(0, len(scenes), worlds):
        some = scenes[first : first + worlds]
        env = ccdiff_env.make_vec(
            len(some), scenes=some, driver=driver, info="end", autoreset_mode="next_step", **rules
        )
        obs, _ = env.reset(seed=0, options={"scene": list(range(len(some)))})
        if act is not None:
            act.begin(env.worlds)  # refuses worlds that the policy was not trained in
        nothing = np.zeros(env.action_space.shape, np.float32)
        found: dict[int, dict[str, float]] = {}
        while len(found) < len(some):
            actions = nothing if act is None else act(obs)
            obs, _, terminated, truncated, infos = env.step(actions)
            for i in np.flatnonzero(terminated | truncated):
                table = infos["metrics"]
                found.setdefault(i, {k: v[i] for k, v in table.items() if not k.startswith("_")})
        rows += [found[i] for i in range(len(some))]
    return rows


def main() -> None:
    args = arguments()
    scenes = scenes_from(args)
    rules = {name: dict(TRAFFIC[name]) for name in args.traffic}
    if args.smoke:
        scenes, args.egos = scenes[:2], ["idm", "constant_velocity"]
        for one in rules.values():
            one["horizon_steps"] = 15
    results = {
        (ego, name): play(scenes, ego, options, worlds=16)
        for ego in args.egos
        for name, options in rules.items()
    }
    for figure in ("collision", "at_fault", "off_road", "route_completion"):
        print(f"\n{figure}, mean of {len(scenes)} scenes")
        print(f"  {'ego':20s}" + "".join(f"{name:>10s}" for name in rules))
        for ego in args.egos:
            means = [np.mean([row[figure] for row in results[ego, name]]) for name in rules]
            shown = Path(ego).stem if ego.endswith(".zip") else ego
            print(f"  {shown:20s}" + "".join(f"{mean:10.3f}" for mean in means))


if __name__ == "__main__":
    main()
