"""Scenes: loading them, and what they come in."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from functools import cache as _memoise
from functools import partial
from importlib import resources
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env._native import Scene
from ccdiff_env.errors import ConfigError, UnknownNameError
from ccdiff_env.scenes.load_report import LoadReport
from ccdiff_env.scenes.scene_set import SceneSet
from ccdiff_env.scenes.scene_types import AGENT_KINDS

__all__ = [
    "EgoReference", "LoadReport", "Scene", "SceneSet", "cache_directory", "cache_folder",
    "expect_limit", "is_lone_ego", "load_nuscenes", "load_scenarionet", "of_kinds", "splits",
    "warn_of_lone_egos", "warn_without_road", "with_tracks",
]  # fmt: skip

_TRACKS = ("position", "heading", "velocity", "valid", "elevation_m")

EgoReference = Literal["rear_axle", "centre"]  #: Which point of a recording car its poses are of.


def with_tracks(
    scene: Scene,
    tracks: Mapping[str, Any],
    agents: npt.NDArray[np.int64] | None = None,
    *,
    name: str | None = None,
    source: str | None = None,
    sizes: npt.NDArray[np.float32] | None = None,
    first: int = 0,
) -> Scene:
    """Return a scene with other tracks of its agents.

    Args:
        scene: The scene.
        tracks: ``position`` [A, T, 2] m, ``heading`` [A, T] rad, ``velocity`` [A, T, 2] m/s and
            ``valid`` [A, T], as :meth:`Scene.tracks` gives them; ``elevation_m`` [A, T] m in scenes
            with levels.
        agents: Numbers [N] of the agents that stay, the ego (0) among them; all of them for
            ``None``.
        name, source: What the scene is called and where it comes from; as before for ``None``.
        sizes: Lengths, widths and heights [A, 3] of all agents, metres; as before for ``None``.
        first: Step of the scene at which the tracks begin: what lights show is that from there on,
            the last state where the log has ended.
    """
    kept = np.arange(scene.num_agents) if agents is None else agents
    layers, num_steps = scene.map_layers(), tracks["valid"].shape[1]
    for light in layers.get("lights", ()):
        shown = light["states"][first : first + num_steps]
        light["states"] = np.pad(shown, (0, num_steps - len(shown)), mode="edge")
    return Scene.from_arrays(
        name or scene.name,
        agent_ids=[scene.agent_ids[i] for i in kept],
        agent_types=[scene.agent_types[i] for i in kept],
        agent_categories=[scene.agent_categories[i] for i in kept],
        sizes=(scene.sizes if sizes is None else sizes)[kept],
        **{field: tracks[field][kept] for field in _TRACKS if field in tracks},
        dt=scene.dt,
        token=scene.token,
        location=scene.location,
        source=source or scene.source,
        origin=scene.origin,
        map_layers=layers,
        mend=False,
    )


def of_kinds(scenes: SceneSet, kinds: Sequence[str]) -> SceneSet:
    """Return scenes with agents of some types alone, and their egos."""
    for kind in kinds:
        if kind not in AGENT_KINDS:
            known = ", ".join(AGENT_KINDS)
            raise UnknownNameError(f"unknown agent type {kind!r}, expected one of {known}")

    def kept(scene: Scene) -> Scene:
        wanted = [kind in kinds for kind in scene.agent_types]
        chosen = np.flatnonzero([True, *wanted[1:]])
        if len(chosen) == scene.num_agents:
            return scene
        return with_tracks(scene, scene.tracks(), chosen)

    return scenes.having(map(kept, scenes))


def expect_limit(limit: object) -> None:
    """Refuse a number of scenes that is none; ``None`` is all of them."""
    if limit is not None and (not isinstance(limit, Integral) or limit < 1):
        raise ConfigError(f"limit is {limit!r}, expected a whole number, at least 1")


def is_lone_ego(scene: Scene) -> bool:
    """Return whether nobody but the ego is in a scene."""
    return scene.num_agents == 1 and scene.agent_ids == ["ego"]


def warn_of_lone_egos(scenes: SceneSet) -> None:
    """Warn once of the scenes of a load that have nobody but the ego."""
    if bare := [scene.name for scene in scenes if is_lone_ego(scene)]:
        warnings.warn(
            f"{len(bare)} of {len(scenes)} scenes have nobody but the ego ({bare[0]}, ...): no "
            "annotations, as in a test split, or none of the kinds asked for; every drive is safe "
            "there",
            stacklevel=3,
        )


def warn_without_road(scenes: SceneSet) -> None:
    """Warn once of the scenes of a load that have no road."""
    without = [scene.name for scene in scenes if not scene.has_road]
    if without:
        warnings.warn(
            f"{len(without)} of {len(scenes)} scenes have no road ({without[0]}, ...): "
            "no agent is off the road there, and metrics that need a road are n/a",
            stacklevel=3,
        )


@_memoise
def splits() -> dict[str, tuple[str, ...]]:
    """Return the scene names of every split.

    ``train`` (500) and ``train_val`` (200) are the two parts of the devkit's 700 training scenes,
    as the prediction challenge and trajdata divide them; ``val`` (150), ``mini_train`` (8) and
    ``mini_val`` (2) are the devkit's; ``ccdiff100`` are the 100 validation scenes that the CCDiff
    paper evaluates on.
    """
    text = resources.files("ccdiff_env").joinpath("data/splits.json").read_text(encoding="utf-8")
    return {name: tuple(names) for name, names in json.loads(text).items()}


def cache_directory() -> Path | None:
    """Return the folder of built scenes: ``CCDIFF_CACHE``, else ``~/.cache/ccdiff_env``; ``None``
    for a user without a home.
    """
    chosen = os.environ.get("CCDIFF_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "ccdiff_env"
    except RuntimeError:
        return None


def cache_folder(cache: bool | str | os.PathLike[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the folder of built scenes that an argument ``cache`` names, ``None`` for none, and
    what the report of a load shall note of it.
    """
    if cache is False:
        return None, ()
    found = cache_directory() if cache is True else cache
    if found is None:
        return None, ("no cache: you have no home, and neither CCDIFF_CACHE nor XDG_CACHE_HOME",)
    return os.fspath(found), ()


