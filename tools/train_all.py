"""``python -m tools.train_all``: the trainings of tools/trainings.json, one by one on one core.

An interrupted call goes on where it was when it is repeated: ``ccdiff-env train`` resumes a run bit
for bit, and what is finished is left alone. A training that fails is reported, and the next one
begins. Run it from a checkout and build of its own, so that work on another does not touch it.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

TRAININGS = Path(__file__).with_name("trainings.json")
#: The command runs on one core, and gives way to everything else.
ONE_CORE = {"OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
NICENESS = 19


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is not finished; 1 where a training failed."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="Other options, such as --scenes, go to each ccdiff-env train.",
        allow_abbrev=False,
    )
    parser.add_argument("--list", type=Path, default=TRAININGS, help="names and arguments, as JSON")
    parser.add_argument("--out", type=Path, default=Path("runs/trainings"), help="a folder per run")
    parser.add_argument("--only", nargs="+", help="names of the trainings to run (default: all)")
    args, scenes = parser.parse_known_args(argv)
    trainings = json.loads(args.list.read_text(encoding="utf-8"))
    names = [training["name"] for training in trainings]
    if unknown := [name for name in args.only or () if name not in names]:
        parser.error(f"{args.list} has no training {', '.join(unknown)}, only {', '.join(names)}")
    args.out.mkdir(parents=True, exist_ok=True)
    failed = []
    with (args.out / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for training in trainings:
            if args.only is None or training["name"] in args.only:
                ended = _train(training, args.out / training["name"], scenes)
                print(f"{training['name']}: {ended}", flush=True)
                failed += [training["name"]] if ended["exit_status"] else []
    return int(bool(failed))


def _train(training: dict[str, Any], folder: Path, scenes: list[str]) -> dict[str, Any]:
    """Run or resume one training; what it took is kept beside its weights."""
    done = folder / "done.json"
    if done.exists():
        finished: dict[str, Any] = json.loads(done.read_text(encoding="utf-8"))
        return finished
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "ccdiff_env.cli", "train", "--quiet", "--out", str(folder)]
    # what one training made, another may begin with
    arguments = [
        argument.replace("{out}", str(folder.parent)) for argument in training["arguments"]
    ]
    command += [*scenes, *arguments]
    begun, before = time.time(), resource.getrusage(resource.RUSAGE_CHILDREN)
    with (folder / "log.txt").open("a", encoding="utf-8") as log:
        status = subprocess.run(
            ["nice", "-n", str(NICENESS), *command],
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **ONE_CORE},
            check=False,
        ).returncode
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = {
        "exit_status": status,
        "arguments": training["arguments"],
        "seconds_of_this_call": round(time.time() - begun),
        "processor_seconds_of_this_call": round(
            after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        ),
    }
    if status == 0:
        done.write_text(json.dumps(ended, indent=1) + "\n", encoding="utf-8")
    return ended


if __name__ == "__main__":
    raise SystemExit(main())
