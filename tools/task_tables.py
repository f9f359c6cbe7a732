"""Tables of docs that are made from the schemas."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ccdiff_env import _native
from ccdiff_env.config import RewardConfig
from ccdiff_env.envs.selection import INFO_COLUMNS
from ccdiff_env.system.table import Markdown, Table
from ccdiff_env.worlds.spaces import InfoColumn, read_columns
from tools import configuration


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return str(Table(heads, [[*map(Markdown, row)] for row in rows]))


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


def _observed(column: Mapping[str, Any]) -> tuple[str, ...]:
    return column["name"], f"{column['scale']:g} {column['unit']}".strip(), column["doc"]


_OBSERVED = ("column", "scale", "what")


def _observation() -> str:
    """Entries of the default observation."""
    layout, *_ = json.loads(_native.schema("observation"))
    parts = [f"Default configuration: {layout['size']} floats."]
    for entry in layout["entries"]:
        parts.append(f"## `{entry['name']}` {entry['shape']}, from float {entry['offset']}")
        rows = map(_observed, entry["columns"])
        is_mask = entry["kind"] == "mask"
        parts.append("1 where the row is there, else 0." if is_mask else _table(_OBSERVED, rows))
    return "\n\n".join(parts)


def _on_request() -> str:
    """Columns that the default observation does not have."""
    layout, columns, _ = json.loads(_native.schema("observation"))
    entries = [entry for entry in layout["entries"] if entry["kind"] != "mask"]
    shown = {entry["name"]: {c["name"] for c in entry["columns"]} for entry in entries}
    rows = [
        (f"`{name}`", *_observed(column))
        for name, of_entry in columns
        for column in of_entry
        if column["name"] not in shown.get(name, ())
    ]
    return _table(("entry", *_OBSERVED), rows)


def _raster() -> str:
    *_, channels = json.loads(_native.schema("observation"))
    rows = ((str(k), c["name"], c["doc"]) for k, c in enumerate(channels))
    return _table(("channel", "name", "bytes"), rows)


def _candidates() -> str:
    _, features = json.loads(_native.schema("candidates"))
    rows = (
        (f"`{name}`", f"{doc} ({unit})" if unit else doc, f"{scale:g}")
        for name, unit, scale, doc in features
    )
    return _table(("column", "what", "divided by"), rows)


#: Maker of each table by its name in the page.
TABLES: dict[str, Callable[[], str]] = {
    "info": lambda: _unweighted(read_columns(_native.schema("columns"))),
    "rewards": lambda: _rewards(read_columns(_native.schema("columns")), RewardConfig()),
    "selection_info": lambda: _unweighted(INFO_COLUMNS),
    "selection_observation": _candidates,
    "observation": _observation,
    "observation_on_request": _on_request,
    "raster": _raster,
    "configuration": lambda: configuration.page(configuration.tables()),
}
