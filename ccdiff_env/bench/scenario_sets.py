"""Scenario sets: episodes that safety-critical traffic made against one ego, with a manifest.

A set is a folder of recorded episodes (:class:`~ccdiff_env.Rollout`) and ``manifest.json``, which
says against which ego they were made, how, and what each one holds, with the SHA-256 of every file.
The traffic of an episode can be replayed to another planner.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from ccdiff_env.bench.methods import on_device
from ccdiff_env.bench.planners import TRAFFIC, drive
from ccdiff_env.bench.provenance import scene_hashes, sha256_of
from ccdiff_env.bench.scenes import scenes_of, source_title
from ccdiff_env.bench.traffic import driven, logged
from ccdiff_env.errors import DatasetError, DatasetNotFoundError, UnknownNameError
from ccdiff_env.record.counterfactual import rollout_avoidability
from ccdiff_env.record.rollout import Rollout, RolloutEvent, as_scene
from ccdiff_env.scenes import Scene
from ccdiff_env.system.files import (
    file_name,
    parsed_object,
    read_text,
    reading,
    write_aside,
)

FORMAT = "ccdiff-env scenarios 1"
MANIFEST = "manifest.json"
#: Episodes go on to the end of the horizon, so that slower egos meet the same traffic.
OPTIONS: Mapping[str, Any] = {"terminate_at_goal": False}


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One recorded episode of a set.

    Args:
        scene, token, scene_hash: Name of the scene it started from, its token in the data set, hash
            of its content.
        motion_hash: SHA-256 of who was where: that of the file depends on who compressed it.
        file, sha256: File of the episode in the folder of the set, and its hash.
        collision: Whether the ego that the set was made against collides before it reaches its
            goal.
        kind, partner, time_s, at_fault: First collision of the ego: side of the ego, the other
            agent, time, and whether any of its collisions counts against it; ``None`` and false
            without a collision.
        avoidable: Whether the ego could have stayed free of collisions, the others doing as
            recorded: true where it did. False means that none of the plans tried does.
        realism_cost: Mean total variation of the guided plans in [0, 1], the paper's C(tau).
        shift_sigmas: The same in standard deviations, which does not saturate; ``None`` in earlier
            sets.
        fde_m: Mean distance from the log at the last common step of the vehicles that CCDiff
            drives.
    """

    scene: str
    token: str
    file: str
    sha256: str
    collision: bool
    kind: str | None
    partner: str | None
    time_s: float | None
    at_fault: bool
    avoidable: bool
    realism_cost: float | None
    fde_m: float | None
    shift_sigmas: float | None = None
    scene_hash: str = ""
    motion_hash: str = ""


@dataclass(frozen=True, kw_only=True)
class ScenarioSet:
    """Scenarios made against one ego.

    Args:
        folder: Where the files are.
        generator: The ego that the traffic was made against, as planners are named.
        traffic: Name of the traffic, see :data:`ccdiff_env.bench.planners.TRAFFIC`.
        seed: Seed of every episode.
        weights: SHA-256 of the weights that drove.
        source: Where the scenes come from, a text of :func:`ccdiff_env.load`.
        settings: Further settings: those of the traffic, the plans tried to avoid a collision.
        scenarios: What there is.
        version: Release that made it.
    """

    folder: Path
    generator: str
    traffic: str
    seed: int
    weights: str
    source: str
    settings: Mapping[str, Any]
    scenarios: tuple[Scenario, ...]
    version: str = ""

    @property
    def digest(self) -> str:
        """SHA-256 of settings and episodes: equal sets, on any machine, of data in any place."""
        head = [self.generator, self.traffic, self.seed, dict(self.settings)]
        parts = [*head, [[s.scene, s.scene_hash, s.motion_hash] for s in self.scenarios]]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def find(self, scene: str) -> Scenario:
        """Return the scenario of a scene; raises :class:`UnknownNameError` if there is none."""
        for scenario in self.scenarios:
            if scenario.scene == scene:
                return scenario
        raise UnknownNameError(f"no scenario of scene {scene!r} in {self.folder}")

    def rollout(self, scene: str) -> Rollout:
        """Return the recorded episode of a scene; raises if there is none, or its file is not
        that of the manifest.
        """
        scenario = self.find(scene)
        _check(self.folder, scenario)
        found = Rollout.load(self.folder / scenario.file)
        if found.scene.name != scene:
            raise DatasetError(f"{scenario.file} is of scene {found.scene.name!r}, not {scene!r}")
        return found

    def scene(self, scene: str) -> Scene:
        """Return a scene in which the others do as recorded, to be played with other egos.

        The ego's own log stays in it, so that route, goal and progress are the same in every set.
        """
        return as_scene(self.rollout(scene))


