"""Recorded episodes: what all agents did, saved, loaded, and turned into scenes again."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.errors import DatasetError, MissingFeatureError, ShapeError, expect_shape
from ccdiff_env.scenes import Scene, with_tracks
from ccdiff_env.system.fields import documented
from ccdiff_env.system.files import MOST_BYTES, parse_object, read_bytes, reading, write_aside
from ccdiff_env.traffic import TrafficPlan, driver_names
from ccdiff_env.traffic.ccdiff import PLAN_ARRAYS

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]

#: Drivers of rollouts that name none in their own table.
DRIVER_NAMES = ("external", *driver_names())
#: Kinds of events.
EVENT_KINDS = (
    "collision_front", "collision_rear", "collision_side", "static", "off_road", "goal",
    "time_limit",
)  # fmt: skip
FORMAT = "ccdiff-env rollout 2"
#: Tracks of a rollout: type, and axes behind [A, T].
_TRACKS: dict[str, tuple[Any, tuple[int, ...]]] = {
    "position": (np.float32, (2,)),
    "heading": (np.float32, ()),
    "velocity": (np.float32, (2,)),
    "valid": (np.bool_, ()),
    "elevation_m": (np.float32, ()),
}


@documented
@dataclass(frozen=True)
class RolloutEvent:
    """Something that happened."""

    step: int  #: Recorded step at which it is seen first: 0 is the start of the episode.
    agent_id: str  #: The agent that it is about.
    partner_id: str | None  #: The other agent of a collision.
    #: One of :data:`EVENT_KINDS`. Collisions are listed from both sides, by the side of the agent
    #: that is hit; ``static`` is a collision with a static obstacle.
    kind: str
    at_fault: bool = False  #: Whether this agent is at fault.


@documented
@dataclass(frozen=True, eq=False)
class Intention:
    """What the ego's planner meant to do: C candidates of T poses, the one that it drives first."""

    made_at: int  #: Recorded step: pose h is meant for ``made_at + h + 1``.
    #: x, y (m), heading (rad) in the scene's frame, ``[C, T, 3]``.
    trajectories: F32
    costs: F32  #: What the planner says that each costs, ``[C]``; 0 of one alone.


