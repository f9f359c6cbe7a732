"""What each economy of the ``fast`` network costs: networks that lack one, trained equally long.

``python benchmarks/sizes.py --dataroot <nuscenes> --out <folder> [--steps 1500] [--only NAME ...]``
trains each on the training scenes, goes on where it was stopped, and prints a table in Markdown:
parameters, seconds per training step, open-loop errors on the validation scenes. Each differs from
``fast`` in one part, which it has from ``paper``, in all of them, or has no map.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from open_loop import HORIZON, quality

import ccdiff_env
from ccdiff_env.models import TrajectoryModel, require_networks, train

require_networks()
from ccdiff_env import _models  # noqa: E402

PAPER: dict[str, Any] = json.loads(_models.model_preset("paper")[0])
#: Parts that a network has from ``paper``, by its name in the table.
PARTS: dict[str, tuple[str, ...]] = {
    "fast": (),
    "an action every 0.1 s, not 0.4 s": ("knot_stride",),
    "a token per history step, not one in all": ("history",),
    "width 128, 16 heads": (
        "width",
        "heads",
        "feed_forward",
        "social_feed_forward",
        "edge_width",
    ),
    "2 temporal and 4 edge layers, not 1 and 1": ("temporal_layers", "edge_layers"),
    "20 neighbours, not 8": ("max_neighbours",),
}
PARTS["all five: paper but for its map"] = tuple(part for parts in PARTS.values() for part in parts)
#: Networks that differ from ``fast``, by name.
SIZES: dict[str, dict[str, Any]] = {
    **{name: {part: PAPER[part] for part in parts} for name, parts in PARTS.items()},
    "no map": {"map": None},
}


def main() -> None:
    """Train, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataroot", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--only", nargs="+", default=list(SIZES), choices=list(SIZES))
    args = parser.parse_args()
    torch.set_num_threads(1)

    def load(split: str) -> list[ccdiff_env.Scene]:
        return list(
            ccdiff_env.load_nuscenes(args.dataroot, "v1.0-trainval", split, kinds=["vehicle"])
        )

    scenes, validation = load("train") + load("train_val"), load("val")
    cases = [(s, t) for s in validation for t in range(30, s.num_steps - HORIZON, 20)]
    print("| network | parameters | s per step | last loss | minADE | minFDE | ADE | FDE |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in args.only:
        folder = args.out / str(list(SIZES).index(name))
        weights = train(
            scenes, out=folder, steps=args.steps, network=SIZES[name], checkpoint_minutes=5.0
        )
        with (folder / "loss.csv").open() as file:
            rows = [{key: float(v) for key, v in row.items()} for row in csv.DictReader(file)]
        steps, seconds = ([row[key] for row in rows] for key in ("step", "seconds"))
        rates = np.diff(seconds) / np.diff(steps)
        late = [row["loss"] for row in rows if row["step"] > 0.9 * args.steps]
        model = TrajectoryModel(weights)
        found = quality(model, cases, 5)
        figures = [found[key] for key in ("min_ade_m", "min_fde_m", "ade_m", "fde_m")]
        cells = [f"{model.num_parameters:,}", f"{np.median(rates):.2f}", f"{np.mean(late):.3f}"]
        print(f"| {name} | " + " | ".join(cells + [f"{v:.2f}" for v in figures]) + " |", flush=True)


if __name__ == "__main__":
    main()
