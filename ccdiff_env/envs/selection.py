"""The task of choosing who becomes adversarial: ``ccdiff_env/AdversarySelection-v0``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.as_vector import AsVector, masked
from ccdiff_env.envs.drawing import DrawnWorld
from ccdiff_env.envs.single import EgoEnv
from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ActionError, ConfigError, ResetNeededError, ShapeError
from ccdiff_env.planners.built_in import Ego
from ccdiff_env.traffic import KINDS
from ccdiff_env.worlds import Worlds, asked_by, normalize_seed, scene_set
from ccdiff_env.worlds.spaces import InfoColumn

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Info = dict[str, Any]
#: Agents that are guided in a world (``None``: those that the traffic chooses), and criticality.
Choice = tuple[Sequence[int] | None, float]
#: Which collisions of the ego with vehicles that were adversaries in the episode count: all, or
#: those that the ego is at fault for.
Counts = Literal["all", "ego_at_fault"]

_BOUND, _TABLE = json.loads(_native.schema("candidates"))
#: Columns of an observation, and what each is divided by.
FEATURES: tuple[str, ...] = tuple(name for name, *_ in _TABLE)
SCALES: tuple[float, ...] = tuple(scale for _, _, scale, _ in _TABLE)
_APPROACH = FEATURES.index("approach")
STRENGTHS = (1.0, 2.0, 4.0)  #: Criticalities that a decision chooses from.
#: Traffic by default: plans of one denoising step, a decision for each, every 2 s.
DEFAULT_CCDIFF = {"criticality": 1.0, "denoising_steps": 1, "replan_steps": 20}
#: The least that can be observed: rows are a tenth of the time.
_NO_ROWS = {"num_neighbors": 0, "num_map_segments": 0, "num_route_points": 1}

#: Figures of a decision, keys of ``info``.
INFO_COLUMNS: tuple[InfoColumn, ...] = (
    InfoColumn("collisions", "", "collisions that count, begun in the decision"),
    InfoColumn("ego_at_fault", "", "1 if the ego is at fault for a collision begun in it"),
    InfoColumn("moved_m", "m", "move of the adversaries' plans by guidance, at 2 s; 0 for nobody"),
    InfoColumn("guided", "", "1 if a vehicle was guided"),
    InfoColumn("steps", "", "steps of the world in the decision"),
)
_NAMES = tuple(column.name for column in INFO_COLUMNS)


#: Options of :class:`~ccdiff_env.envs.vector.EgoVectorEnv` that this task sets or has no use for.
NOT_TAKEN = (
    "adversaries", "adversary_shaping", "autoreset", "autoreset_mode", "controlled", "copy",
    "criticality", "decision_steps", "driver", "info", "num_slots", "observation", "ranking",
    "reward", "style",
)  # fmt: skip


class AdversarySelectionVectorEnv(AsVector):
    """Choose, once per plan of the background, which vehicle becomes an adversary of the ego.

    Actions are Discrete(R S + 1): candidate ``action // S`` at criticality ``strengths[action %
    S]``, and nobody for the last index. Observations are rows [R, F] of :data:`FEATURES`, the
    candidates nearest to the ego first. The reward is 1 for a collision that counts, less
    ``move_cost`` times the metres that guidance moved the plan by 2 s. Episodes end with the ego's
    and with the horizon, which belongs to the task: both are terminations. Worlds that ended
    restart within the step (SAME_STEP); seeds and copies are those of :class:`EgoVectorEnv`.

    Args:
        num_envs: Number of worlds E.
        ego: The ego's planner, see :func:`ccdiff_env.planners.built_in.ego_driver`.
        max_candidates: Rows R: vehicles that the background plans for, nearest to the ego first.
        strengths: Criticalities S that an action chooses from.
        num_adversaries: Vehicles that an action guides: its candidate and the others of closest
            approach.
        counts: Which collisions with adversaries count, see :data:`Counts`.
        move_cost: Reward lost per metre of move; may be changed as training goes on.
        **options: As for :class:`~ccdiff_env.EgoVectorEnv`. Traffic is ``"ccdiff"`` with
            :data:`DEFAULT_CCDIFF` unless told otherwise; its plans set the pace.

    Raises:
        ConfigError: For traffic that nothing guides, and options out of range.
    """

    reset_option_names = EgoVectorEnv.reset_option_names
    metadata = EgoVectorEnv.metadata | {"autoreset_mode": AutoresetMode.SAME_STEP}
    _own = ("adversaries", "decision_steps", "ego", "num_adversaries")

    def __init__(
        self,
        num_envs: int = 1,
        *,
        ego: Ego = "idm",
        max_candidates: int = 8,
        strengths: Sequence[float] = STRENGTHS,
        num_adversaries: int = 1,
        counts: Counts = "all",
        move_cost: float = 0.03,
        **options: Any,
    ) -> None:
        given = dict(options)
        for name in NOT_TAKEN:
            if name in given:
                raise ConfigError(f"{name} is not an option of the choice of adversaries")
        known_counts, sound = get_args(Counts), [0.0 < float(one) <= 10.0 for one in strengths]
        several, rows = (type(k) is int and 1 <= k <= 64 for k in (num_adversaries, max_candidates))
        for name, value, fits, expected in (
            ("strengths", strengths, sound != [] and all(sound), "numbers above 0, at most 10"),
            ("counts", counts, counts in known_counts, f"one of {known_counts}"),
            ("move_cost", move_cost, 0.0 <= move_cost <= 1e6, "0 to 1000000"),
            ("max_candidates", max_candidates, rows, "1 to 64"),
            ("num_adversaries", num_adversaries, several, "1 to 64"),
        ):
            if not fits:
                raise ConfigError(f"{name} is {value!r}, expected {expected}")
        self.strengths, self.num_adversaries = tuple(map(float, strengths)), num_adversaries
        self.counts, self.move_cost = counts, move_cost
        scenes, config = scene_set(given.pop("scenes", None)), given.pop("config", None)
        own = given.get("ccdiff", {})
        if config is None and given.setdefault("traffic", "ccdiff") == "ccdiff":
            given["ccdiff"] = {**DEFAULT_CCDIFF, **own} if isinstance(own, Mapping) else own
        if isinstance(ego, str) and ego in KINDS:  # the worlds drive it, and nobody observes
            config = config or WorldConfig(**asked_by(scenes))
            config = config.with_options(observation=_NO_ROWS)
        given |= {"scenes": scenes, "config": config, "driver": ego}
        #: The worlds, in which only the ego's planner acts.
        self.ego = EgoVectorEnv(num_envs, autoreset_mode="disabled", **given)
        networks = self.ego.config.guided_traffic("choice of adversaries")
        #: Steps of the worlds from one decision to the next.
        self.decision_steps = networks[0].replan_steps
        if len(paces := {one.replan_steps for one in networks}) > 1:
            raise ConfigError(f"replan_steps are {sorted(paces)}, expected one for all traffic")
        self._pace(self.ego.config, self.decision_steps)
        self.num_envs, self.max_candidates = num_envs, max_candidates
        self._info = self.ego._info
        self.worlds.configured_criticality = None  # every decision chooses one
        self.render_mode, self._render_options = self.ego.render_mode, self.ego._render_options
        #: The action that chooses nobody, the last one.
        self.nobody = max_candidates * len(self.strengths)
        shape = (max_candidates, len(FEATURES))
        self.single_observation_space = spaces.Box(-_BOUND, _BOUND, shape, np.float32)
        self.single_action_space = spaces.Discrete(self.nobody + 1)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        #: Called after every step of the worlds, of which a decision has several.
        self.on_step: Callable[[], object] | None = None
        #: Agents in the rows of each world, and those that were guided in its episode.
        self.candidates: list[list[int]] = [[] for _ in range(num_envs)]
        self.adversaries: list[set[int]] = [set() for _ in range(num_envs)]
        #: Agents that the ego of each world touches, and whether it is at fault.
        self._touched: list[dict[int, bool]] = [{} for _ in range(num_envs)]
        #: Worlds [E] whose episode is over, or has not begun.
        self.ended = np.ones(num_envs, np.bool_)
        #: Present observations [E, R, F], which the next decision overwrites.
        self.obs = np.zeros((num_envs, *shape), np.float32)
        #: Sums of the episodes [K, E], and their decisions.
        self._totals = np.zeros((len(_NAMES) + 1, num_envs))

    @property
    def worlds(self) -> Worlds:  # type: ignore[override]
        """The native worlds."""
        return self.ego.worlds

    def reset(self, *, seed: Any = None, options: Info | None = None) -> tuple[F32, Info]:
        """Begin new episodes, as :meth:`EgoVectorEnv.reset`; observations [E, R, F], infos."""
        _, infos = self.ego.reset(seed=seed, options=options)
        which = infos["_scene"]
        for e in np.flatnonzero(which).tolist():
            self.adversaries[e], self._touched[e] = set(), self._touching(e)
        self.ended[which], self._totals[:, which] = False, 0.0
        self._look(which)
        return self.obs.copy(), infos

    def step(self, actions: Any) -> tuple[F32, F32, Bool, Bool, Info]:
        """Choose adversaries in all worlds and advance until the next plans.

        Args:
            actions: Indices [E]; candidates that are not there are nobody.

        Returns:
            obs, rewards, terminations, truncations, infos: Arrays [E, ...]; ``infos`` holds
                :data:`INFO_COLUMNS` of the decision and ``adversary`` (id), and ``final_obs`` and
                ``final_info`` (with ``metrics`` and ``is_success``) of episodes that ended.

        Raises:
            ShapeError, ActionError: If the actions are invalid; the worlds are unchanged.
            ResetNeededError: Before the first reset.
        """
        rewards, figures = self.decide(self.chosen(actions))
        done, infos = self.ended.copy(), masked(figures, ~self.ended)
        if done.any():
            metrics = self.metrics()
            ends = {"metrics": masked(metrics, done), "is_success": metrics["is_success"] > 0.5}
            last = np.full(self.num_envs, None, object)
            for e in np.flatnonzero(done):
                last[e] = self.obs[e].copy()
            final = masked(figures | ends, done) | self._episodes(done)
            infos |= masked({"final_info": final, "final_obs": last}, done)
            infos |= self.reset(options={"reset_mask": done})[1]
        return self.obs.copy(), rewards, done, np.zeros_like(done), infos

    def chosen(self, actions: Any) -> list[Choice]:
        """Return the agents that actions [E] choose, and their criticality, world by world.

        Raises:
            ShapeError, ActionError: For another number of actions, and for what is no index of the
                space.
        """
        given = np.asarray(actions)
        if given.shape != (self.num_envs,):
            raise ShapeError(f"actions have shape {given.shape}, expected ({self.num_envs},)")
        if given.dtype.kind not in "iu" or (given < 0).any() or (given > self.nobody).any():
            raise ActionError(f"actions are {given.tolist()}, expected 0 to {self.nobody}")
        found: list[Choice] = []
        for agents, seen, action in zip(self.candidates, self.obs, given.tolist(), strict=True):
            row, strength = divmod(action, len(self.strengths))
            order = seen[: len(agents), _APPROACH].argsort(kind="stable").tolist()
            first = [row, *(other for other in order if other != row)][: self.num_adversaries]
            guided = [agents[i] for i in first] if row < len(agents) else []
            found.append((guided, self.strengths[strength]))
        return found

    def decide(self, chosen: Sequence[Choice]) -> tuple[F32, dict[str, npt.NDArray[Any]]]:
        """Advance the worlds that have not ended by one decision, without beginning new episodes.

        Args:
            chosen: For each world, who is guided and how strongly.

        Returns:
            rewards, figures: Rewards [E]; :data:`INFO_COLUMNS` by name and ``adversary`` (id or
                ``None``), [E].

        Raises:
            ResetNeededError: Where all worlds have ended, or were never reset.
        """
        if self.ended.all():
            raise ResetNeededError("all worlds have ended or were never reset")
        native, began = self.worlds.native, ~self.ended
        for e in np.flatnonzero(began).tolist():
            agents, criticality = chosen[e]
            native.override_plan(e, guided=agents, criticality=criticality)
            self.adversaries[e].update(agents or ())
        table: dict[str, npt.NDArray[Any]] = {name: np.zeros(self.num_envs) for name in _NAMES}
        who = np.full(self.num_envs, None, dtype=object)
        space: Any = self.ego.action_space
        still = np.zeros(space.shape, space.dtype)
        for step in range(self.decision_steps):
            running = ~self.ended
            if not running.any():
                break
            _, _, terminated, truncated, info = self.ego.step(still, active=running)
            table["steps"] += running
            for e in np.flatnonzero(running).tolist() if step == 0 else ():
                if (found := native.guidance(e)) is None:
                    continue
                guided, moved_m = found
                if np.isnan(moved_m):
                    raise ConfigError(
                        f"traffic is {self.config.traffic!r}, expected a network whose finished "
                        "plans are moved: how far is the cost of guidance"
                    )
                table["moved_m"][e] = moved_m
                table["guided"][e] = 1.0
                self.adversaries[e].update(guided)
                who[e] = self.worlds.scenes[native.status(e).scene_idx].agent_ids[guided[0]]
            for e in np.flatnonzero(running).tolist():
                hits = self._begun(e, info)
                table["ego_at_fault"][e] = max(table["ego_at_fault"][e], *hits.values(), 0.0)
                faults = [hits[j] for j in self._theirs(e) & hits.keys()] if hits else []
                table["collisions"][e] += any(faults) if self.counts != "all" else bool(faults)
            self.ended |= terminated | truncated
            if self.on_step is not None:
                self.on_step()
        self._totals += np.stack([*table.values(), began])
        self._look(began)
        rewards = table["collisions"] - self.move_cost * table["moved_m"]
        return rewards.astype(np.float32), {**table, "adversary": who}

    def _begun(self, e: int, info: Info) -> dict[int, bool]:
        """Agents that the ego of a world begins to touch in a step; whether it is at fault."""
        before, begins = self._touched[e], info["collision"][e] > 0.0
        self._touched[e] = now = self._touching(e) if begins or before else {}
        found = {j: at_fault for j, at_fault in now.items() if j not in before}
        if begins:  # also where the ego was removed, or touched within the step
            found[int(info["collision_partner"][e]) - 1] = bool(info["at_fault"][e] > 0.0)
        return found

    def _theirs(self, e: int) -> set[int]:
        """Adversaries of a world's episode, and what they tow."""
        found = set(self.adversaries[e])
        for towed, front in self.worlds.scenes[self.worlds.native.status(e).scene_idx].towed:
            if front in found:
                found.add(towed)
        return found

    def _touching(self, e: int) -> dict[int, bool]:
        native = self.worlds.native
        ego = native.status(e).ego_idx
        return {j: at_fault for i, j, *_, at_fault in native.contacts(e) if i == ego}

    def metrics(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return figures [E] of the episodes so far; ``is_success``: a collision counted."""
        collisions, at_fault, moved_m, guided, _, decisions = self._totals
        each = np.maximum(decisions, 1.0)
        return {
            "is_success": np.minimum(collisions, 1.0),
            "collisions": collisions.copy(),
            "ego_at_fault": np.minimum(at_fault, 1.0),
            "mean_moved_m": moved_m / each,
            "guided": guided / each,
            "decisions": decisions.copy(),
        }

    def action_masks(self) -> Bool:
        """Return which actions are legal [E, R S + 1], as MaskablePPO of sb3-contrib takes them."""
        there = np.repeat(self.obs[:, :, 0] > 0.5, len(self.strengths), axis=1)
        return np.pad(there, ((0, 0), (0, 1)), constant_values=True)

    def _look(self, which: Bool) -> None:
        """Find the candidates of worlds and what is seen of them."""
        for e in np.flatnonzero(which).tolist():
            self.candidates[e], self.obs[e] = self.worlds.native.candidates(e, self.max_candidates)


class AdversarySelectionEnv(DrawnWorld, gymnasium.Env[Any, Any]):
    """:class:`AdversarySelectionVectorEnv` with one world, which does not restart by itself.

    Args:
        **options: As there, and ``render_mode="human"`` (needs pygame).
    """

    metadata = EgoEnv.metadata

    def __init__(self, **options: Any) -> None:
        self.render_mode = options.get("render_mode")
        if self.render_mode == "human":
            options["render_mode"] = "rgb_array"
        options.setdefault("num_threads", 1)
        #: The worlds, of which there is one.
        self.vector = AdversarySelectionVectorEnv(1, **options)
        self._render_options = self.vector._render_options
        self._pace(self.vector.ego.config, self.vector.decision_steps)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    @property
    def worlds(self) -> Worlds:  # type: ignore[override]
        """The native world."""
        return self.vector.worlds

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[F32, Info]:
        """Begin a new episode, as :meth:`EgoEnv.reset`; ``agent_ids`` says who is in which row."""
        super().reset(seed=None if seed is None else normalize_seed(seed))
        obs, _ = self.vector.reset(seed=seed, options=options)
        self._show()
        return obs[0], {**self.worlds.begin_episode(0, "full"), "agent_ids": self.agent_ids()}

    def step(self, action: Any) -> tuple[F32, float, bool, bool, Info]:
        """Choose an adversary and advance until the next plan.

        It takes, returns and raises what :meth:`AdversarySelectionVectorEnv.step` does, for one
        world; ``info`` besides holds ``agent_ids`` of the next rows, and at the end ``metrics`` and
        ``is_success``, after which it asks for a reset.
        """
        rewards, figures = self.vector.decide(self.vector.chosen([action]))
        info = {name: of[0] for name, of in figures.items()} | {"agent_ids": self.agent_ids()}
        done = bool(self.vector.ended[0])
        if done:
            info.update(self.worlds.episodes[0])
            info["metrics"] = {name: float(of[0]) for name, of in self.vector.metrics().items()}
            info["is_success"] = info["metrics"]["is_success"]
        self._show()
        return self.vector.obs[0].copy(), float(rewards[0]), done, False, info

    def agent_ids(self) -> tuple[str, ...]:
        """Return the ids of the vehicles in the rows that actions choose from."""
        return tuple(self.scene.agent_ids[agent] for agent in self.vector.candidates[0])

    def action_masks(self) -> Bool:
        """Return which actions are legal [R S + 1], as MaskablePPO of sb3-contrib takes them."""
        masks: Bool = self.vector.action_masks()[0]
        return masks
