"""Run folders of `bench planners` without the runs: raw results by hand."""

import json

from ccdiff_env.bench.planner_score import score_of
from ccdiff_env.bench.protocol import PROTOCOL

PARTS = [*PROTOCOL.fields["score"]["gates"], *PROTOCOL.fields["score"]["weights"]]


def row(scene, value, seed=0):
    """An episode all of whose graded parts have a value."""
    parts = dict.fromkeys(PARTS, 1.0) | dict.fromkeys(PROTOCOL.fields["score"]["weights"], value)
    more = {"collision": 0.0, "success": 1.0, "min_ttc_s": 1.0, "digest": "d"}
    return {"scene": scene, "seed": seed, **parts, **more, "score": score_of(parts)}


def raw(planner, traffic, values, *, seed=0, source=None, scenes="", **made_from):
    """A raw result: values by scene, `scenes` is the beginning of their hashes."""
    names = [f"scene-{i:02d}" for i in range(len(values))]
    return {
        "function": "ccdiff_env.bench.planners:evaluate",
        "arguments": {
            "source": "embedded/val",
            "names": names,
            "planner": planner,
            "traffic": traffic,
            "seed": seed,
            "sources": {"planner": source, "traffic": None},
        },
        "made_from": {
            "version": "1",
            "package": "p",
            "weights": "w",
            "protocol": PROTOCOL.sha256,
            "scenes": {name: f"{scenes}{name}" for name in names},
            **made_from,
        },
        "result": [row(name, value, seed) for name, value in zip(names, values, strict=True)],
        "seconds": 1.0,
    }


def write_run(folder, *results, **settings):
    """Write a run folder; returns it."""
    (folder / "raw").mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps({"benchmark": "planners", **settings}))
    (folder / "report.html").write_text("")
    for i, result in enumerate(results):
        (folder / "raw" / f"{i}.json").write_text(json.dumps(result))
    return folder
