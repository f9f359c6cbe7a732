"""``python -m tools.embedded_city`` generates the shipped data set anew.

With ``--dense FOLDER`` it generates the same kinds of scene with two to three times the actors, in
a folder of their own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ccdiff_env.scenes.embedded import SHIPPED
from tools.embedded_city.dataset import generate, pack
from tools.embedded_city.scenes import DENSE

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--dense", type=Path, metavar="FOLDER", help="write the dense set there")
folder = parser.parse_args().dense
if folder is None:
    path = Path(__file__).parents[2] / "ccdiff_env" / SHIPPED
    pack(generate(), path)
    print(f"wrote {path}, {path.stat().st_size // 1000} kB")
else:
    for name, content in generate(DENSE).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    print(f"wrote {folder}")
