"""Which collisions of an ego could it have avoided: the others as recorded, and as they react.

    python examples/ways_out.py --dataroot <nuscenes> --split val --ego ego

The ego drives every scene in CCDiff traffic. From snapshots before its collisions, steady plans
are chosen in two futures of the traffic and tested in two others.
"""

from __future__ import annotations

import argparse

import numpy as np

from ccdiff_env import SceneSet, WorldConfig
from ccdiff_env.planners.built_in import ego_driver
from ccdiff_env.record.counterfactual import avoidability, rollout_avoidability
from ccdiff_env.record.episode import begin, play, recorders_of, world_of_seat
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.system.table import Column, Table
from ccdiff_env.worlds import Worlds

AFTER_S = 2.0
HEADS = ("criticality", "begins s before", "collisions")
FOUND = ("as recorded", "reacting", "held in other futures", "ego unchanged")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--ego", default="ego", help="a planner that makes actions of its own")
    parser.add_argument("--criticality", type=float, nargs="+", default=[1.0, 2.0])
    parser.add_argument("--before", type=float, nargs="+", default=[1.0, 3.0], help="seconds")
    parser.add_argument("--draws", type=int, default=2, help="futures that choose, and that test")
    parser.add_argument("--most", type=int, help="collisions to search at most (default: all)")
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def collisions(scenes, ego: str, **options):
    """Worlds that can be restored, and snapshots [T] and rollout of every collision of the ego."""
    _, seat = ego_driver(ego)
    config = world_of_seat(WorldConfig(), seat, ego, fixed_by="the search", dt_s=scenes[0].dt)
    config = config.with_options(traffic="ccdiff", autoreset="disabled", **options)
    for first in range(0, len(scenes), 25):
        some = SceneSet(scenes[first : first + 25])
        worlds = begin(some, config, seed=0)
        seat.begin(worlds)
        recorders, kept = recorders_of(worlds, some.names), [[] for _ in some]

        def act(obs, running, worlds=worlds, kept=kept):
            for i in np.flatnonzero(running):
                kept[i].append(worlds.native.snapshot(i))
            return seat(obs, running)

        for _ in play(worlds, act, recorders=recorders):
            pass
        fork = Worlds(some, config, num_worlds=1, num_threads=1)
        for i, recorder in recorders.items():
            rollout = recorder.rollout()
            if rollout.collisions("ego"):
                yield fork, kept[i], rollout


def main() -> None:
    args = arguments()
    scenes, rows = scenes_from(args), []
    ccdiff = {"num_samples": 1} | ({"denoising_steps": 1} if args.smoke else {})
    if args.smoke:
        scenes, args.before, args.draws, args.most = scenes[:8], [1.0], 1, 1
    for level in args.criticality:
        found = {before: [] for before in args.before}
        options = {"ccdiff": ccdiff | {"criticality": level}}
        for number, (fork, kept, rollout) in enumerate(collisions(scenes, args.ego, **options)):
            if number == args.most:
                break
            for before, figures in found.items():
                # a decision of three steps begins there
                at = (rollout.collisions("ego")[0].step - round(before / rollout.dt_s)) // 3 * 3
                if at < 0:
                    continue
                fork.native.restore(0, kept[at])
                live = avoidability(
                    fork, reactive=True, ego=args.ego, draws=args.draws, horizon_s=before + AFTER_S
                )
                recorded = rollout_avoidability(rollout, before_s=before, after_s=AFTER_S)
                figures.append((recorded.avoidable, live.avoidable, live.held, live.unchanged))
        for before, figures in found.items():
            means = np.mean(figures or [[np.nan] * 4], axis=0).tolist()
            rows.append([f"{level:g}", f"{before:g}", len(figures), *means])
    columns = [Column(name, unit="%", digits=0, factor=100.0) for name in FOUND]
    print(Table([*HEADS, *columns], rows))


if __name__ == "__main__":
    main()
