"""Tables of docs/tasks.md, made from the schemas."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence

from ccdiff_env import _native
from ccdiff_env.config import RewardConfig
from ccdiff_env.envs.selection import INFO_COLUMNS
from ccdiff_env.system.table import Table
from ccdiff_env.worlds.spaces import InfoColumn, read_columns


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return str(Table(heads, list(rows)))


def _columns(columns: Iterable[InfoColumn]) -> str:
    def row(c: InfoColumn) -> tuple[str, str]:
        return f"`{c.name}`", f"{c.doc} ({c.unit})" if c.unit else c.doc

    return _table(("key", "what"), map(row, columns))


def _unweighted(columns: Iterable[InfoColumn]) -> str:
    return _columns(c for c in columns if not c.name.startswith("reward_"))


def _rewards(columns: Iterable[InfoColumn], weights: object) -> str:
    default = {f.name: getattr(weights, f.name) for f in dataclasses.fields(weights)}  # type: ignore[arg-type]
    parts = [(c.name.removeprefix("reward_"), c) for c in columns if c.name.startswith("reward_")]
    words = {name: c.doc.removeprefix("weighted reward of ") for name, c in parts}
    return _table(
        ("weight", "default", "for"), ((f"`{n}`", f"{default[n]:g}", w) for n, w in words.items())
    )


def _observation() -> str:
    _, features = json.loads(_native.candidate_features_json())
    rows = (
        (f"`{name}`", f"{doc} ({unit})" if unit else doc, f"{scale:g}")
        for name, unit, scale, doc in features
    )
    return _table(("column", "what", "divided by"), rows)


#: Maker of each table by its name in the page.
TABLES: dict[str, Callable[[], str]] = {
    "info": lambda: _unweighted(read_columns(_native.columns_json())),
    "rewards": lambda: _rewards(read_columns(_native.columns_json()), RewardConfig()),
    "selection_info": lambda: _unweighted(INFO_COLUMNS),
    "selection_observation": _observation,
}
