"""``python -m tools.embedded_city`` generates the shipped data set.

With ``--city`` it generates the second one, and writes its hashes into the protocol of planners.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ccdiff_env.scenes.embedded import CITY as CITY_FILE
from ccdiff_env.scenes.embedded import SHIPPED as FILE
from ccdiff_env.scenes.embedded import embedded_scenes
from tools.embedded_city.dataset import generate, pack
from tools.embedded_city.scenes import CITY, SHIPPED


def fix_hashes(protocol: Path) -> None:
    """Write the hashes of the second set's scenes into the protocol's level ``city``."""
    fields = json.loads(protocol.read_text(encoding="utf-8"))
    hashes = {scene.name: scene.hash for scene in embedded_scenes("city")}
    fields["levels"]["city"] = {"embedded": "city", "seeds": [0], "hashes": hashes}
    order = ("smoke", "city", "mini", "val")
    fields["levels"] = {name: fields["levels"][name] for name in order}
    protocol.write_text(json.dumps(fields, indent=1) + "\n", encoding="utf-8")


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--city", action="store_true", help="the set that planners are compared on")
args = parser.parse_args()
path = Path(__file__).parents[2] / "ccdiff_env" / (CITY_FILE if args.city else FILE)
pack(generate(CITY if args.city else SHIPPED), path)
if args.city:
    fix_hashes(path.parent / "planner-1.2.json")
print(f"wrote {path}, {path.stat().st_size // 1000} kB")
