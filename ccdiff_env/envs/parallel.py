"""Several vehicles of one world, each driven from outside, as a PettingZoo ``ParallelEnv``."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.agent_selection import Adversaries, Agents, Names
from ccdiff_env.envs.drawing import FPS, RENDER_MODES, DrawnWorld
from ccdiff_env.envs.parts import InfoLevel, Shared, agent_parts
from ccdiff_env.envs.reset_options import AGENT_OPTIONS, reset_options
from ccdiff_env.errors import ActionError, ResetNeededError, UnknownNameError
from ccdiff_env.traffic.options import VehicleRanking
from ccdiff_env.worlds import Scenes, StepArrays, normalize_seed
from ccdiff_env.worlds.curriculum import Criticality, FollowsTraining
from ccdiff_env.worlds.snapshot import Snapshot
from ccdiff_env.worlds.spaces import Form

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import AgentKeywords

F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
Rows = dict[str, Any]


class MultiAgentEnv(DrawnWorld, FollowsTraining, ParallelEnv[str, Any, Any]):  # type: ignore[misc]
    """One world in Rust; chosen vehicles are driven by actions, the others by the background.

    Args:
        scenes, config, observation, info, render_mode, render_options, criticality: As for
            :class:`~ccdiff_env.EgoEnv`; ``info="end"``: at an agent's end.
        agents: Who is controlled: ``"all"`` vehicles that are there at the start, a number K (the
            ego and the first K - 1 others of the ranking), or ids.
        ranking: How the others are ranked at the start: ``"nearest"`` or ``"ttc"`` (to the ego),
            ``"cliques"`` (of the causal graph), ``"first"``, ``"random"``.
        adversaries: Who plays against the others: ``None``, all ``"others"`` than the ego, the
            first n others, or ids. An adversary's reward is minus the mean reward of the egos.
        adversary_shaping: How much of its own off-road and comfort reward an adversary gets
            besides.
        names: ``"token"``: agents are named by their instance tokens, and ``possible_agents`` are
            those of all scenes; ``"slot"``: ``ego_0``, ``vehicle_1``, ``vehicle_2`` ... by rank,
            the same few names in every scene.
        max_cycles: Steps of an episode at most; ``horizon_steps`` by another name.
        **options: Fields of :class:`~ccdiff_env.config.WorldConfig` by name.

    Notes:
        Agents end at different times. Who ends by an accident stays in the way of the others; who
        reaches its goal leaves. With adversaries, the episode is truncated once no ego is left.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (PettingZoo's form)
        "name": "ccdiff_env_multi_v0",
        "render_modes": RENDER_MODES,
        "render_fps": FPS,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        agents: Agents = "all",
        ranking: VehicleRanking = "nearest",
        adversaries: Adversaries = None,
        adversary_shaping: float = 0.0,
        names: Names = "token",
        max_cycles: int | None = None,
        observation: Form = "flat",
        info: InfoLevel = "full",
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Unpack[AgentKeywords],
    ) -> None:
        shared = Shared(scenes, config, observation, info, render_mode, render_options, criticality)
        if max_cycles is not None:
            held = options.get("decision_steps", (config or WorldConfig()).decision_steps)
            options = {"horizon_steps": max_cycles * held, **options}
        self.worlds, selection, self._render_options = agent_parts(
            shared, options, agents=agents, ranking=ranking, adversaries=adversaries,
            adversary_shaping=adversary_shaping,
        )  # fmt: skip
        chosen, resolved = self.worlds.scenes, self.worlds.config
        self._kept: dict[str, Any] = {
            "scenes": chosen,
            "config": resolved,
            "agents": agents,
            "ranking": ranking,
            "adversaries": adversaries,
            "adversary_shaping": adversary_shaping,
            "names": names,
            "observation": observation,
            "info": info,
            "render_mode": render_mode,
            "render_options": self._render_options,
            "criticality": criticality,
        }
        self._selection = selection
        self._by_token = names == "token"
        self.max_cycles = -(-resolved.horizon_steps // resolved.decision_steps)
        self.render_mode = render_mode
        self.possible_agents: list[str] = list(selection.names(names))
        self.agents: list[str] = []
        self._form: Form = observation
        self._observation_spaces: dict[str, gymnasium.Space[Any]] = {
            name: self.worlds.observation_space(observation) for name in self.possible_agents
        }
        self._action_spaces = {
            name: copy.deepcopy(self.worlds.action_space) for name in self.possible_agents
        }
        rows = self.worlds.num_slots
        box = self.worlds.layout.flat_space()
        self.state_space = spaces.Box(
            np.minimum(np.tile(box.low, rows), 0.0), np.maximum(np.tile(box.high, rows), 0.0)
        )
        self._info: InfoLevel = info
        self._seeded = False
        self._slots: dict[str, int] = {}

    def _scene_idx(self) -> int:
        return self.worlds.native.status(0).scene_idx

    def observation_space(self, agent: str) -> gymnasium.Space[Any]:
        """Return the space of an agent's observations, always the same object."""
        return self._observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """Return the space of an agent's actions, always the same object."""
        return self._action_spaces[self._known(agent)]

    def _known(self, agent: str) -> str:
        if agent not in self._observation_spaces:
            few = ", ".join(self.possible_agents[:5])
            raise UnknownNameError(
                f"no agent {agent!r} among {len(self.possible_agents)}: {few} ..."
            )
        return agent

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Rows, dict[str, dict[str, Any]]]:
        """Begin a new episode.

        Args:
            seed: Any integer; ``None`` goes on with the world's generator.
            options: ``scene``: name or index of the scene; ``drivers``: drivers of single vehicles
                by id, for this episode. ``options`` is ignored: PettingZoo's own tests give it.

        Returns:
            observations, infos: Of all agents of the episode; infos hold scene, token, seed, the
                agent's id and role.
        """
        given = reset_options(options, (*AGENT_OPTIONS, "options"))
        scene_idx = self.worlds.scene_index(given.get("scene"))
        drivers = self.worlds.agent_drivers(given.get("drivers"))
        normalized = None if seed is None else normalize_seed(seed)
        if normalized is None and not self._seeded:
            normalized = int(np.random.default_rng().integers(2**63))
        self._seeded = True
        out = self.worlds.arrays()
        self.worlds.native.reset([normalized], [scene_idx], None, out)
        self.worlds.assign(0, drivers)
        self._begin()
        common = self.worlds.reset_info(0, self._info)
        ids = self.scene.agent_ids
        infos = {}
        for name in self.agents:
            agent_idx = self._agent_of[self._slots[name]]
            texts = {"agent_id": ids[agent_idx], "role": self.role(name)}
            infos[name] = common if self._info == "none" else {**common, **texts}
        if self.render_mode == "human":
            self.render()
        return self._observations(out.obs, out.bev, self.agents), infos

    def _begin(self) -> None:
        """Name the agents of the present episode."""
        agents = self.worlds.native.slot_agents(0)
        ids = self.scene.agent_ids
        self._agent_of = {slot: agent for slot, agent in enumerate(agents) if agent is not None}
        self._slots = {
            ids[agent] if self._by_token else self.possible_agents[slot]: slot
            for slot, agent in self._agent_of.items()
        }
        names = [None if agent is None else ids[agent] for agent in agents]
        self._adversary = self._selection.adversary_slots(self._scene_idx(), names)
        self.agents = list(self._slots)

    def role(self, agent: str) -> str:
        """Return ``"ego"`` or ``"adversary"``, the part of an agent in the present episode."""
        return "adversary" if self._adversary[self._slots[agent]] else "ego"

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Rows, dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance by one step.

        Args:
            actions: An action of each of ``agents``; those of agents that have ended are ignored.
                After the end of an episode, no actions lead to nothing.

        Returns:
            observations, rewards, terminations, truncations, infos: Of the agents that were there
                before the step.

        Raises:
            ActionError, ShapeError: If an action is missing or does not fit; nothing has moved
                then.
            ResetNeededError: Before the first reset and when nobody is left.
        """
        if not self.agents:
            if self._slots and not actions:  # wrappers of PettingZoo and SuperSuit do that
                return {}, {}, {}, {}, {}
            raise ResetNeededError("step: nobody is left, reset comes first")
        self.worlds.native.step(self._actions(actions), self.worlds.arrays())
        out = self.worlds.last
        assert out is not None
        before = self.agents
        terminations, truncations, infos, live = {}, {}, {}, []
        for name in before:
            slot = self._slots[name]
            terminations[name] = bool(out.terminated[0, slot])
            truncations[name] = bool(out.truncated[0, slot])
            ended = terminations[name] or truncations[name]
            infos[name] = self._step_info(out, slot, ended)
            if not ended:
                live.append(name)
        self.agents = live
        if self.render_mode == "human":
            self.render()
        shown = {name: float(out.reward[0, self._slots[name]]) for name in before}
        observations = self._observations(out.obs, out.bev, before)
        return observations, shown, terminations, truncations, infos

    def _actions(self, actions: Mapping[str, Any]) -> F32:
        width = self.worlds.native.action_width
        rows = np.zeros((self.worlds.num_slots, *self.worlds.action_shape))
        for name in actions:
            self._known(name)
        for name in self.agents:
            if name not in actions:
                raise ActionError(f"no action for agent {name!r}")
            given = np.asarray(actions[name])
            if given.shape != rows.shape[1:]:
                raise ActionError(
                    f"action of {name!r} has shape {given.shape}, expected {rows.shape[1:]}"
                )
            if given.dtype.kind not in ("iu" if rows.ndim == 1 else "fiu"):
                raise ActionError(f"action of {name!r} has dtype {given.dtype}")
            rows[self._slots[name]] = given
        with np.errstate(over="ignore"):  # what overflows becomes infinite, and is refused
            return rows.astype(np.float32).reshape(1, -1, width)

    def _step_info(self, out: StepArrays, slot: int, ended: bool) -> dict[str, Any]:
        info: dict[str, Any] = {}
        if self._info == "full" or (self._info == "end" and ended):
            columns = out.columns[0, slot].tolist()
            info.update(zip(self.worlds.column_names, columns, strict=True))
        if ended and self._info != "none":
            metrics = self.worlds.native.metrics(0)[slot].tolist()
            info["metrics"] = dict(zip(self.worlds.metric_names, metrics, strict=True))
        return info

    def _observations(self, rows: F32, rasters: U8 | None, names: list[str]) -> Rows:
        found = {}
        for name in names:
            slot = self._slots[name]
            bev = None if rasters is None else rasters[0, slot].copy()
            row = rows[0, slot].copy()
            found[name] = self.worlds.layout.observation(self._form, row, bev)
        return found

    def state(self) -> F32:
        """Return the flat observations of all slots, one after the other; zero for absent ones."""
        return self.worlds.observation(0).ravel()

    def snapshot(self) -> bytes:
        """Return everything that the world's future depends on."""
        return Snapshot.of(self.worlds, 0).to_bytes()

    def restore(self, snapshot: bytes, *, seed: int | None = None) -> Rows:
        """Return to the state of a snapshot; returns the observations of that moment.

        With a ``seed`` traffic goes on as another draw, see :meth:`EgoEnv.restore`.

        Raises:
            SnapshotError: If the bytes are damaged, or belong to another configuration or other
                scenes.
        """
        Snapshot.from_bytes(snapshot).put(self.worlds, 0, seed)
        self.agents = []
        if not self.worlds.native.begun(0):
            return {}
        self._seeded = True
        self._begin()
        alive = np.array(self.worlds.native.slot_alive(0))
        self.agents = [name for name in self.agents if alive[self._slots[name]]]
        rows, bev = self.worlds.observe(0)
        return self._observations(rows[None], None if bev is None else bev[None], self.agents)

    def fork(self, *, seed: int | None = None) -> MultiAgentEnv:
        """Return an independent environment in the same state, with a ``seed`` of its own."""
        fork = copy.deepcopy(self)
        if seed is not None:
            fork.restore(fork.snapshot(), seed=seed)
        return fork

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle holds; a window is not part of it."""
        return {
            **self._kept,
            "snapshot": self.snapshot(),
            "seeded": self._seeded,
            "training": self._training(),
            "spaces": (self._observation_spaces, self._action_spaces),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Rebuild the environment."""
        extra = ("snapshot", "seeded", "training", "spaces")
        MultiAgentEnv.__init__(self, **{k: v for k, v in state.items() if k not in extra})
        self._follow(state["training"])
        self.restore(state["snapshot"])
        self._seeded = state["seeded"]
        self._observation_spaces, self._action_spaces = state["spaces"]


__all__ = ["MultiAgentEnv"]
