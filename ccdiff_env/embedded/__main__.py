"""``python -m ccdiff_env.embedded``: unpack the embedded data set, or generate it anew."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from ccdiff_env.embedded.dataset import SHIPPED, generate, pack, unpack


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m ccdiff_env.embedded", description=__doc__)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--out", type=Path, metavar="DIR", help="unpack the data set into a folder")
    what.add_argument("--write", action="store_true", help="generate the shipped file anew")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    log = logging.getLogger("ccdiff_env.embedded")
    if arguments.write:
        path = Path(__file__).parents[1] / SHIPPED
        path.parent.mkdir(exist_ok=True)
        pack(generate(), path)
        log.info("wrote %s, %d kB", path, path.stat().st_size // 1000)
    else:
        unpack(arguments.out)
        log.info("data set (version v1.0-embedded) in %s", arguments.out)


if __name__ == "__main__":
    main()
