"""Many worlds in which adversaries are chosen; the background plans for all of them at once."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig, unknown
from ccdiff_env.envs.as_vector import AsVector
from ccdiff_env.envs.drawing import FPS, check_render_mode, checked_render_options
from ccdiff_env.envs.reset_options import SELECTION_OPTIONS, reset_options
from ccdiff_env.errors import ActionError, ConfigError, ResetNeededError, ShapeError
from ccdiff_env.policies.planners import Ego, ego_driver
from ccdiff_env.record.counterfactual import rollout_avoidability
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.traffic.options import SelectionReward
from ccdiff_env.worlds import Scenes, Worlds, scene_set, world_config
from ccdiff_env.worlds.spaces import InfoColumn

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from ccdiff_env.traffic.keywords import SelectionKeywords

__all__ = ["DEFAULT_CCDIFF", "FEATURES", "INFO_COLUMNS", "STRENGTHS", "AdversarySelectionVectorEnv"]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Info = dict[str, Any]

_TABLE = json.loads(_native.candidate_features_json())
#: Columns of an observation, in the table of ``rust/sim/src/world/candidates.rs``.
FEATURES: tuple[str, ...] = tuple(feature["name"] for feature in _TABLE["features"])
_BOUND: float = _TABLE["bound"]
#: Criticalities that a decision chooses from.
STRENGTHS = (1.0, 2.0, 4.0)
#: Traffic by default: plans of one denoising step, a decision for each, every 2 s.
DEFAULT_CCDIFF: Mapping[str, Any] = {
    "criticality": 1.0,
    "denoising_steps": 1,
    "replan_steps": 20,
}

#: Figures of a decision, keys of ``info``.
INFO_COLUMNS: tuple[InfoColumn, ...] = (
    InfoColumn("reward_collision", "", "weighted reward of collisions that count"),
    InfoColumn("reward_shift", "", "weighted reward of the shift of the adversary's plan"),
    InfoColumn("collisions", "", "collisions that count, begun in the decision"),
    InfoColumn("ego_collision", "", "1 if the ego begins to touch anybody in the decision"),
    InfoColumn("ego_at_fault", "", "1 if such a collision counts against the ego"),
    InfoColumn("shift_sigmas", "", "shift of the adversary's plan by the guidance; 0 for nobody"),
    InfoColumn("realism_cost", "", "the same as total variation, the paper's C, which saturates"),
    InfoColumn("guided", "", "1 if a vehicle was guided"),
    InfoColumn("steps", "", "steps of the world in the decision"),
)


class AdversarySelectionVectorEnv(AsVector):
    """Choose, once per plan of the background, which vehicle becomes an adversary of the ego.

    Worlds that ended begin anew within the step (SAME_STEP). World i of ``reset(seed=n)`` gets the
    seed n + i and then runs as the single environment.

    Actions are Discrete(R S + 1): candidate ``action // S`` at criticality ``strengths[action %
    S]``, and nobody for the last index. Observations are rows [R, F] of :data:`FEATURES`, the
    candidates nearest to the ego first.

    Parameters
    ----------
    num_envs
        Number of worlds E.
    scenes
        A :class:`SceneSet`, scenes, the text of a source (:func:`ccdiff_env.load`), or the name
        of a split of the embedded scenes.
    config
        Configuration of the worlds to start from.
    ego
        The ego's planner, see :func:`ccdiff_env.policies.planners.ego_driver`.
    max_candidates
        Rows R: vehicles that the background plans for, nearest to the ego first.
    strengths
        Criticalities S that an action chooses from.
    reward
        Weights, see :class:`SelectionReward`; also as a dictionary. :attr:`shift_cost` may be
        changed as training goes on.
    num_threads
        Worker threads, as for :class:`~ccdiff_env.envs.vector.EgoVectorEnv`.
    render_mode
        ``None`` or ``"rgb_array"``.
    render_options
        Options of images.
    **options
        Fields of :class:`~ccdiff_env.config.WorldConfig` by name. Traffic is ``"ccdiff"`` with
        :data:`DEFAULT_CCDIFF` unless told otherwise; its plans set the pace of decisions.

    Raises
    ------
    ConfigError
        For traffic that nothing guides, and options out of range.
    """

    reset_option_names = SELECTION_OPTIONS
    metadata = {  # noqa: RUF012 (Gymnasium's form)
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        ego: Ego = "idm",
        max_candidates: int = 8,
        strengths: Sequence[float] = STRENGTHS,
        reward: SelectionReward | Mapping[str, Any] | None = None,
        num_threads: int | None = None,
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        **options: Unpack[SelectionKeywords],
    ) -> None:
        check_render_mode(render_mode, ("rgb_array",))
        self._render_options = checked_render_options(render_options)
        if type(max_candidates) is not int or not 1 <= max_candidates <= 64:
            raise ConfigError(f"max_candidates is {max_candidates!r}, expected 1 to 64")
        self.strengths = tuple(float(strength) for strength in strengths)
        if not self.strengths or not all(0.0 < strength <= 10.0 for strength in self.strengths):
            raise ConfigError(f"strengths is {strengths!r}, expected numbers above 0, at most 10")
        self.reward = _reward(reward)
        #: Cost per standard deviation of shift, in place of that of the reward.
        self.shift_cost = self.reward.shift_cost
        chosen = scene_set(scenes)
        resolved, self._act = _world(chosen, config, ego, dict(options))
        networks = resolved.guided_traffic("choice of adversaries")
        #: Steps of the worlds from one decision to the next.
        self.decision_steps, *others = dict.fromkeys(one.replan_steps for one in networks)
        if others:
            raise ConfigError(
                f"replan_steps are {self.decision_steps} and {others[0]}, expected one number for "
                "all traffic"
            )
        self.worlds = Worlds(
            chosen,
            resolved,
            num_worlds=num_envs,
            num_threads=num_threads,
            trails=render_mode is not None,
        )
        self.num_envs, self.max_candidates = num_envs, max_candidates
        self.render_mode = render_mode
        rows = (max_candidates, len(FEATURES))
        self.single_observation_space: gymnasium.Space[Any] = spaces.Box(
            -_BOUND, _BOUND, rows, np.float32
        )
        #: The action that chooses nobody, the last one.
        self.nobody = max_candidates * len(self.strengths)
        self.single_action_space: gymnasium.Space[Any] = spaces.Discrete(self.nobody + 1)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        #: Called after every step of the worlds, of which a decision has several.
        self.on_step: Callable[[], object] | None = None
        #: Agents in the rows of each world.
        self.candidates: list[list[int]] = [[] for _ in range(num_envs)]
        self._ended = np.ones(num_envs, np.bool_)
        self._began = False
        self._obs = np.zeros((num_envs, *rows), np.float32)
        self._ego_obs = np.zeros((num_envs, self.worlds.layout.size), np.float32)
        self._egos = np.zeros(num_envs, np.int64)
        self._adversaries: list[set[int]] = [set() for _ in range(num_envs)]
        self._recorders: list[Recorder | None] = [None] * num_envs
        self._totals = np.zeros((num_envs, len(INFO_COLUMNS) + 1))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[F32, Info]:
        """Begin new episodes in all worlds.

        Parameters
        ----------
        seed
            Any integer n (world i gets n + i), or one per world.
        options
            ``scene``: name or index, or one per world.

        Returns
        -------
        obs, infos
            Observations [E, R, F]; ``scene``, ``scene_token``, ``seed``, ``episode_idx``.
        """
        listed = self._per_world("scene", reset_options(options, SELECTION_OPTIONS).get("scene"))
        which = np.ones(self.num_envs, np.bool_)
        self._begin(which, self._seeds(seed), [self.worlds.scene_index(one) for one in listed])
        infos: Info = {}
        self._reset_infos(infos, which)
        return self._obs.copy(), infos

    def step(self, actions: Any) -> tuple[F32, F32, Bool, Bool, Info]:
        """Choose adversaries in all worlds and advance until the next plans.

        Parameters
        ----------
        actions
            Indices [E]; candidates that are not there are nobody.

        Returns
        -------
        obs, rewards, terminations, truncations, infos
            Arrays [E, ...]; ``infos`` holds :data:`INFO_COLUMNS` of the decision and ``adversary``
            (id), and ``final_obs`` and ``final_info`` (with ``metrics`` and ``is_success``) of
            episodes that ended.

        Raises
        ------
        ActionError
            If an action does not fit; nothing has moved then.
        ResetNeededError
            Before the first reset.
        """
        self.check_running()
        return self._autoreset(*self.decide(self.chosen(actions)))

    def check_running(self) -> None:
        """Refuse to go on in worlds that have ended or were never reset.

        Raises
        ------
        ResetNeededError
            If there is one.
        """
        if self._ended.any():
            world = int(np.flatnonzero(self._ended)[0])
            raise ResetNeededError(f"world {world} has ended or was never reset")

    def chosen(self, actions: Any) -> list[tuple[list[int] | None, float]]:
        """Return the agents that actions [E] choose, and their criticality, world by world.

        Raises
        ------
        ShapeError, ActionError
            For another number of actions, and for what is no index of the space.
        """
        given = np.asarray(actions)
        if given.shape != (self.num_envs,):
            raise ShapeError(f"actions have shape {given.shape}, expected ({self.num_envs},)")
        if given.dtype.kind not in "iu" or (given < 0).any() or (given > self.nobody).any():
            raise ActionError(f"actions are {given.tolist()}, expected 0 to {self.nobody}")
        found: list[tuple[list[int] | None, float]] = []
        for action, agents in zip(given.tolist(), self.candidates, strict=True):
            row, strength = divmod(action, len(self.strengths))
            found.append((agents[row : row + 1], self.strengths[strength]))
        return found

    def decide(
        self, chosen: Sequence[tuple[list[int] | None, float]]
    ) -> tuple[dict[str, npt.NDArray[Any]], Bool, Bool]:
        """Advance the worlds that have not ended by one decision, without beginning new episodes.

        Parameters
        ----------
        chosen
            Agents of the scene to be guided (``None``: those that the traffic's ranking finds) and
            their criticality, for each world.

        Returns
        -------
        table, terminated, truncated
            :data:`INFO_COLUMNS` by name and ``adversary``, [E]; which episodes ended, and how, [E].
        """
        native, names = self.worlds.native, self.worlds.column_names
        began = ~self._ended
        for e in np.flatnonzero(began).tolist():
            agents, criticality = chosen[e]
            native.override_plan(e, guided=agents, criticality=criticality)
            self._adversaries[e].update(agents or ())
        table = {c.name: np.zeros(self.num_envs) for c in INFO_COLUMNS}
        who = np.full(self.num_envs, None, dtype=object)
        terminated, truncated = np.zeros((2, self.num_envs), np.bool_)
        collision = names.index("collision")
        for step in range(self.decision_steps):
            running = ~self._ended
            if not running.any():
                break
            out = self.worlds.arrays()
            native.step(self._ego_actions(running), out, running)
            self._ego_obs[running] = out.obs[running, 0]
            if step == 0:
                self._guidance(running, table, who)
            table["steps"] += running
            for recorder in (r for r, runs in zip(self._recorders, running, strict=True) if runs):
                if recorder is not None:
                    recorder.step()
            for e in np.flatnonzero(running & (out.columns[:, 0, collision] > 0.0)).tolist():
                self._collision(e, table)
            terminated |= out.terminated[:, 0]
            truncated |= out.truncated[:, 0]
            self._ended |= out.done
            if self.on_step is not None:
                self.on_step()
        table["reward_collision"] = self.reward.collision * table["collisions"]
        table["reward_shift"] = -self.shift_cost * table["shift_sigmas"]
        self._totals[:, :-1] += np.stack(list(table.values()), axis=1)
        self._totals[:, -1] += began
        self._look(began)
        return {**table, "adversary": who}, terminated, truncated

    def _guidance(
        self, running: Bool, table: dict[str, npt.NDArray[Any]], who: npt.NDArray[Any]
    ) -> None:
        """What the plans that were just made say about who is guided."""
        for e in np.flatnonzero(running).tolist():
            found = self.worlds.native.guidance(e)
            if found is not None:
                if np.isnan(found[1]):
                    raise ConfigError(
                        f"traffic is {self.worlds.config.traffic!r}, expected a network that "
                        "denoises: the shift of its plans is the cost of guidance"
                    )
                agent, table["shift_sigmas"][e], table["realism_cost"][e] = found
                table["guided"][e] = 1.0
                self._adversaries[e].add(agent)
                who[e] = self.worlds.scenes[self._scene_idx(e)].agent_ids[agent]

    def _collision(self, e: int, table: dict[str, npt.NDArray[Any]]) -> None:
        """Count the collision that the ego of a world just began."""
        ego, reward = int(self._egos[e]), self.reward.counts
        hits = {j: at_fault for i, j, *_, at_fault in self.worlds.native.contacts(e) if i == ego}
        table["ego_collision"][e] = 1.0
        table["ego_at_fault"][e] = float(any(hits.values()))
        adversaries = [hits[j] for j in hits if j in self._adversaries[e]]
        counts = bool(adversaries) and (reward != "ego_at_fault" or any(adversaries))
        recorder = self._recorders[e]
        if counts and recorder is not None:
            verdict = rollout_avoidability(recorder.rollout())
            counts = verdict is None or bool(verdict.avoidable)
        table["collisions"][e] += float(counts)

    def metrics(self, world_idx: int) -> dict[str, float]:
        """Return the figures of a world's episode so far; ``is_success``: a collision counted."""
        totals = dict(zip((c.name for c in INFO_COLUMNS), self._totals[world_idx], strict=False))
        decisions = max(float(self._totals[world_idx, -1]), 1.0)
        return {
            "is_success": float(totals["collisions"] > 0.0),
            "collisions": float(totals["collisions"]),
            "ego_at_fault": float(totals["ego_at_fault"] > 0.0),
            "mean_shift_sigmas": float(totals["shift_sigmas"]) / decisions,
            "mean_realism_cost": float(totals["realism_cost"]) / decisions,
            "guided": float(totals["guided"]) / decisions,
            "decisions": float(self._totals[world_idx, -1]),
        }

    def action_masks(self) -> Bool:
        """Return which actions are legal [E, R S + 1], as MaskablePPO of sb3-contrib takes them."""
        there = self._obs[:, :, 0] > 0.5
        masks = np.ones((self.num_envs, there.shape[1] * len(self.strengths) + 1), np.bool_)
        masks[:, :-1] = np.repeat(there, len(self.strengths), axis=1)
        return masks

    def observation(self) -> F32:
        """Return the present observations [E, R, F] as a new array."""
        return self._obs.copy()

    def _begin(
        self, which: Bool, seeds: Sequence[int | None], scenes: Sequence[int | None]
    ) -> None:
        """Begin episodes in the worlds of a mask."""
        out, native = self.worlds.arrays(), self.worlds.native
        native.reset(list(seeds), list(scenes), which.tolist(), out)
        for e in np.flatnonzero(which).tolist():
            self._egos[e] = native.slot_agents(e)[0] or 0
            self._adversaries[e] = set()
            if self.reward.counts == "avoidable":
                recorder = Recorder(SimpleNamespace(worlds=self.worlds), world_idx=e)
                recorder.start()
                self._recorders[e] = recorder
        self._ego_obs[which] = out.obs[which, 0]
        self._ended[which] = False
        self._totals[which] = 0.0
        if self._act is not None:
            if self._began:
                self._act.reset(np.flatnonzero(which))
            else:
                self._act.begin(self.worlds)
        self._began = True
        self._look(which)

    def _look(self, which: Bool) -> None:
        """Find the candidates of worlds and what is seen of them."""
        for e in np.flatnonzero(which).tolist():
            self.candidates[e], self._obs[e] = self.worlds.native.candidates(e, self.max_candidates)

    def _ego_actions(self, running: Bool) -> F32:
        if self._act is None:
            return np.zeros((self.num_envs, 1, self.worlds.native.action_width), np.float32)
        shape = (self.num_envs, *self.worlds.action_shape)
        return self.worlds.actions(self._act(self._ego_obs, running), shape)

    def _scene_idx(self, e: int) -> int:
        return self.worlds.native.status(e).scene_idx

    def _autoreset(
        self, table: dict[str, npt.NDArray[Any]], terminated: Bool, truncated: Bool
    ) -> tuple[F32, F32, Bool, Bool, Info]:
        done = terminated | truncated
        rewards = (table["reward_collision"] + table["reward_shift"]).astype(np.float32)
        infos: Info = {}
        for name, values in table.items():
            infos[name], infos["_" + name] = values, ~done
        if done.any():
            final_obs = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(done):
                final_obs[i] = self._obs[i].copy()
            infos["final_obs"], infos["_final_obs"] = final_obs, done.copy()
            infos["final_info"], infos["_final_info"] = self._final_info(table, done), done.copy()
            nothing: list[int | None] = [None] * self.num_envs
            self._begin(done, nothing, nothing)
            self._reset_infos(infos, done)
        return self._obs.copy(), rewards, terminated, truncated, infos

    def _final_info(self, table: Mapping[str, npt.NDArray[Any]], done: Bool) -> Info:
        final: Info = {}
        for name, values in table.items():
            final[name], final["_" + name] = values, done.copy()
        metrics = [self.metrics(i) for i in range(self.num_envs)]
        episode: Info = {}
        for name in metrics[0]:
            values = np.array([one[name] for one in metrics])
            episode[name], episode["_" + name] = np.where(done, values, 0.0), done.copy()
        final["metrics"], final["_metrics"] = episode, done.copy()
        final["is_success"], final["_is_success"] = episode["is_success"] > 0.5, done.copy()
        return final

    def _reset_infos(self, infos: Info, which: Bool) -> None:
        for i in np.flatnonzero(which):
            self._put(infos, int(i), self.worlds.reset_info(int(i), "full"))


def _reward(reward: SelectionReward | Mapping[str, Any] | None) -> SelectionReward:
    if isinstance(reward, SelectionReward):
        return reward
    known = SelectionReward.__dataclass_fields__
    for name in reward or {}:
        if name not in known:
            raise unknown("reward", str(name), known)
    return SelectionReward(**(reward or {}))


def _world(
    scenes: Any, config: WorldConfig | None, ego: Ego, options: dict[str, Any]
) -> tuple[WorldConfig, Any]:
    """Configuration of the worlds, and the ego's planner where worlds do not drive it."""
    for name in ("controlled", "num_slots", "autoreset", "driver", "decision_steps"):
        if name in options:
            raise ConfigError(f"{name} is not an option of adversary selection")
    driver, act = ego_driver(ego)
    base = config
    if config is None:
        options.setdefault("traffic", "ccdiff")
        given = options.get("ccdiff", {})
        if options["traffic"] == "ccdiff" and isinstance(given, Mapping):
            options["ccdiff"] = {**DEFAULT_CCDIFF, **given}
        if act is not None:
            # a planner says what it observes and what its actions mean
            base, options = act.config, {"dt_s": scenes[0].dt, **options}
    resolved = world_config(scenes, base, options)
    return resolved.with_options(driver=driver, autoreset="disabled", decision_steps=1), act
