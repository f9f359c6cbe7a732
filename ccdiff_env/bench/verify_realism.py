"""``ccdiff-env bench verify`` of a run of ``bench realism``: its samples, played again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.provenance import scene_hashes
from ccdiff_env.bench.scenarios import motion_hash
from ccdiff_env.bench.verify import Verified
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError
from ccdiff_env.record.rollout import Rollout
from ccdiff_env.system.files import parsed_object, read_text, reading
from ccdiff_env.system.progress import shown

FUNCTION = "ccdiff_env.bench.likelihood:evaluate"


def is_realism(path: Path) -> bool:
    """Return whether a folder holds a run of ``bench realism``."""
    file = path / "run.json"
    if not file.is_file():
        return False
    with reading("settings of a run", file):
        return parsed_object(read_text(file)).get("benchmark") == "realism"


def verify_realism(folder: Path, *, own_code: bool = False) -> Verified:
    """Play the samples of a run again; compare all figures, and the rollouts that were kept.

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
            fields = parsed_object(read_text(file))
            given, rows = fields["arguments"], fields["result"]
            if fields["function"] != FUNCTION:
                raise DatasetError(f"{file} is no result of `bench realism`")
            scenes = fields["made_from"]["scenes"]
        if ":" in given["method"] and not own_code:
            raise ConfigError(f"{file}: {given['method']} is run with --own-code: it is code")
        if scene_hashes(given["source"], given["names"]) != scenes:
            raise DatasetError(f"{file}: other scenes than those of the run")
        kept = given.pop("keep", None)
        now = json.loads(json.dumps(Job(file.stem, FUNCTION, {**given, "keep": ""}).call()))
        for then, again in zip(rows, now, strict=True):
            played += 1
            names = [n for n in {**then, **again} if n not in ("processor_s", "kept")]
            changed = [name for name in names if then.get(name) != again.get(name)]
            hashes = {} if kept is None else _hashes(folder / kept, then["kept"])
            if changed or (kept is not None and list(hashes.values()) != again["kept"]):
                what = changed[0] if changed else "rollout than the one that was kept"
                differing.append(f"{given['method']}, {then['scene']}: another {what}")
    return Verified(played, played, given["seed"], tuple(differing))


def _hashes(folder: Path, names: dict[str, Any]) -> dict[str, str]:
    return {name: motion_hash(Rollout.load(folder / name)) for name in names}
