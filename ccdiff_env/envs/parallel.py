"""Several vehicles of one world, each driven from outside, as a PettingZoo ``ParallelEnv``."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.agent_selection import Adversaries, Agents, Names
from ccdiff_env.envs.drawing import RENDER_MODES, DrawnWorld, Image
from ccdiff_env.envs.parts import AGENT_OPTIONS, InfoLevel, OnWorlds, reset_options
from ccdiff_env.errors import ActionError, ResetNeededError, UnknownNameError
from ccdiff_env.traffic.options import VehicleRanking
from ccdiff_env.worlds import Scenes, normalize_seed
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.snapshot import Snapshot
from ccdiff_env.worlds.spaces import Form

F32 = npt.NDArray[np.float32]
Rows = dict[str, Any]


class MultiAgentEnv(OnWorlds, DrawnWorld, ParallelEnv[str, Any, Any]):  # type: ignore[misc]
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
        **options: Fields of :class:`~ccdiff_env.config.WorldConfig` by name.

    Notes:
        Agents end at different times. Crashed agents remain as obstacles; agents that reach their
        goal are removed. With adversaries, the episode is truncated once no ego is left.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (PettingZoo's form)
        "name": "ccdiff_env_multi_v0",
        "render_modes": RENDER_MODES,
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
        observation: Form | Mapping[str, Any] = "flat",
        info: InfoLevel = "full",
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Any,
    ) -> None:
        options = self._take(options, observation, info, render_mode, render_options)
        chosen, config = self._select_agents(
            scenes, config, options, adversary_shaping,
            agents=agents, ranking=ranking, adversaries=adversaries,
        )  # fmt: skip
        self._play(chosen, config, criticality)
        self._by_token = names == "token"
        self.possible_agents: list[str] = list(self._selection.names(names))
        self.agents: list[str] = []
        self._observation_spaces: dict[str, gymnasium.Space[Any]] = {
            name: self.worlds.observation_space(self._form) for name in self.possible_agents
        }
        self._action_spaces = {
            name: copy.deepcopy(self.worlds.action_space) for name in self.possible_agents
        }
        rows = self.worlds.num_slots
        box: Any = self.worlds.layout.space("flat")
        self.state_space = spaces.Box(
            np.minimum(np.tile(box.low, rows), 0.0), np.maximum(np.tile(box.high, rows), 0.0)
        )
        self._slots: dict[str, int] = {}

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
        if normalized is None and not self.worlds.native.begun(0):
            normalized = int(np.random.default_rng().integers(2**63))
        out = self.worlds.arrays()
        self.worlds.native.reset([normalized], [scene_idx], None, out)
        self.worlds.assign(0, drivers)
        self._begin()
        common = self.worlds.begin_episode(0, self._info)
        infos = {}
        for name in self.agents:
            texts = {"agent_id": self._ids[self._slots[name]], "role": self.role(name)}
            infos[name] = common if self._info == "none" else {**common, **texts}
        self._show()
        return self._observations(out.obs, out.bev, self.agents), infos

    def _begin(self) -> None:
        """Name the agents of the present episode."""
        self._ids, self._adversary = self._in_slots(0)
        self._slots = {
            one if self._by_token else self.possible_agents[slot]: slot
            for slot, one in enumerate(self._ids)
            if one is not None
        }
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
                After the end of an episode, no actions are expected and nothing happens.

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
            raise ResetNeededError("step: no agent is left: call reset() first")
        checked, out = self._actions(actions), self.worlds.arrays()
        self.worlds.native.step(checked, out)
        slots = {name: self._slots[name] for name in self.agents}
        terminated, truncated = out.terminated[0], out.truncated[0]
        ended = terminated | truncated
        self.agents = [name for name, slot in slots.items() if not ended[slot]]
        self._show()
        return (
            self._observations(out.obs, out.bev, slots),
            {name: float(out.reward[0, slot]) for name, slot in slots.items()},
            {name: bool(terminated[slot]) for name, slot in slots.items()},
            {name: bool(truncated[slot]) for name, slot in slots.items()},
            {name: self._step_info(out, bool(ended[slot]), slot) for name, slot in slots.items()},
        )

    def _actions(self, actions: Mapping[str, Any]) -> F32:
        width = self.worlds.native.action_width
        rows = np.zeros((self.worlds.num_slots, *self.worlds.action_shape))
        if not isinstance(actions, Mapping):
            raise ActionError(f"actions is {actions!r}, expected a dictionary by agent")
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

    def _observations(self, rows: F32, rasters: Image | None, names: Iterable[str]) -> Rows:
        return {name: self._observation(rows, rasters, self._slots[name]) for name in names}

    def state(self) -> F32:
        """Return the flat observations of all slots, one after the other; zero for absent ones."""
        return self.worlds.observe(0)[0].ravel()

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
        self._begin()
        alive = self.worlds.native.slot_alive(0)
        self.agents = [name for name in self.agents if alive[self._slots[name]]]
        rows, bev = self.worlds.observe(0)
        return self._observations(rows[None], None if bev is None else bev[None], self.agents)

    def fork(self, *, seed: int | None = None) -> MultiAgentEnv:
        """Return an independent environment in the same state, with a ``seed`` of its own."""
        fork = copy.deepcopy(self)
        if seed is not None:
            fork.restore(fork.snapshot(), seed=seed)
        return fork
