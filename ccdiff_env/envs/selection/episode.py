"""One episode of adversary selection: what happened, and what it is worth."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.envs.key_agents import KeyRanking, rank_agents
from ccdiff_env.envs.selection.options import SelectionReward
from ccdiff_env.record.counterfactual import rollout_avoidability
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.worlds import Worlds
from ccdiff_env.worlds.spaces import InfoColumn

__all__ = ["INFO_COLUMNS", "Outcome", "SelectionEpisode"]

F32 = npt.NDArray[np.float32]

#: Figures of a decision, keys of ``info``.
INFO_COLUMNS: tuple[InfoColumn, ...] = (
    InfoColumn("reward_collision", "", "weighted reward of collisions that count"),
    InfoColumn(
        "reward_realism", "", "weighted reward of the realism cost of the adversaries' plans"
    ),
    InfoColumn("reward_off_road", "", "weighted reward of adversaries off the road"),
    InfoColumn("reward_comfort", "", "weighted reward of the adversaries' discomfort"),
    InfoColumn("collisions", "", "collisions that count, begun in the decision"),
    InfoColumn("ego_collision", "", "1 if the ego begins to touch anybody in the decision"),
    InfoColumn("ego_at_fault", "", "1 if such a collision counts against the ego"),
    InfoColumn(
        "realism_cost", "", "total variation of guided from unguided actions, mean of guided agents"
    ),
    InfoColumn("shift_sigmas", "", "the same in standard deviations, which does not saturate"),
    InfoColumn("off_road", "", "share of the adversaries' steps off the road"),
    InfoColumn("discomfort", "", "discomfort of the adversaries, mean over steps"),
    InfoColumn("num_adversaries", "", "adversaries of the decision"),
    InfoColumn(
        "graph_sparsity", "", "share of pairs of planned agents that the causal graph leaves out"
    ),
    InfoColumn("steps", "", "steps of the world in the decision"),
)


@dataclass
class Outcome:
    """What one decision led to."""

    #: Info columns by name, as in :data:`INFO_COLUMNS`.
    info: dict[str, float] = field(default_factory=dict)
    #: Whether the ego's episode ended by what happened, and whether it was cut off.
    terminated: bool = False
    truncated: bool = False
    #: Ids of the adversaries, and pairs of ids whose collision counts.
    adversaries: list[str] = field(default_factory=list)
    pairs: list[tuple[str, str]] = field(default_factory=list)

    @property
    def reward(self) -> float:
        """Sum of the components."""
        names = ("collision", "realism", "off_road", "comfort")
        return sum(self.info[f"reward_{name}"] for name in names)


class SelectionEpisode:
    """The present episode of one world.

    Parameters
    ----------
    worlds
        The worlds.
    world_idx
        Which of them.
    reward
        Weights.
    """

    def __init__(self, worlds: Worlds, world_idx: int, reward: SelectionReward) -> None:
        self._worlds, self._world_idx, self._weights = worlds, world_idx, reward
        native = worlds.native
        status = native.status(world_idx)
        self._scene = worlds.scenes[status.scene_idx]
        self.ids = self._scene.agent_ids
        self.ego = int(native.slot_agents(world_idx)[0] or 0)
        self._size = self._scene.sizes[:, :2].copy()
        self._touching = {(i, j) for i, j, *_ in native.contacts(world_idx)}
        self._ever: set[int] = set()
        self.before: frozenset[int] = frozenset()
        names = ("collisions", "realism_cost", "shift_sigmas", "decisions", "adversaries")
        self.totals = dict.fromkeys(names, 0.0)
        self._history: deque[dict[str, Any]] = deque(maxlen=round(3.0 / worlds.config.dt_s) + 1)
        self._from_log(status.step_idx)
        self._recorder: Recorder | None = None
        if reward.avoidable_only:
            self._recorder = Recorder(SimpleNamespace(worlds=worlds), world_idx=world_idx)
            self._recorder.start()

    def _from_log(self, step: int) -> None:
        tracks = self._scene.tracks()
        for t in range(max(step + 1 - (self._history.maxlen or 1), 0), step):
            velocity = tracks["velocity"][:, t]
            self._history.append(
                {
                    "position": tracks["position"][:, t],
                    "heading": tracks["heading"][:, t],
                    "speed": np.linalg.norm(velocity, axis=-1).astype(np.float32),
                    "active": tracks["valid"][:, t],
                }
            )
        self.states: dict[str, Any] = dict(self._worlds.native.states(self._world_idx))
        self._history.append(self.states)

    def candidates(self) -> npt.NDArray[np.bool_]:
        """Return the agents [A] that the policy drives and can guide."""
        drivers = self._worlds.native.drivers(self._world_idx)
        driven = np.array([name == self._worlds.config.traffic for name in drivers])
        moving = np.array([kind == "vehicle" for kind in self._scene.agent_types])
        driven &= moving & self.states["active"]
        driven[self.ego] = False
        return driven

    def rank(self, ranking: KeyRanking, seed: int = 0) -> list[int]:
        """Return the candidates by falling importance, from the last three seconds."""
        stacked = {
            name: np.stack([states[name] for states in self._history], axis=1)
            for name in ("position", "heading", "speed", "active")
        }
        return rank_agents(
            ranking,
            position=stacked["position"],
            heading=stacked["heading"],
            speed=stacked["speed"],
            size=self._size,
            valid=stacked["active"],
            candidates=self.candidates(),
            ego_idx=self.ego,
            seed=seed,
        )

    def rows(self, num_rows: int) -> list[int]:
        """Return the candidates that the adversary policy sees, nearest first."""
        return self.rank("nearest")[:num_rows]

    def observe(self, num_rows: int) -> dict[str, npt.NDArray[Any]]:
        """Return what the adversary policy sees, with so many rows of candidates."""
        rows = self.rows(num_rows)
        native, before = self._worlds.native, sorted(self.before)
        return {
            **native.candidates(self._world_idx, rows, before, num_rows),
            "mask": (np.arange(num_rows) < len(rows)).astype(np.int8),
            "time_left": np.array([self.time_left()], np.float32),
        }

    def time_left(self) -> float:
        """Return the share of the episode that is left."""
        elapsed = self._worlds.native.status(self._world_idx).elapsed_steps
        horizon = self._worlds.config.horizon_steps
        return max(horizon - elapsed, 0) / horizon

    def plan(self) -> TrafficPlan | None:
        """Return what the policy says about its latest plan, ``None`` before the first one."""
        return self._worlds.explain(self._world_idx)

    def begin(self, adversaries: list[int]) -> None:
        """Begin a decision."""
        self.before = frozenset(adversaries)
        self._ever.update(adversaries)
        self._outcome = Outcome(adversaries=[self.ids[i] for i in adversaries])
        self._counts = {"collisions": 0.0, "ego_collision": 0.0, "ego_at_fault": 0.0}
        self._off_road: list[float] = []
        self._discomfort: list[float] = []
        self._steps = 0

    def step(self) -> None:
        """Look at the world after one of its steps."""
        native, world = self._worlds.native, self._world_idx
        states: dict[str, Any] = dict(native.states(world))
        found = native.step_metrics(world, sorted(self.before))
        if found["num_agents"]:
            self._off_road.append(found["off_road"])
            self._discomfort.append(found["discomfort"])
        self._contacts()
        if self._recorder is not None:
            self._recorder.step()
        self.states = states
        self._history.append(states)
        self._steps += 1

    def _contacts(self) -> None:
        touching = set()
        found = self._worlds.native.contacts(self._world_idx)
        fault = {(i, j): at_fault for i, j, _, _, at_fault in found}
        for i, j in fault:
            touching.add((i, j))
            if (i, j) in self._touching:
                continue
            if i == self.ego:
                self._counts["ego_collision"] = 1.0
                self._counts["ego_at_fault"] = max(self._counts["ego_at_fault"], float(fault[i, j]))
            if i < j and self._is_counted(i, j, fault):
                self._counts["collisions"] += 1.0
                self._outcome.pairs.append((self.ids[i], self.ids[j]))
        self._touching = touching

    def _is_counted(self, i: int, j: int, fault: dict[tuple[int, int], bool]) -> bool:
        if not self._ever & {i, j}:
            return False
        if self.ego not in (i, j):
            vehicles = all(self._scene.agent_types[k] == "vehicle" for k in (i, j))
            return self._weights.count == "any" and vehicles
        ego_fault = fault.get((self.ego, i if j == self.ego else j), False)
        return self._weights.ego_fault or not ego_fault

    def _leave_out_unavoidable(self) -> float:
        """Take collisions that no ego plan avoids out of the count; returns how many."""
        ego = self.ids[self.ego]
        hits = [pair for pair in self._outcome.pairs if ego in pair]
        if self._recorder is None or not hits:
            return 0.0
        verdict = rollout_avoidability(self._recorder.rollout())
        if verdict is None or verdict.avoidable:
            return 0.0
        self._outcome.pairs = [pair for pair in self._outcome.pairs if pair not in hits]
        self._counts["collisions"] -= len(hits)
        return float(len(hits))

    def finish(self, terminated: bool, truncated: bool) -> Outcome:
        """End a decision."""
        plan = self.plan()
        cost, shift, sparsity = 0.0, 0.0, 0.0
        if plan is not None:
            if plan.guided.any():
                cost = float(plan.realism_cost[plan.guided].mean())
                shift = float(plan.shift_sigmas[plan.guided].mean())
            m = len(plan.agents)
            sparsity = 1.0 - (float(plan.graph.sum()) - m) / max(m * (m - 1), 1)
        off_road = float(np.mean(self._off_road)) if self._off_road else 0.0
        discomfort = float(np.mean(self._discomfort)) if self._discomfort else 0.0
        unavoidable = self._leave_out_unavoidable()
        weights = self._weights
        outcome = self._outcome
        outcome.terminated, outcome.truncated = terminated, truncated
        outcome.info = {
            "reward_collision": weights.collision * self._counts["collisions"],
            "reward_realism": weights.realism * cost,
            "reward_off_road": weights.off_road * off_road,
            "reward_comfort": weights.comfort * discomfort,
            **self._counts,
            "unavoidable": unavoidable,
            "realism_cost": cost,
            "shift_sigmas": shift,
            "off_road": off_road,
            "discomfort": discomfort,
            "num_adversaries": float(len(self.before)),
            "graph_sparsity": sparsity,
            "steps": float(self._steps),
        }
        self.totals["collisions"] += self._counts["collisions"]
        self.totals["realism_cost"] += cost
        self.totals["shift_sigmas"] += shift
        self.totals["decisions"] += 1.0
        self.totals["adversaries"] += len(self.before)
        return outcome

    def metrics(self) -> dict[str, float]:
        """Return the figures of the episode so far."""
        decisions = max(self.totals["decisions"], 1.0)
        return {
            "is_success": float(self.totals["collisions"] > 0),
            "collisions": self.totals["collisions"],
            "mean_realism_cost": self.totals["realism_cost"] / decisions,
            "mean_shift_sigmas": self.totals["shift_sigmas"] / decisions,
            "mean_adversaries": self.totals["adversaries"] / decisions,
            "decisions": self.totals["decisions"],
        }
