"""Lists of docs that are made from the schemas."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ccdiff_env import _native
from ccdiff_env.config import RewardConfig
from ccdiff_env.envs.selection import INFO_COLUMNS
from ccdiff_env.worlds.spaces import InfoColumn, read_columns
from tools import configuration


def _columns(columns: Iterable[InfoColumn]) -> str:
    units = {c.name: f" ({c.unit})" if c.unit else "" for c in columns}
    return "\n".join(f"* `{c.name}`{units[c.name]}: {c.doc}" for c in columns)


def _unweighted(columns: Iterable[InfoColumn]) -> str:
    return _columns([c for c in columns if not c.name.startswith("reward_")])


def _rewards(columns: Iterable[InfoColumn], weights: object) -> str:
    default = {f.name: getattr(weights, f.name) for f in dataclasses.fields(weights)}  # type: ignore[arg-type]
    parts = [(c.name.removeprefix("reward_"), c) for c in columns if c.name.startswith("reward_")]
    words = {name: c.doc.removeprefix("weighted reward of ") for name, c in parts}
    return "\n".join(f"* `{n}` ({default[n]:g}): {w}" for n, w in words.items())


def _observed(columns: Iterable[Mapping[str, Any]]) -> str:
    scales = [f" ({c['scale']:g} {c['unit']})".replace(" )", ")") for c in columns]
    rows = zip(columns, scales, strict=True)
    return "\n".join(f"* `{c['name']}`{s.replace(' (1)', '')}: {c['doc']}" for c, s in rows)


def _observation() -> str:
    """Entries of the default observation."""
    layout, *_ = json.loads(_native.schema("observation"))
    parts = [f"Default configuration: {layout['size']} floats."]
    for entry in layout["entries"]:
        parts.append(f"## `{entry['name']}` {entry['shape']}, from float {entry['offset']}")
        is_mask = entry["kind"] == "mask"
        parts.append("1 where the row is there." if is_mask else _observed(entry["columns"]))
    return "\n\n".join(parts)


def _on_request() -> str:
    """Columns that the default observation does not have."""
    layout, columns, _ = json.loads(_native.schema("observation"))
    entries = [entry for entry in layout["entries"] if entry["kind"] != "mask"]
    shown = {entry["name"]: {c["name"] for c in entry["columns"]} for entry in entries}
    more = {n: [c for c in of if c["name"] not in shown.get(n, ())] for n, of in columns}
    return "\n\n".join(f"`{name}`:\n\n{_observed(of)}" for name, of in more.items() if of)


def _raster() -> str:
    *_, channels = json.loads(_native.schema("observation"))
    return "\n".join(f"* {k}, `{c['name']}`: {c['doc']}" for k, c in enumerate(channels))


def _candidates() -> str:
    _, features = json.loads(_native.schema("candidates"))
    return _observed(
        [dict(zip(("name", "unit", "scale", "doc"), f, strict=True)) for f in features]
    )


#: Maker of each list by its name in the page.
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
