"""Arguments that say which scenes are played: one block for every command and example."""

from __future__ import annotations

import argparse
from dataclasses import replace

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.sources import DEFAULT, SOURCES, Place, load, parse, settle, split_names


def add_scene_arguments(parser: argparse.ArgumentParser, use: str | None = None) -> None:
    """Add which scenes are played: ``--scenes`` and ``--limit``.

    ``use`` is ``"train"`` or ``"test"``: which split of a source is meant where none is named; all
    scenes for ``None``.
    """
    forms = ", ".join(source.form for source in SOURCES.values())
    splits = ", ".join(dict.fromkeys(n for s in SOURCES.values() for n in split_names(s)))
    usual = settle(Place(DEFAULT), use)
    parser.set_defaults(scenes_use=use)
    parser.add_argument(
        "--scenes",
        metavar="SOURCE",
        help=f"source of the scenes, one of: {forms}; splits, joined by +: {splits} "
        f"(default: {usual})",
    )
    parser.add_argument("--limit", type=int, help="use only the first scenes (default: all)")


def add_other_scenes(parser: argparse.ArgumentParser, use: str) -> None:
    """Add ``--train-scenes``, or those of another use."""
    parser.set_defaults(other_use=use)
    parser.add_argument(
        f"--{use}-scenes",
        metavar="SOURCE",
        help=f"scenes to {use} on, as --scenes (default: another split of the same source)",
    )


def place_from(args: argparse.Namespace) -> Place:
    """Return the place that the arguments name, with version and split; a text that names no scenes
    is a :class:`ConfigError`.
    """
    place = parse(DEFAULT if args.scenes is None else args.scenes)
    if args.limit is not None:
        place = replace(place, limit=args.limit)
    return settle(place, args.scenes_use)


def other_place(args: argparse.Namespace) -> Place:
    """Return the place of the other use that the arguments name; nothing that says which scenes of
    the source are meant is a :class:`ConfigError`.
    """
    use: str = args.other_use
    if (text := getattr(args, f"{use}_scenes")) is not None:
        return settle(parse(text), use)
    place = place_from(args)
    usual = SOURCES[place.source].usual.get(place.version or "", {}).get(use)
    if usual is None:
        raise ConfigError(f"{place} has no split to {use} on: give --{use}-scenes")
    return settle(replace(place, split=usual), use)


def scenes_from(args: argparse.Namespace, *, other: bool = False) -> SceneSet:
    """Load the scenes that the arguments name, or those of the other use."""
    return load(other_place(args) if other else place_from(args))


def sources_help() -> str:
    """Return a sentence on every source."""
    return " ".join(f"{s.form}: {s.title}; lacks {s.lacks}." for s in SOURCES.values())
