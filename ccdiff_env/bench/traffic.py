"""The paper's experiments: who drives K vehicles of each scene, and what comes of it.

The protocol is that of the released evaluation (reference.md#closed-loop-evaluation): an episode
starts at step 31 of the log with the vehicles that are there then and lasts 10 s; nobody enters
later, vehicles vanish with their log, contacts and departures from the road have no consequence.
The K vehicles of the control set are driven by the method, all others replay the log.

Differs from the paper: control sets are found at the start of the episode from the logged history,
by the same ranking for every method, and filled up by nearness, not at random
(reference.md#other-rankings). They hold moving vehicles only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env import causal
from ccdiff_env.bench.episode import Episode, drivable, logged, measure, relations
from ccdiff_env.bench.jobs import Job
from ccdiff_env.bench.scenes import chunks, scene_names, scenes_of
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.worlds import Worlds
from ccdiff_env.errors import ConfigError, DatasetError, UnknownNameError
from ccdiff_env.metrics import Motion
from ccdiff_env.models import guidance_preset, shipped_weights
from ccdiff_env.recorder import Recorder
from ccdiff_env.rollout import Rollout
from ccdiff_env.scenes import Scene, SceneSet
from ccdiff_env.traffic import NETWORKS, PAPER_PROTOCOL

__all__ = ["METHODS", "Method", "episodes", "evaluate", "traffic_jobs"]

#: Step of the log at which an episode starts (released: ``history_num_frames + 1``).
START_STEP: int = PAPER_PROTOCOL["history_steps"]
HORIZON_STEPS: int = PAPER_PROTOCOL["horizon_steps"]
#: Scenes that share a batch of the network: fixed, so that results do not depend on the workers.
CHUNK = 12
#: Speed below which a logged vehicle counts as standing, m/s.
STANDING_MPS = 0.5


@dataclass(frozen=True)
class Method:
    """A way to drive the vehicles of the control set.

    Parameters
    ----------
    label
        Name in tables.
    driver
        Driver of the control set, as :class:`~ccdiff_env.config.WorldConfig` names them.
    ranking
        ``cliques``, ``distance``, ``first`` or ``random``: who is in the control set. With
        ``greedy`` and ``gradient``, CCDiff finds the set itself, at its first plan. With
        ``given``, lists name it (:func:`~ccdiff_env.traffic.read_ranking`).
    ccdiff
        Fields of :class:`~ccdiff_env.traffic.CcdiffConfig`, where a network drives.
    num_guided
        Vehicles of the control set that guidance moves (the paper's mask of the top K); all of it
        for ``None``.
    guidance
        What differs from the preset that ``ccdiff`` names.
    """

    label: str
    driver: str
    ranking: str = "cliques"
    ccdiff: Mapping[str, Any] = field(default_factory=dict)
    num_guided: int | None = None
    guidance: Mapping[str, Any] = field(default_factory=dict)

    def options(self) -> dict[str, Any]:
        """Return ``ccdiff`` with the whole guidance where it differs from a preset."""
        if not self.guidance:
            return dict(self.ccdiff)
        preset = guidance_preset(self.ccdiff["guidance"])
        return {**self.ccdiff, "guidance": {**preset, **self.guidance}}


_GUIDED: dict[str, Any] = {"criticality": 1.0, "num_samples": 5, "guidance": "rl"}

#: Objectives that seek speed on the road. The loss has a gradient above its limit only, therefore
#: the limit is a walking pace; what counts as over-speed is decided by the metric.
_OVER_SPEED = [
    {"kind": "over_speed", "weight": -1.0, "limit_mps": 1.0},
    {"kind": "map_collision", "weight": 1.0},
]

#: Rankings that only a planning network can make.
OWN_RANKINGS = ("greedy", "gradient")


class _Methods(dict[str, Method]):
    """Methods by name; a model of one's own is named by its path, ``module:Class``."""

    def __contains__(self, name: object) -> bool:
        return super().__contains__(name) or ":" in str(name)

    def __missing__(self, name: str) -> Method:
        if ":" not in name:
            raise KeyError(name)
        return Method(name.partition(":")[2], name)


#: The methods by name. More may be added: a driver is all that one needs.
METHODS: dict[str, Method] = _Methods(
    {
        "replay": Method("Log replay", "replay"),
        "constant_velocity": Method("Constant velocity", "constant_velocity"),
        "idm": Method("IDM", "idm"),
        "ccdiff": Method("CCDiff", "ccdiff", ccdiff=_GUIDED),
        "ccdiff_unguided": Method("CCDiff, no guidance", "ccdiff", ccdiff={"num_samples": 5}),
        "ccdiff_one_sample": Method("CCDiff, no guidance, N=1", "ccdiff"),
        "ccdiff_one_step": Method(
            "CCDiff, one denoising step", "ccdiff", ccdiff={**_GUIDED, "denoising_steps": 1}
        ),
        "ccdiff_one_step_unguided": Method(
            "CCDiff, one denoising step, no guidance",
            "ccdiff",
            ccdiff={"num_samples": 5, "denoising_steps": 1},
        ),
        "ccdiff_one_step_one_sample": Method(
            "CCDiff, one denoising step, no guidance, N=1", "ccdiff", ccdiff={"denoising_steps": 1}
        ),
        "ccdiff_distance": Method("CCDiff, ranking by distance", "ccdiff", "distance", _GUIDED),
        "ccdiff_first": Method("CCDiff, scene's order", "ccdiff", "first", _GUIDED),
        "ccdiff_random": Method("CCDiff, random ranking", "ccdiff", "random", _GUIDED),
        "ccdiff_greedy": Method("CCDiff, greedy cliques on G", "ccdiff", "greedy", _GUIDED),
        "ccdiff_gradient": Method("CCDiff, aligned gradients", "ccdiff", "gradient", _GUIDED),
        "ccdiff_human": Method("CCDiff, listed by a person", "ccdiff", "given", _GUIDED),
        "ccdiff_no_enc": Method(
            "CCDiff, no causal graph", "ccdiff", ccdiff={**_GUIDED, "graph": "full"}
        ),
        "ccdiff_top2": Method(
            "CCDiff, the first two guided", "ccdiff", ccdiff=_GUIDED, num_guided=2
        ),
        "ccdiff_released": Method(
            "CCDiff, released guidance", "ccdiff", ccdiff={**_GUIDED, "guidance": "released"}
        ),
    }
)

#: The networks of the paper's table, CTG++, and CCDiff trained as they were, by name.
_NETWORKS = {
    "simnet": "SimNet",
    "trafficsim": "TrafficSim",
    "trafficsim_port": "TrafficSim, as ported",
    "strive": "STRIVE",
    "bits": "BITS",
    "ctg": "CTG",
    "ctgpp": "CTG++",
    "ccdiff_equal": "CCDiff, equal training",
}
for _name, _label in _NETWORKS.items():
    # a regression has one plan
    _own: dict[str, Any] = {"num_samples": 1 if _name == "simnet" else 5}
    _driver = _name.removesuffix("_equal")
    if _driver != _name:
        _own["weights"] = str(shipped_weights(_name))
    METHODS[_name] = Method(_label, _driver, ccdiff={**_GUIDED, **_own})
    METHODS[f"{_name}_unguided"] = Method(f"{_label}, no guidance", _driver, ccdiff=_own)
# BITS chooses among its plans; moving them as well is its other composition
METHODS["bits_guided"] = dataclasses.replace(METHODS["bits"], label="BITS, plans moved as well")
METHODS["bits"] = dataclasses.replace(METHODS["bits"], guidance={"gradient_steps": 0})
for _name in ("ccdiff", "ccdiff_equal", "ctg"):
    METHODS[f"{_name}_over_speed"] = dataclasses.replace(
        METHODS[_name],
        label=f"{METHODS[_name].label}, over-speed",
        guidance={"objectives": _OVER_SPEED},
    )

#: Methods of the paper's table with shipped weights, each guided and not: ``--methods all``.
PAPER_METHODS: tuple[str, ...] = tuple(
    f"{name}{suffix}"
    for name in (*_NETWORKS, "ccdiff")
    if shipped_weights(name).exists()
    for suffix in ("", "_unguided")
)

#: Methods that differ from ``ccdiff`` in who comes first: the same where all are controlled.
_REORDERED = {
    name
    for name, method in METHODS.items()
    if method.ccdiff is _GUIDED and method.ranking != "cliques"
}


def traffic_jobs(
    source: Mapping[str, str],
    methods: Sequence[str],
    *,
    num_controlled: Sequence[int | None] = (1, 2, 3, 4, 5, 10, None),
    replan_steps: Sequence[int] = (5,),
    replan_controlled: Sequence[int | None] | None = None,
    listed: Mapping[str, Sequence[str]] | None = None,
    seed: int = 0,
) -> list[Job]:
    """Return the jobs of a traffic benchmark: methods x K x replan period x pieces of the scenes.

    The floor, K = 0, is always among them. What cannot differ is not played twice: other periods of
    methods that do not plan, and all vehicles by another ranking than that of ``ccdiff``, where
    that one is asked for.

    Parameters
    ----------
    source
        The scenes, see :func:`ccdiff_env.bench.scenes.source_of`.
    methods
        Names of :data:`METHODS`.
    num_controlled
        Numbers of controlled vehicles K; ``None`` is all.
    replan_steps
        Steps between plans; only networks have any use for them.
    replan_controlled
        Those K at which all periods are played, the first one alone at the others; all K for
        ``None``.
    listed
        Ids of vehicles by scene name, most important first, for ``ccdiff_human``.
    seed
        Seed of the episodes.

    Raises
    ------
    UnknownNameError
        For a method that does not exist.
    ConfigError
        For ``ccdiff_human`` without lists.
    DatasetError
        If scenes have no list, or a list names what cannot be controlled or names it twice.
    """
    for name in methods:
        if name not in METHODS:
            raise UnknownNameError(f"no method {name!r}, there are {', '.join(METHODS)}")
    names = scene_names(source)
    lists: Mapping[str, Sequence[str]] = {}
    if "ccdiff_human" in methods:
        if listed is None:
            raise ConfigError(
                "method 'ccdiff_human' needs lists of vehicles, as --human names them"
            )
        lists = _checked(listed, scenes_of(source))
    conditions: list[tuple[str, int | None, int]] = [("replay", 0, 5)]
    for method in (m for m in methods if m != "replay"):
        for k in num_controlled:
            if k is None and method in _REORDERED and "ccdiff" in methods:
                continue
            every = METHODS[method].driver in NETWORKS and k in (replan_controlled or (k,))
            conditions += [(method, k, n) for n in (replan_steps if every else replan_steps[:1])]
    return [
        Job(
            f"{method}-K{'Full' if k is None else k}-T{n}-{i:03d}",
            f"{__name__}:evaluate",
            {
                "source": dict(source),
                "names": piece,
                "method": method,
                "num_controlled": k,
                "replan_steps": n,
                "seed": seed,
                **(
                    {"lists": {scene: list(lists[scene]) for scene in piece}}
                    if METHODS[method].ranking == "given"
                    else {}
                ),
            },
        )
        for method, k, n in conditions
        for i, piece in enumerate(chunks(names, CHUNK))
    ]


def _checked(lists: Mapping[str, Sequence[str]], scenes: SceneSet) -> Mapping[str, Sequence[str]]:
    """Return lists of vehicles if every scene has one, of vehicles that may be controlled."""
    missing = [scene.name for scene in scenes if scene.name not in lists]
    if missing:
        raise DatasetError(f"lists of vehicles: none for {', '.join(missing)}")
    for scene in scenes:
        known = {scene.agent_ids[i] for i in _vehicles(scene)}
        listed = lists[scene.name]
        for k, agent in enumerate(listed):
            if agent not in known:
                raise DatasetError(
                    f"lists of vehicles: {scene.name}: {agent!r}, expected a vehicle that is on "
                    f"the road at step {START_STEP}: {', '.join(sorted(known))}"
                )
            if agent in listed[:k]:
                raise DatasetError(f"lists of vehicles: {scene.name}: {agent!r} twice")
    return lists


def _vehicles(scene: Scene) -> npt.NDArray[np.int64]:
    """Vehicles that are there, and on the road, at the start; the ego in any case (as released)."""
    there = scene.tracks()["valid"][:, START_STEP] & (np.array(scene.agent_types) == "vehicle")
    agents = np.flatnonzero(there)
    start = logged(scene, agents, slice(START_STEP, START_STEP + 1))
    off_road = start.off_road(drivable(scene)).centroid[:, 0]
    kept: npt.NDArray[np.int64] = agents[~off_road | (np.array(scene.agent_ids)[agents] == "ego")]
    return kept


def control_set(
    scene: Scene,
    ranking: str,
    top_k: int | None,
    seed: int = 0,
    *,
    listed: Sequence[str] = (),
) -> list[int]:
    """Return the first K moving vehicles of a ranking at the start of the episode.

    With ``given`` they are those that are ``listed`` by their ids. A short list is filled up by
    time to contact, then distance. Vehicles that stand at the start never move in CCDiff traffic:
    all rankings pass them over. ``None`` is all vehicles, the standing ones last.
    """
    agents = _vehicles(scene)
    velocity = scene.tracks()["velocity"][agents, START_STEP]
    moving = np.linalg.norm(velocity, axis=-1) > STANDING_MPS
    order = {scene.agent_ids[agent]: i for i, agent in enumerate(agents)}
    history = relations(scene, agents, START_STEP)
    ranked = causal.rank(
        ranking,  # type: ignore[arg-type]
        top_k=len(agents),
        valid=np.ones(len(agents), bool),
        ttc=history.ttc,
        distance=history.distance,
        agents=[order[name] for name in listed],
        seed=seed,
    )
    movers = [int(agents[i]) for i in ranked.agents if moving[i]]
    if top_k is not None:
        return movers[:top_k]
    return movers + [int(agents[i]) for i in ranked.agents if not moving[i]]


def episodes(
    scenes: SceneSet,
    method: Method,
    *,
    num_controlled: int | None,
    replan_steps: int = 5,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    record: Collection[str] = (),
    explain: bool = False,
    lists: Mapping[str, Sequence[str]] | None = None,
) -> list[Episode]:
    """Play every scene once, all in one batch.

    Parameters
    ----------
    scenes
        The scenes.
    method
        Who drives the control set.
    num_controlled
        K; all for ``None``, 0 replays the log.
    replan_steps
        Steps between plans of a network.
    seed
        Seed of every episode.
    options
        Further fields of :class:`~ccdiff_env.config.WorldConfig`.
    record
        Names of the scenes to record; it changes nothing.
    explain
        Whether guided plans say how their gradients agree; it changes nothing else.
    lists
        Ids of vehicles by scene name, for the ranking ``given``.
    """
    # the control set is named below, so that everybody else replays the log by its driver
    ccdiff = {
        **PAPER_PROTOCOL["ccdiff"],
        "others": "ccdiff",
        "criticality": 0.0,
        "num_samples": 1,
        "replan_steps": replan_steps,
        **method.options(),
    }
    own = method.ranking in OWN_RANKINGS and num_controlled != 0
    if own:
        ccdiff |= {"ranking": method.ranking, "others": "replay", "num_guided": num_controlled}
    # only guidance has gradients to tell of
    ccdiff["explain"] = explain and ccdiff["criticality"] > 0.0
    config = WorldConfig().with_options(
        **{
            **PAPER_PROTOCOL,
            "traffic": method.driver,
            "driver": "replay",
            "autoreset": "disabled",
            "dt_s": scenes[0].dt,
            "ccdiff": ccdiff,
            **(options or {}),
        }
    )
    # a model given by its path drives under a name
    driver = config.traffic if isinstance(config.traffic, str) else method.driver
    worlds = Worlds(scenes, config, num_worlds=len(scenes), num_threads=1)
    out, native = worlds.arrays(), worlds.native
    everyone = list(range(len(scenes)))
    native.reset([seed] * len(scenes), list(everyone), None, out)
    chosen = [
        _vehicles(scene).tolist()
        if own
        else control_set(
            scene, method.ranking, num_controlled, seed, listed=(lists or {}).get(scene.name, ())
        )
        for scene in scenes
    ]
    for i in everyone:
        kinds = np.array(scenes[i].agent_types) == "vehicle"
        native.assign(i, np.flatnonzero(kinds).tolist(), "replay")
        if chosen[i]:
            native.assign(i, chosen[i], driver)
        if method.driver in NETWORKS and not own:
            native.command(i, guided=chosen[i][: method.num_guided], criticality=None)
    states = [[native.states(i)] for i in everyone]
    plans: list[list[dict[str, Any]]] = [[] for _ in everyone]
    recorders = {
        i: Recorder(worlds, world_idx=i, method=method.label)
        for i in everyone
        if scenes[i].name in record
    }
    for recorder in recorders.values():
        recorder.start()
    actions = np.zeros((len(scenes), 1, native.action_width), np.float32)
    running = list(everyone)
    for step in range(HORIZON_STEPS):
        if out.done.any():
            break
        native.step(actions, out)
        for i in running:
            states[i].append(native.states(i))
            plan = native.explain(i) if method.driver in NETWORKS else None
            if plan is not None and plan["made_at"] == step:
                plans[i].append(plan)
        for recorder in recorders.values():
            recorder.step()
    if own:
        chosen = [p[0]["agents"][p[0]["executed"]].tolist() if p else [] for p in plans]
    found = [_episode(scenes[i], chosen[i], states[i], plans[i]) for i in everyone]
    for i, recorder in recorders.items():
        found[i].recorded = recorder.rollout()
    return found


def _episode(
    scene: Scene, chosen: Sequence[int], states: Sequence[Any], plans: list[dict[str, Any]]
) -> Episode:
    agents = _vehicles(scene)
    stacked = {
        name: np.stack([s[name] for s in states], axis=1)[agents]
        for name in ("position", "heading", "active")
    }
    return Episode(
        scene=scene,
        agents=agents,
        chosen=list(chosen),
        controlled=np.isin(agents, chosen),
        history=relations(scene, agents, START_STEP),
        start_step=START_STEP,
        motion=Motion(
            stacked["position"],
            stacked["heading"],
            scene.sizes[agents][:, :2],
            stacked["active"],
            dt_s=scene.dt,
        ),
        log=logged(scene, agents, slice(START_STEP, START_STEP + len(states))),
        position=stacked["position"],
        heading=stacked["heading"],
        plans=plans,
    )


def evaluate(**arguments: Any) -> list[dict[str, Any]]:
    """Play scenes and measure them: one dictionary per scene, see docs/evaluation.md.

    The arguments are those of :func:`evaluate_recorded` but ``record``.
    """
    return evaluate_recorded(**arguments)[0]


def evaluate_recorded(
    *,
    source: Mapping[str, str],
    names: Sequence[str],
    method: str,
    num_controlled: int | None,
    replan_steps: int,
    seed: int,
    lists: Mapping[str, Sequence[str]] | None = None,
    record: Collection[str] = (),
) -> tuple[list[dict[str, Any]], dict[str, Rollout]]:
    """Do the same as :func:`evaluate`, and record some scenes."""
    played = episodes(
        scenes_of(source, names),
        METHODS[method],
        num_controlled=num_controlled,
        replan_steps=replan_steps,
        seed=seed,
        record=record,
        explain=True,
        lists=lists,
    )
    rows = [measure(episode, replan_steps) for episode in played]
    return rows, {e.scene.name: e.recorded for e in played if e.recorded is not None}