def _names_of_split(split: str | Sequence[str] | None) -> list[str] | None:
    """Scene names of one split or several; ``None`` for all scenes."""
    chosen = [split] if isinstance(split, str) else list(split or ["all"])
    if "all" in chosen:
        return None
    known = splits()
    names: list[str] = []
    for name in chosen:
        if name not in known:
            raise UnknownNameError(
                f"unknown split {name!r}, expected one of all, {', '.join(known)}"
            )
        names.extend(known[name])
    return names


def load_nuscenes(
    dataroot: str | os.PathLike[str],
    version: str = "v1.0-mini",
    split: str | Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    *,
    dt: float = 0.1,
    timing: Literal["recorded", "nominal"] = "recorded",
    interpolation: Literal["smooth", "linear"] = "smooth",
    ego_reference: EgoReference = "rear_axle",
    kinds: Sequence[str] | None = None,
    map_margin: float = 60.0,
    cache: bool | str | os.PathLike[str] = True,
) -> SceneSet:
    """Load scenes of nuScenes, or of any data set written in its schema.

    Args:
        dataroot: Folder that holds ``<version>/*.json`` and ``maps/expansion/*.json`` (map
            expansion 1.3).
        version: Folder of the tables.
        split: Name of a split or several (see :func:`splits`), or ``"all"``. Scenes of the split
            that the data set does not have are listed in the report, and a warning counts them.
        scenes: Names or tokens of the scenes to load, in this order, instead of a split; a missing
            one is an error.
        dt: Seconds between steps; must divide 0.5 s, the key-frame interval.
        timing: When key frames were: ``"recorded"``, at their timestamps (0.4 to 0.6 s apart), or
            ``"nominal"``, every 0.5 s, as the paper's released code has it.
        interpolation: Between key frames: ``"smooth"``, cubic smoothing splines (C. H. Reinsch,
            1967) whose slope is the velocity, through the poses of the ego and within the noise of
            the annotations of others; or ``"linear"``, straight lines in position, heading and
            velocity, the velocity at key frames that of the devkit's ``box_velocity``.
        ego_reference: Which point of the recording car its poses are of: ``"rear_axle"``, its
            middle, as nuScenes has them (nuscenes-devkit#108), so that the centre of the box is
            1.385 m ahead; or ``"centre"``. Differs from the paper: its released code takes poses as
            centres.
        kinds: Agent types to keep: ``vehicle``, ``pedestrian``, ``cyclist``, ``motorcycle``,
            ``static``; all by default. The ego is always kept.
        map_margin: How far the map reaches beyond the tracks, metres.
        cache: ``True`` keeps built scenes in :func:`cache_directory`, if there is one, ``False``
            does not, a path names the folder.

    Returns:
        SceneSet: The scenes, in the order of the scene table (or of ``scenes``), and ``.report``.

    Raises:
        DatasetNotFoundError: The data set or a table is missing (also a
            :class:`FileNotFoundError`).
        DatasetError: A file is damaged or contradicts itself; the message names file, record, field
            and value.
        UnknownNameError: No such split, scene or kind.
        ConfigError: An option is out of range.
    """
    if split is not None and scenes is not None:
        raise ConfigError("give split or scenes, not both")
    scenes, kinds = ([one] if isinstance(one, str) else one for one in (scenes, kinds))
    names = list(scenes) if scenes is not None else _names_of_split(split)
    folder, cache_notes = cache_folder(cache)
    loaded, report = _native.load_nuscenes(
        os.fspath(dataroot),
        version,
        names=names,
        exactly=scenes is not None,
        dt=dt,
        timing=timing,
        interpolation=interpolation,
        ego_reference=ego_reference,
        kinds=None if kinds is None else list(kinds),
        map_margin=map_margin,
        cache_directory=folder,
    )
    if '"missing_maps":[]' not in report:
        warnings.warn(
            "no map file for some scenes (report.missing_maps): nothing is off road there, and "
            "figures that need a road are n/a; the map expansion of nuScenes belongs into "
            "maps/expansion, see docs/data.md",
            stacklevel=2,
        )
    without = [scene.name for scene in loaded if scene.has_road and not scene.has_lanes]
    if without:
        warnings.warn(
            f"{len(without)} of {len(loaded)} scenes have a map without lanes ({without[0]}, ...): "
            "none lies near their tracks, or the map expansion is older than version 1.3 and has "
            "no centre lines",
            stacklevel=2,
        )
    if scenes is None and names is not None and '"missing":[]' not in report:
        warnings.warn(
            f"{version} has {len(loaded)} of the {len(names)} scenes of split {split!r} "
            "(report.missing names the others)"
            + ("; its own splits are mini_train and mini_val" * (version == "v1.0-mini")),
            stacklevel=2,
        )
    found = SceneSet(loaded, partial(LoadReport.from_json, report, cache_notes))
    warn_of_lone_egos(found)
    return found


