"""``python -m ccdiff_env.scenes.embedded --out DIR`` writes the embedded data set as files."""

import argparse
from pathlib import Path

from ccdiff_env.scenes.embedded import VERSION, unpack

parser = argparse.ArgumentParser(prog="python -m ccdiff_env.scenes.embedded", description=__doc__)
parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="folder to write")
folder = parser.parse_args().out
unpack(folder)
print(f"data set (version {VERSION}) in {folder}")
