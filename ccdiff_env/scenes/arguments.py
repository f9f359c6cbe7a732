"""Arguments that say which scenes are played: one block for every command and example."""

from __future__ import annotations

import argparse
from dataclasses import replace

from ccdiff_env.errors import ConfigError
from ccdiff_env.scenes import SceneSet
from ccdiff_env.scenes.sources import DEFAULT, SOURCES, Place, load, parse, settled, split_names

#: The sources that the short forms stand for, without ``--dataroot`` and with it.
PLAIN, ROOTED = SOURCES[DEFAULT], SOURCES["nuscenes"]
SHORT = ("dataroot", "version", "split")  #: Short forms of parts of ``--scenes``.


def add_scene_arguments(
    parser: argparse.ArgumentParser, use: str | None = None, *, several: bool = False
) -> None:
    """Add which scenes are played: ``--scenes``, its short forms, and ``--limit``.

    ``use`` is ``"train"`` or ``"test"``: which split of a source is meant where none is named; all
    scenes for ``None``. With ``several``, ``--split`` takes several names.
    """
    usual = Place(PLAIN.name, split=PLAIN.usual[""].get(use or "", "all"))
    forms = ", ".join(source.form for source in SOURCES.values())
    parser.set_defaults(scenes_use=use)
    parser.add_argument(
        "--scenes",
        metavar="SOURCE",
        help=f"source of the scenes, one of: {forms} (default: {usual})",
    )
    parser.add_argument(
        "--dataroot",
        metavar=ROOTED.path,
        help=f"folder of {ROOTED.title}: short for --scenes {ROOTED.name}:{ROOTED.path} "
        f"(default: the {PLAIN.title})",
    )
    parser.add_argument(
        "--version",
        help=f"folder of the tables in --dataroot (default: {', else '.join(ROOTED.versions)})",
    )
    parser.add_argument("--split", nargs="+" if several else None, help=_split_help(use))
    parser.add_argument("--limit", type=int, help="use only the first scenes (default: all)")


def add_other_scenes(parser: argparse.ArgumentParser, use: str) -> None:
    """Add ``--train-scenes`` and ``--train-split``, or those of another use."""
    parser.set_defaults(other_use=use)
    parser.add_argument(
        f"--{use}-scenes",
        metavar="SOURCE",
        help=f"scenes to {use} on, as --scenes (default: another split of the same source)",
    )
    parser.add_argument(f"--{use}-split", nargs="+", help=_split_help(use))


def place_from(args: argparse.Namespace) -> Place:
    """Return the place that the arguments name, with version and split; ``--scenes`` beside a short
    form, and a text that names no scenes, are a :class:`ConfigError`.
    """
    given = [name for name in SHORT if getattr(args, name) is not None]
    if args.scenes is not None:
        if given:
            raise ConfigError(f"--{given[0]} is a part of --scenes: give one of them, not both")
        place = parse(args.scenes)
    elif args.dataroot is not None:
        place = Place(ROOTED.name, str(args.dataroot), args.version, _joined(args.split))
    elif args.version is not None:
        raise ConfigError("--version is a part of --dataroot, which is not given")
    else:
        place = Place(PLAIN.name, split=_joined(args.split))
    if args.limit is not None:
        place = replace(place, limit=args.limit)
    return settled(place, args.scenes_use)


def other_place(args: argparse.Namespace) -> Place:
    """Return the place of the other use that the arguments name; both forms, and nothing that says
    which scenes of the source are meant, are a :class:`ConfigError`.
    """
    use: str = args.other_use
    text, split = getattr(args, f"{use}_scenes"), _joined(getattr(args, f"{use}_split"))
    if text is not None:
        if split is not None:
            raise ConfigError(f"--{use}-split is a part of --{use}-scenes: give one of them")
        return settled(parse(text), use)
    place = place_from(args)
    usual = SOURCES[place.source].usual.get(place.version or "", {}).get(use)
    if split is None and usual is None:
        raise ConfigError(f"{place} has no split to {use} on: give --{use}-scenes")
    return settled(replace(place, split=split or usual), use)


def scenes_from(args: argparse.Namespace, *, other: bool = False) -> SceneSet:
    """Load the scenes that the arguments name, or those of the other use."""
    return load(other_place(args) if other else place_from(args))


def sources_help() -> str:
    """Return a sentence on every source."""
    return " ".join(f"{s.form}: {s.title}; lacks {s.lacks}." for s in SOURCES.values())


def _joined(split: str | list[str] | None) -> str | None:
    return split if split is None or isinstance(split, str) else "+".join(split)


def _split_help(use: str | None) -> str:
    known = (ROOTED, PLAIN)
    names = "; ".join(f"{s.title}: {', '.join(split_names(s))}" for s in known)
    usual = [dict.fromkeys(of.get(use or "", "all") for of in s.usual.values()) for s in known]
    defaults = (f"{s.title}: {', else '.join(u)}" for s, u in zip(known, usual, strict=True))
    return f"split, one of: {names} (default: {'; '.join(defaults)})"
