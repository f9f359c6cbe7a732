"""``ccdiff-env bench verify`` of a run of ``bench traffic`` or ``realism``: played again."""

from __future__ import annotations

import json
from pathlib import Path

from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.provenance import scene_hashes
from ccdiff_env.bench.traffic import motion_hash
from ccdiff_env.bench.verify import Verified
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import parse_object, read_text, reading
from ccdiff_env.system.progress import shown

FUNCTIONS = ("ccdiff_env.bench.likelihood:evaluate", "ccdiff_env.bench.traffic:evaluate")


def is_of_traffic(path: Path) -> bool:
    """Return whether a folder holds a run of ``bench traffic`` or ``bench realism``."""
    file = path / "run.json"
    if not file.is_file():
        return False
    with reading("settings of a run", file):
        return parse_object(read_text(file)).get("benchmark") in ("traffic", "realism")


def verify_traffic(folder: Path, *, own_code: bool = False) -> Verified:
    """Play the episodes of a run again; compare all figures, and the rollouts that were kept.

    Raises:
        ConfigError: If a method is somebody's own code, without ``own_code``.
        DatasetError: If a result is damaged, or scenes are not those of the run.
    """
    files = sorted((folder / "raw").glob("*.json"))
    if not files:
        raise DatasetNotFoundError(f"no raw results in {folder}")
    differing, played = list[str](), 0
    for file in shown(files, what="results"):
        with reading("result", file):
            fields = parse_object(read_text(file))
            given, rows = fields["arguments"], fields["result"]
            if (function := fields["function"]) not in FUNCTIONS:
                raise DatasetError(f"{file} is no result of `bench traffic` or `bench realism`")
            scenes = fields["made_from"]["scenes"]
        if ":" in given["method"] and not own_code:
            raise ConfigError(f"{file}: {given['method']} is run with --own-code: it is code")
        if scene_hashes(given["source"], given["names"]) != scenes:
            raise DatasetError(f"{file}: other scenes than those of the run")
        keeps = given.pop("keep", None) is not None
        now = json.loads(json.dumps(Job(file.stem, function, {**given, "keep": ""}).call()))
        who = given["method"]
        if "num_controlled" in given:
            who += ", K Full" if (k := given["num_controlled"]) is None else f", K {k}"
        for then, again in zip(rows, now, strict=True):
            played += 1
            names = [n for n in {**then, **again} if n not in ("processor_s", "kept")]
            changed = [name for name in names if then.get(name) != again.get(name)]
            kept = [folder / "rollouts" / name for name in then["kept"]] if keeps else []
            if keeps and [motion_hash(Rollout.load(file)) for file in kept] != again["kept"]:
                changed.append("rollout than the one that was kept")
            if changed:
                differing.append(f"{who}, {then['scene']}: another {changed[0]}")
    return Verified(played, played, given["seed"], tuple(differing))