@documented
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Rollout:
    """One episode of one world: states of A agents over T recorded steps, in the scene frame.

    Entries of states are zero where not valid. The state at ``start_step`` comes first.
    """

    scene: Scene  #: The scene that was played.
    start_step: int  #: Step of the log at which the recording starts.
    dt_s: float  #: Seconds between steps.
    agent_ids: tuple[str, ...]  #: All agents, in the order of the scene.
    position: F32  #: Centres, metres, [A, T, 2].
    heading: F32  #: Headings, radians, [A, T].
    velocity: F32  #: Velocities, m/s, [A, T, 2].
    valid: Bool  #: Whether an agent is in the world, [A, T].
    drivers: npt.NDArray[np.int64]  #: Who drives each agent: indices of ``driver_table``, [A].
    #: Name and kind of each driver: those under names of their own are of another kind's.
    driver_table: tuple[tuple[str, str], ...] = tuple((name, name) for name in DRIVER_NAMES)
    events: tuple[RolloutEvent, ...] = ()  #: What happened, by step.
    #: Info columns of the ego (else of the first controlled agent) of each step [T - 1], by name.
    info: Mapping[str, F32] = field(default_factory=dict)
    #: Plans of the background, by the recorded step ``made_at`` from whose states each was made:
    #: sample pose h is at ``made_at + h + 1``.
    plans: tuple[TrafficPlan, ...] = ()
    #: What the ego's planner meant to do, by step; nothing of one that gives actions alone.
    intentions: tuple[Intention, ...] = ()
    #: Seed, configuration, traffic, planner, source: what JSON can hold.
    meta: Mapping[str, Any] = field(default_factory=dict)
    #: Elevation of the ground below each agent, metres, in a scene with levels, [A, T].
    elevation_m: F32 | None = None

    def __post_init__(self) -> None:
        if self.agent_ids != tuple(self.scene.agent_ids):
            raise ShapeError("agent_ids are not those of the scene, in its order")
        if self.valid.ndim != 2 or self.valid.shape[1] < 1:
            raise ShapeError(f"valid has shape {self.valid.shape}, expected [A, T]")
        a, t = len(self.agent_ids), self.valid.shape[1]
        for name, (_, axes) in _TRACKS.items():
            if name != "elevation_m" or self.elevation_m is not None:
                expect_shape(name, getattr(self, name), (a, t, *axes))
        expect_shape("drivers", self.drivers, (a,))
        for name, values in self.info.items():
            expect_shape(f"info[{name!r}]", values, (t - 1,))
        if ("elevation_m" in self.tracks()) != ("elevation_m" in self.scene.tracks()):
            raise DatasetError("elevation_m is required in scenes with levels, and only there")
        for name, values in self.tracks().items():
            if not np.isfinite(values[self.valid]).all():
                raise DatasetError(f"{name} is not finite where valid")
        if not (1e-3 <= self.dt_s <= 10.0 and math.isclose(self.dt_s, self.scene.dt, rel_tol=1e-5)):
            raise DatasetError(f"dt_s is {self.dt_s}, expected {self.scene.dt} of the scene")
        if not 0 <= self.start_step < self.scene.num_steps:
            last = self.scene.num_steps - 1
            raise DatasetError(f"start_step is {self.start_step}, expected 0 to {last} of the log")
        lost = {name for e in self.events for name in (e.agent_id, e.partner_id)}
        lost -= {*self.agent_ids, None}
        if lost:
            raise DatasetError(f"events name agents that are not there: {lost}")
        for what, step in (
            *(("an event", event.step) for event in self.events),
            *(("a plan", plan.made_at) for plan in self.plans),
            *(("an intention", meant.made_at) for meant in self.intentions),
        ):
            if not 0 <= step < t:
                raise DatasetError(f"{what} of step {step}, expected 0 to {t - 1}")
        for plan in self.plans:
            named = np.concatenate([plan.agents, plan.ranking])
            if named.size and not 0 <= named.min() <= named.max() < a:
                raise DatasetError(f"a plan names agents {named}, expected less than {a}")
        for meant in self.intentions:
            shape = (len(meant.costs), *meant.trajectories.shape[1:2], 3)
            expect_shape("intention.trajectories", meant.trajectories, shape)
            if not shape[0] or not np.isfinite(meant.trajectories).all():
                raise DatasetError("an intention has no candidate, or poses that are not finite")
        object.__setattr__(self, "info", dict(self.info))
        object.__setattr__(self, "meta", dict(self.meta))

    def __repr__(self) -> str:
        return (
            f"Rollout({self.scene.name}, {self.num_steps} steps of {self.dt_s:g} s, "
            f"{len(self.agent_ids)} agents, {len(self.plans)} plans, {len(self.events)} events)"
        )

    def tracks(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of all states by name, as those of :meth:`Scene.tracks`."""
        found = {name: getattr(self, name) for name in _TRACKS}
        return {name: array for name, array in found.items() if array is not None}

    @property
    def num_steps(self) -> int:
        """Recorded states T; T - 1 steps lie between them."""
        return int(self.valid.shape[1])

    @property
    def driver_names(self) -> tuple[str, ...]:
        """Name of the driver of each agent."""
        return tuple(self.driver_table[i][0] for i in self.drivers)

    @property
    def driver_kinds(self) -> tuple[str, ...]:
        """Kind of the driver of each agent: its name, unless that is one of the user's own."""
        return tuple(self.driver_table[i][1] for i in self.drivers)

    def collisions(self, agent_id: str | None = None) -> tuple[RolloutEvent, ...]:
        """Collisions, of one agent or of all, as each of their two sides sees them."""
        return tuple(
            event
            for event in self.events
            if event.partner_id is not None and agent_id in (None, event.agent_id)
        )

    def frame(self) -> Any:
        """Return the states as a ``DataFrame`` of pandas: a row per agent and step at which it is
        there, with who it is and who drives it; ``step`` counts from the start, ``time_s`` too.

        Raises:
            MissingFeatureError: Without pandas.
        """
        try:
            pandas: Any = import_module("pandas")
        except ImportError:
            raise MissingFeatureError("a data frame needs pandas: pip install pandas") from None
        agent, step = np.nonzero(self.valid)
        named = {
            "agent": self.agent_ids,
            "type": self.scene.agent_types,
            "driver": self.driver_names,
        }
        x_m, y_m = self.position[agent, step].T
        vx_mps, vy_mps = self.velocity[agent, step].T
        return pandas.DataFrame(
            {
                "step": step,
                "time_s": step * self.dt_s,
                **{name: np.array(texts, object)[agent] for name, texts in named.items()},
                "x_m": x_m,
                "y_m": y_m,
                "heading_rad": self.heading[agent, step],
                "vx_mps": vx_mps,
                "vy_mps": vy_mps,
                "speed_mps": np.hypot(vx_mps, vy_mps),
            }
        )

    def to_scene(self, name: str | None = None) -> Scene:
        """Return a scene whose log is the log before ``start_step``, then this episode.

        Args:
            name: Its name; ``"<name of the scene> rollout"`` by default.

        Returns:
            Scene: Of ``start_step + T`` steps, with the agents that are there at one step at least.
                An environment starts it where this episode started.
        """
        log = dict[str, Any](self.scene.tracks())
        tracks = {
            name: np.concatenate([log[name][:, : self.start_step], array], axis=1)
            for name, array in self.tracks().items()
        }
        for row, there in zip(tracks["heading"], tracks["valid"], strict=True):
            row[there] = np.unwrap(row[there])
        return with_tracks(
            self.scene,
            tracks,
            np.flatnonzero(tracks["valid"].any(axis=1)),
            name=name or f"{self.scene.name} rollout",
            source=f"rollout of {self.scene.source}",
        )

    def to_scenarionet(self, path: str | os.PathLike[str], name: str | None = None) -> None:
        """Write :meth:`to_scene` as a ScenarioNet scenario description (a pickle).

        :func:`ccdiff_env.load_scenarionet` reads it again; so do MetaDrive and other tools that
        take ScenarioNet's format.
        """
        # imported here: writing pickles is not needed to record
        from ccdiff_env.scenes.scenarionet_export import write_scenario

        write_scenario(self.to_scene(name), path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the episode to one file: numpy's ``.npz`` without pickles, the rest as JSON."""
        arrays = {**self.tracks(), "drivers": self.drivers}
        arrays["scene"] = np.frombuffer(self.scene.to_bytes(), np.uint8)
        for name, values in self.info.items():
            arrays[f"info/{name}"] = values
        for i, plan in enumerate(self.plans):
            for name in PLAN_ARRAYS:
                if (array := getattr(plan, name)) is not None:
                    arrays[f"plans/{i}/{name}"] = array
        for i, meant in enumerate(self.intentions):
            arrays[f"intentions/{i}/trajectories"] = meant.trajectories
            arrays[f"intentions/{i}/costs"] = meant.costs
        head = {
            "intentions": [meant.made_at for meant in self.intentions],
            "format": FORMAT,
            "start_step": self.start_step,
            "dt_s": self.dt_s,
            "driver_table": [list(entry) for entry in self.driver_table],
            "events": [dataclasses.astuple(event) for event in self.events],
            "plans": [[p.made_at, list(p.objectives)] for p in self.plans],
            "meta": dict(self.meta),
        }
        arrays["head"] = np.frombuffer(json.dumps(head, allow_nan=False).encode(), np.uint8)
        packed = io.BytesIO()
        np.savez_compressed(packed, **arrays)
        write_aside(Path(path), packed.getvalue())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Rollout:
        """Read what :meth:`save` wrote; nothing in the file is run.

        Raises:
            DatasetNotFoundError: If there is no such file.
            DatasetError: If it is damaged or of another format.
        """
        with reading("rollout", path):
            data = read_bytes(path)
            if data[-22:-18] != b"PK\x05\x06":  # numpy's archives end with their directory's end
                raise DatasetError("cut off, or with bytes after the end")
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                size = sum(member.file_size for member in archive.infolist())
            if size > MOST_BYTES:
                raise DatasetError(f"{size} bytes unpacked, expected at most {MOST_BYTES}")
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                return cls._from_arrays(file)

    @classmethod
    def _from_arrays(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Rollout:
        head = parse_object(arrays["head"].tobytes())
        if head["format"] != FORMAT:
            raise DatasetError(f"format {head['format']!r}, this release reads {FORMAT!r}")
        scene = Scene.from_bytes(arrays["scene"].tobytes())
        plans = tuple(
            _plan(arrays, i, made_at, names) for i, (made_at, names) in enumerate(head["plans"])
        )
        tracks: dict[str, Any] = {
            name: _typed(arrays, name, dtype)
            for name, (dtype, _) in _TRACKS.items()
            if name in arrays or name != "elevation_m"
        }
        drivers = _typed(arrays, "drivers", np.int64)
        table = tuple((str(name), str(kind)) for name, kind in head["driver_table"])
        if drivers.size and not 0 <= drivers.min() <= drivers.max() < len(table):
            raise DatasetError(f"drivers up to {drivers.max()}, expected less than {len(table)}")
        return cls(
            scene=scene,
            start_step=int(head["start_step"]),
            dt_s=float(head["dt_s"]),
            agent_ids=tuple(scene.agent_ids),
            drivers=drivers,
            driver_table=table,
            events=tuple(_event(*fields) for fields in head["events"]),
            info={
                name.removeprefix("info/"): _typed(arrays, name, np.float32)
                for name in arrays
                if name.startswith("info/")
            },
            plans=plans,
            intentions=tuple(
                Intention(
                    int(made_at),
                    _typed(arrays, f"intentions/{i}/trajectories", np.float32),
                    _typed(arrays, f"intentions/{i}/costs", np.float32),
                )
                for i, made_at in enumerate(head.get("intentions", ()))
            ),
            meta=head["meta"],
            **tracks,
        )


def _plan(
    arrays: Mapping[str, npt.NDArray[Any]], i: int, made_at: int, objectives: list[str]
) -> TrafficPlan:
    """Return plan i of a file."""
    fields: dict[str, Any] = {
        name: _typed(arrays, f"plans/{i}/{name}", kind)
        if f"plans/{i}/{name}" in arrays or not optional
        else None
        for name, (kind, _, optional) in PLAN_ARRAYS.items()
    }
    num_samples, _, num_steps, _ = fields["samples"].shape
    return TrafficPlan(
        made_at=int(made_at),
        num_samples=num_samples,
        num_steps=num_steps,
        objectives=tuple(str(name) for name in objectives),
        **fields,
    )


def _typed(arrays: Mapping[str, npt.NDArray[Any]], name: str, dtype: Any) -> npt.NDArray[Any]:
    array = arrays[name]
    if array.dtype != dtype:
        raise DatasetError(f"{name} has dtype {array.dtype}, expected {np.dtype(dtype)}")
    return array


def _event(
    step: int, agent_id: str, partner_id: str | None, kind: str, fault: bool
) -> RolloutEvent:
    if not (isinstance(agent_id, str) and isinstance(partner_id, (str, type(None)))):
        raise DatasetError(f"event of agents {agent_id!r} and {partner_id!r}, expected ids")
    if kind not in EVENT_KINDS:
        raise DatasetError(f"event of kind {kind!r}, expected one of {', '.join(EVENT_KINDS)}")
    return RolloutEvent(int(step), agent_id, partner_id, kind, bool(fault))


def as_scene(rollout: Rollout, name: str | None = None) -> Scene:
    """Return the scene of a recorded episode with the logged path of its ego, to the log's end."""
    ego = rollout.agent_ids.index("ego")
    tracks = dict[str, Any](rollout.scene.tracks())
    shape = (len(rollout.agent_ids), rollout.scene.num_steps - rollout.start_step)
    changed: dict[str, Any] = {}
    for part, recorded in rollout.tracks().items():
        changed[part] = np.zeros(shape + recorded.shape[2:], recorded.dtype)
        changed[part][:, : rollout.num_steps] = recorded
        changed[part][ego] = tracks[part][ego, rollout.start_step :]
    whole = dataclasses.replace(rollout, **changed, events=(), info={}, plans=(), intentions=())
    return whole.to_scene(name or rollout.scene.name)
