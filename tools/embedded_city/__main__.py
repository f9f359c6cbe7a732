"""``python -m tools.embedded_city`` generates the shipped data set anew, ``--city`` the second one,
whose hashes it writes into the protocol of planners.

With ``--dense FOLDER`` it generates the same kinds of scene with two to three times the actors, in
a folder of their own.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ccdiff_env.scenes.embedded import CITY as CITY_FILE
from ccdiff_env.scenes.embedded import SHIPPED, embedded_scenes
from tools.embedded_city.dataset import generate, pack
from tools.embedded_city.scenes import CITY, DENSE
from tools.embedded_city.scenes import SHIPPED as USUAL


def fix_hashes(protocol: Path) -> None:
    """Write the hashes of the second set's scenes into the protocol's level ``city``."""
    fields = json.loads(protocol.read_text(encoding="utf-8"))
    hashes = {scene.name: scene.hash for scene in embedded_scenes("city")}
    fields["levels"]["city"] = {"embedded": "city", "seeds": [0], "hashes": hashes}
    order = ("smoke", "city", "mini", "val")
    fields["levels"] = {name: fields["levels"][name] for name in order}
    protocol.write_text(json.dumps(fields, indent=1) + "\n", encoding="utf-8")


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--dense", type=Path, metavar="FOLDER", help="write the dense set there")
parser.add_argument("--city", action="store_true", help="the set that planners are compared on")
args = parser.parse_args()
folder = args.dense
if folder is None:
    path = Path(__file__).parents[2] / "ccdiff_env" / (CITY_FILE if args.city else SHIPPED)
    pack(generate(CITY if args.city else USUAL), path)
    if args.city:
        fix_hashes(path.parent / "planner-1.2.json")
    print(f"wrote {path}, {path.stat().st_size // 1000} kB")
else:
    for name, content in generate(DENSE).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    print(f"wrote {folder}")
