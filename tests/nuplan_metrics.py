"""nuPlan's own metric classes on recorded episodes, beside the parts of the planner score.

    CCDIFF_NUPLAN=<checkout of nuplan-devkit> PYTHONPATH=. python tests/nuplan_metrics.py \\
        nuscenes:<dataroot>@v1.0-mini/mini_val pdm,lane_idm replay,idm out.json

Needs the packages of `pip install 'ccdiff-env[nuplan]'`.
"""

import json
import sys

import ccdiff_env
from ccdiff_env.bench.nuplan_score import PARTS, nuplan_metrics
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.protocol import PROTOCOL
from ccdiff_env.scenes import SceneSet

SAME = 0.01  #: What two figures of a part may differ by.
#: nuScenes has no limits of speed.
COMPARED = {ours: theirs for ours, theirs in PARTS.items() if ours != "speed_limit"}


def compare(rollout, row):
    """Return by part ours, nuPlan's, and what nuPlan's metric says of it."""
    found = nuplan_metrics(rollout, PROTOCOL.fields["world"]["horizon_steps"])
    return {
        ours: [
            row[ours],
            float(found[theirs].metric_score),
            {statistic.name: statistic.value for statistic in found[theirs].statistics},
        ]
        for ours, theirs in COMPARED.items()
    }


def main(source, planners, traffic, out):
    """Drive, compare, and say how many episodes have equal parts, and which have not."""
    found = []
    scenes = SceneSet([s for s in ccdiff_env.load(source) if s.has_lanes])
    for planner in planners.split(","):
        for name in traffic.split(","):
            rows, rollouts = drive(scenes, planner, TRAFFIC[name], seed=0, record=scenes.names)
            for row in rows:
                parts = compare(rollouts[row["scene"]], row)
                found.append({"of": [planner, name, row["scene"]], **parts})
            print(planner, name, len(rows), flush=True)
            with open(out, "w") as file:
                json.dump(found, file, default=float)
    for part in COMPARED:
        apart = [f for f in found if abs(f[part][0] - f[part][1]) > SAME]
        print(f"{part:24} {len(found) - len(apart)} of {len(found)} equal")
        for f in apart:
            print("   ", *f["of"], *f[part])


if __name__ == "__main__":
    main(*sys.argv[1:5])
