"""Do cliques of the causal graph predict collisions? ``python benchmarks/cliques.py``.

Pearson's r between the history of an episode and new collisions in it: over vehicles, the cliques
that hold one; over scenes, all cliques and the number of vehicles. The paper's "R²" of cliques and
collisions is such an r.
"""

from __future__ import annotations

import argparse

import numpy as np

from ccdiff_env.bench.methods import METHODS
from ccdiff_env.bench.traffic import episodes
from ccdiff_env.metrics import causal, pearson
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.arguments import add_scene_arguments, scenes_from
from ccdiff_env.system.table import Column, Table

#: Cliques that are counted per step at most.
MOST_CLIQUES = 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_scene_arguments(parser, "val")
    parser.add_argument("--method", default="ccdiff", choices=sorted(METHODS), metavar="METHOD")
    parser.add_argument("--k", type=int, default=5, help="controlled vehicles")
    args = parser.parse_args()
    of_vehicle, hit, of_scene, hits = [], [], [], []
    scenes = list(scenes_from(args))
    for first in range(0, len(scenes), 12):
        batch = SceneSet(scenes[first : first + 12])
        for episode in episodes(batch, METHODS[args.method], num_controlled=args.k):
            found = {
                name: causal.clique_counts(measure, top_per_frame=MOST_CLIQUES)
                for name, measure in vars(episode.history).items()
            }
            counts = np.zeros(len(episode.agents))
            counts[found["ttc"].agents] = found["ttc"].counts
            new = episode.motion.collisions(controlled=episode.controlled, log=episode.log)
            of_vehicle += counts.tolist()
            hit += new.agents["new"].tolist()
            cliques = [measure.num_cliques for measure in found.values()]
            of_scene.append([*cliques, len(episode.agents)])
            hits.append(new.any("new"))
    pairs = {"vehicles: cliques that hold it": (of_vehicle, hit)}
    names = ("cliques, times to contact", "cliques, distances", "vehicles")
    pairs |= {
        f"scenes: {n}": (x, hits) for n, x in zip(names, np.array(of_scene).T.tolist(), strict=True)
    }
    rows = [
        [name, len(x), *(pearson(x, y) if len(set(x)) > 1 < len(set(y)) else (np.nan, np.nan))]
        for name, (x, y) in pairs.items()
    ]
    print(Table(["feature", "count", Column("r"), Column("p", digits=4)], rows))


if __name__ == "__main__":
    main()