def generate(
    *,
    source: str,
    names: Sequence[str],
    generator: str,
    traffic: str,
    seed: int,
    folder: str,
    num_plans: int,
    device: str = "cpu",
) -> list[dict[str, Any]]:
    """Make scenarios against an ego and save them: one dictionary per scene.

    ``num_plans`` ego plans are tried to avoid a collision.

    Returns:
        list of dict: ``scenario``: the fields of :class:`Scenario`.
    """
    hashes, drivers = scene_hashes(source, names), on_device(TRAFFIC[traffic], device)
    scenes = scenes_of(source, names)
    _, rollouts = drive(scenes, generator, drivers, seed=seed, options=OPTIONS, record=names)
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    found = []
    for name in names:
        rollout = rollouts[name]
        file = file_name(name, ".npz")
        rollout.save(place / file)
        hits = ego_collisions(rollout)
        verdict = rollout_avoidability(rollout, num_samples=num_plans) if hits else None
        first = hits[0] if hits else None
        scenario = Scenario(
            scene=name,
            token=rollout.scene.token,
            file=file,
            sha256=sha256_of(place / file),
            collision=bool(hits),
            kind=None if first is None else first.kind,
            partner=None if first is None else first.partner_id,
            time_s=None if first is None else round(first.step * rollout.dt_s, 3),
            at_fault=any(event.at_fault for event in hits),
            avoidable=verdict is None or verdict.avoidable,
            **realism(rollout),
            scene_hash=hashes[name],
            motion_hash=_motion_hash(rollout),
        )
        found.append({"scenario": asdict(scenario)})
    return found


def _motion_hash(rollout: Rollout) -> str:
    arrays = (rollout.position, rollout.heading, rollout.velocity, rollout.valid, rollout.drivers)
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def ego_collisions(rollout: Rollout) -> tuple[RolloutEvent, ...]:
    """Return the collisions of the ego before it reaches its goal, as the ego sees them."""
    goal = next((e.step for e in rollout.events if e.kind == "goal"), rollout.num_steps)
    return tuple(event for event in rollout.collisions("ego") if event.step <= goal)


def realism(rollout: Rollout) -> dict[str, Any]:
    """Return how far the vehicles that follow plans are from the log, and what guidance cost."""
    moved = {int(agent) for plan in rollout.plans for agent in plan.agents[plan.follows_plan]}
    agents = np.array([i for i in sorted(moved) if rollout.agent_ids[i] != "ego"], np.int64)
    guided = [plan for plan in rollout.plans if plan.guided.any()]

    def mean(name: str) -> float | None:
        values = [getattr(plan, name)[plan.guided] for plan in guided]
        found = np.concatenate(values).mean() if values else np.nan
        return float(found) if np.isfinite(found) else None

    simulated = driven(rollout, agents)
    steps = slice(rollout.start_step, rollout.start_step + rollout.num_steps)
    log = logged(rollout.scene, agents, steps)
    fde = simulated.displacement(log).mean()[1]
    return {
        "realism_cost": mean("realism_cost"),
        "shift_sigmas": mean("shift_sigmas"),
        "fde_m": fde if np.isfinite(fde) else None,
    }


def write_manifest(made: ScenarioSet) -> Path:
    """Write the manifest of a set into its folder; returns its path."""
    fields = {"format": FORMAT, "version": made.version, **asdict(made)}
    fields.pop("folder")
    path = made.folder / MANIFEST
    write_aside(path, json.dumps(fields, indent=1, allow_nan=False) + "\n")
    return path


def load_scenario_set(path: str | os.PathLike[str]) -> ScenarioSet:
    """Read a set and check its files against the manifest.

    Args:
        path: Folder of the set, or its manifest.

    Raises:
        DatasetNotFoundError: If there is no manifest, or a file that it names is missing.
        DatasetError: If the manifest is damaged or of another format, or a file is not the one that
            it names.
    """
    place = Path(path)
    manifest = place / MANIFEST if place.is_dir() else place
    if not manifest.exists():
        raise DatasetNotFoundError(f"no scenario set at {manifest}")
    with reading("manifest", manifest):
        fields = parsed_object(read_text(manifest))
        known = fields.pop("format", None)
        if known != FORMAT:
            raise DatasetError(f"format {known!r}, this release reads {FORMAT!r}")
        scenarios = tuple(Scenario(**entry) for entry in fields.pop("scenarios"))
        found = ScenarioSet(folder=manifest.parent, scenarios=scenarios, **fields)
        for scenario in scenarios:
            _check_kinds(scenario)
        _check_kinds(found)
        source_title(found.source)
        if len({scenario.scene for scenario in scenarios}) != len(scenarios):
            raise ValueError("two scenarios of one scene")
    for scenario in scenarios:
        _check(found.folder, scenario)
    return found


def _check_kinds(entry: Scenario | ScenarioSet) -> None:
    """Refuse values of another kind than their annotations say."""
    for name, hint in get_type_hints(type(entry)).items():
        value = getattr(entry, name)
        kinds = get_args(hint) if get_origin(hint) is UnionType else (get_origin(hint) or hint,)
        if type(value) is int and float in kinds:
            continue
        if (isinstance(value, bool) and bool not in kinds) or not isinstance(value, kinds):
            raise ValueError(f"{name} {value!r}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} {value}")


def _check(folder: Path, scenario: Scenario) -> None:
    if not isinstance(scenario.file, str) or Path(scenario.file).name != scenario.file:
        raise DatasetError(f"file {scenario.file!r} is not in the folder of the set: {folder}")
    path = folder / scenario.file
    with reading(f"file of scene {scenario.scene!r}", path):
        got = sha256_of(path)
    if got != scenario.sha256:
        raise DatasetError(
            f"file of scene {scenario.scene!r} has SHA-256 {got}, the manifest says "
            f"{scenario.sha256}: {path}"
        )
