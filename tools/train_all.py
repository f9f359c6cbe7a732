"""``python -m tools.train_all``: the trainings of tools/trainings.json, one by one on one core.

An interrupted call goes on where it was when it is repeated: ``ccdiff-env train`` resumes a run bit
for bit, and what is finished is left alone. A training that fails is reported, and the next one
begins. Run it from a checkout and build of its own, so that work on another does not touch it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: Arguments by name.
TRAININGS: dict[str, list[str]] = {
    training["name"]: training["arguments"]
    for training in json.loads(Path(__file__).with_name("trainings.json").read_text("utf-8"))
}
#: The command runs on one core.
ONE_CORE = {"OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is not finished; 1 where a training failed."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="Other options, such as --scenes, go to each ccdiff-env train.",
        allow_abbrev=False,
    )
    parser.add_argument("--out", type=Path, default=Path("runs/trainings"), help="a folder per run")
    parser.add_argument("--only", nargs="+", choices=TRAININGS, default=[*TRAININGS])
    args, scenes = parser.parse_known_args(argv)
    failed = False
    for name in args.only:
        folder: Path = args.out / name
        done = folder / "done.json"
        # what one training made, another may begin with
        own = [a.replace("{out}", str(args.out)) for a in (*scenes, *TRAININGS[name])]
        finished = done.exists() and json.loads(done.read_text("utf-8"))["arguments"] == own
        if not finished:
            folder.mkdir(parents=True, exist_ok=True)
            command = ["nice", "-n", "19", sys.executable, "-m", "ccdiff_env.cli", "train"]
            command += ["--quiet", "--out", str(folder), *own]
            with (folder / "log.txt").open("a", encoding="utf-8") as log:
                status = subprocess.call(
                    command, stdout=log, stderr=log, env={**os.environ, **ONE_CORE}
                )
            if finished := status == 0:
                done.write_text(json.dumps({"arguments": own}) + "\n", encoding="utf-8")
            failed |= not finished
        print(f"{name}: {'finished' if finished else f'failed, see {folder}/log.txt'}", flush=True)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