def load_scenarionet(
    path: str | os.PathLike[str], *, ego_reference: EgoReference = "rear_axle"
) -> SceneSet:
    """Load ScenarioNet scenario descriptions: exports of nuScenes, Waymo, nuPlan, Argoverse 2.

    The pickles are read with an unpickler that builds numpy arrays and plain containers only. The
    time step is the data's own. Yellow lines become road dividers, other lines lane dividers,
    sidewalks walkways. The area where vehicles may drive is made from road edges, which have the
    road on their left, and from lanes: their polygons, else 3.5 m. Lanes without links follow
    where one ends and another begins.

    Args:
        path: One ``.pkl`` file, or a folder that is searched for them.
        ego_reference: Which point of the car the ego's poses are of in files made from nuScenes, as
            in :func:`load_nuscenes`; those of others are centres. Such files have the ego's length
            and width swapped, which is mended and noted.

    Returns:
        SceneSet: The scenes in the order of the file names, and ``.report``; the track of
            ``sdc_id`` is ``"ego"`` and comes first. A warning counts the scenes without a drivable
            area.

    Raises:
        DatasetNotFoundError: No such file or folder.
        DatasetError: A file is damaged, asks for another global than the allowed ones, or breaks a
            rule; the message names file, field and value.
        ConfigError: No such ``ego_reference``.
    """
    if ego_reference not in get_args(EgoReference):
        known = " or ".join(map(repr, get_args(EgoReference)))
        raise ConfigError(f"ego_reference is {ego_reference!r}, expected {known}")
    # imported here: reading pickles is not needed to import the package
    from ccdiff_env.scenes.scenarionet import read_scenarios

    scenes = SceneSet(*read_scenarios(path, ego_reference))
    warn_without_road(scenes)
    warn_of_lone_egos(scenes)
    return scenes
