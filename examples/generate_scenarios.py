"""Make safety-critical scenarios from logs, mark those that no ego plan escapes, and export them.

    python examples/generate_scenarios.py --scenes nuscenes:/data/nuscenes/val --ego idm --budget 2

CCDiff traffic drives, a ranking chooses the adversaries, the planner under test drives the ego.
Scenarios with a collision are saved as rollouts (.npz, scenes again by ``Rollout.to_scene``) and as
ScenarioNet descriptions (.pkl) for MetaDrive and others.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import ccdiff_env
from ccdiff_env import EgoEnv, Recorder
from ccdiff_env.record import counterfactual
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.system.files import file_name


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "test")
    parser.add_argument("--ego", default="idm", help="planner of the ego, as in bench planners")
    parser.add_argument("--ranking", default="cliques", help="cliques (causal), ttc, random, ...")
    parser.add_argument("--budget", type=int, default=2, help="vehicles that are guided at once")
    parser.add_argument("--criticality", type=float, default=1.0)
    parser.add_argument("--seeds", type=int, default=1, help="episodes per scene")
    parser.add_argument("--all", action="store_true", help="keep scenarios without collision, too")
    parser.add_argument("--out", type=Path, default=Path("runs/scenarios"))
    parser.add_argument("--smoke", action="store_true", help="a run of seconds")
    return parser.parse_args()


def main() -> None:
    args = arguments()
    scenes = scenes_from(args)
    guided = {"criticality": args.criticality, "num_guided": args.budget, "ranking": args.ranking}
    options = {"ccdiff": guided}
    if args.smoke:
        scenes, args.all, options["horizon_steps"] = scenes[:1], True, 20
        guided["denoising_steps"] = 2
    env = EgoEnv(scenes=scenes, traffic="ccdiff", driver=args.ego, **options)
    action = env.action_space.sample()  # the planner drives
    recorder = Recorder(env, planner=args.ego)
    args.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for scene in scenes:
        for seed in range(args.seeds):
            env.reset(seed=seed, options={"scene": scene.name})
            recorder.start()
            done = False
            while not done:
                *_, terminated, truncated, _ = env.step(action)
                recorder.step()
                done = terminated or truncated
            rollout = recorder.rollout()
            if not (args.all or rollout.collisions("ego")):
                continue
            verdict = counterfactual.rollout_avoidability(rollout)
            name = file_name(f"{scene.name}-{args.ranking}-{seed}")
            rollout.save(args.out / f"{name}.npz")
            rollout.to_scenarionet(args.out / f"{name}.pkl", name)
            row = {
                "name": name,
                "scene": scene.name,
                "seed": seed,
                "adversaries": sorted(
                    {
                        rollout.agent_ids[i]
                        for plan in rollout.plans
                        for i in plan.agents[plan.guided]
                    }
                ),
                "collisions": [[e.step, e.partner_id, e.kind] for e in rollout.collisions("ego")],
                "avoidable": None if verdict is None else verdict.avoidable,
            }
            rows.append(row)
            print(f"{name}: {row['collisions'] or 'no collision'}, avoidable {row['avoidable']}")
    (args.out / "scenarios.json").write_text(json.dumps(rows, indent=1) + "\n")
    loaded = ccdiff_env.load_scenarionet(args.out) if rows else ()
    print(f"{len(rows)} scenarios in {args.out}; {len(loaded)} of them read back as scenes")


if __name__ == "__main__":
    main()
