"""Names of the rankings of vehicles that matter to the ego, see :meth:`Scene.ranked_vehicles`."""

from __future__ import annotations

from typing import Literal, TypeAlias

from ccdiff_env.errors import unknown

__all__ = ["RANKINGS", "KeyRanking", "ranking_named"]

KeyRanking: TypeAlias = Literal["cliques", "nearest", "ttc", "first", "random"]

#: Ways to rank: clique occurrences in the causal graph, nearest to the ego, time to contact with
#: the ego (then distance), the scene's order, chance.
RANKINGS: tuple[KeyRanking, ...] = ("cliques", "nearest", "ttc", "first", "random")


def ranking_named(name: str) -> KeyRanking:
    """Return the ranking of a name.

    Raises
    ------
    ConfigError
        For another name.
    """
    for known in RANKINGS:
        if name == known:
            return known
    raise unknown("ranking", str(name), RANKINGS)
