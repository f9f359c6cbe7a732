"""Many worlds in which adversaries are chosen; the background plans for all of them at once."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ccdiff_env import _native
from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.as_vector import AsVector, with_masks
from ccdiff_env.envs.drawing import FPS
from ccdiff_env.envs.vector import EgoVectorEnv
from ccdiff_env.errors import ActionError, ConfigError, ResetNeededError, ShapeError, unknown
from ccdiff_env.policies.planners import Ego
from ccdiff_env.record.counterfactual import rollout_avoidability
from ccdiff_env.record.recorder import Recorder
from ccdiff_env.traffic import KINDS
from ccdiff_env.traffic.keywords import SelectionKeywords
from ccdiff_env.worlds import Scenes, Worlds, scene_set
from ccdiff_env.worlds.spaces import InfoColumn

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = [
    "DEFAULT_CCDIFF",
    "FEATURES",
    "INFO_COLUMNS",
    "SCALES",
    "STRENGTHS",
    "AdversarySelectionVectorEnv",
    "SelectionOptions",
]

F32 = npt.NDArray[np.float32]
Bool = npt.NDArray[np.bool_]
Info = dict[str, Any]
#: Agents that are guided in a world (``None``: those that the traffic chooses), and criticality.
Choice = tuple[Sequence[int] | None, float]
#: Which collisions of the ego with vehicles that were adversaries in the episode count: all, those
#: that the ego is at fault for, those that another plan of the ego would have avoided
#: (:func:`~ccdiff_env.record.counterfactual.rollout_avoidability`, up to a second each).
Counts = Literal["all", "ego_at_fault", "avoidable"]

_TABLE = json.loads(_native.candidate_features_json())
#: Columns of an observation, and what each is divided by.
FEATURES: tuple[str, ...] = tuple(feature["name"] for feature in _TABLE["features"])
SCALES: tuple[float, ...] = tuple(feature["scale"] for feature in _TABLE["features"])
_APPROACH = FEATURES.index("approach")
#: Criticalities that a decision chooses from.
STRENGTHS = (1.0, 2.0, 4.0)
#: Traffic by default: plans of one denoising step, a decision for each, every 2 s.
DEFAULT_CCDIFF = {"criticality": 1.0, "denoising_steps": 1, "replan_steps": 20}
#: The least that can be observed: rows are a tenth of the time.
_NO_ROWS = {"num_neighbors": 0, "num_map_segments": 0, "num_route_points": 1}
#: Options of the worlds that are the environment's own.
_OWN = ("autoreset_mode", "controlled", "copy", "criticality", "decision_steps", "driver", "info")

#: Figures of a decision, keys of ``info``.
INFO_COLUMNS: tuple[InfoColumn, ...] = (
    InfoColumn("collisions", "", "collisions that count, begun in the decision"),
    InfoColumn("ego_at_fault", "", "1 if the ego is at fault for a collision begun in it"),
    InfoColumn("shift_sigmas", "", "shift of the adversaries' plans by the guidance; 0 for nobody"),
    InfoColumn("realism_cost", "", "the same as total variation, the paper's C, which saturates"),
    InfoColumn("guided", "", "1 if a vehicle was guided"),
    InfoColumn("steps", "", "steps of the world in the decision"),
)
_NAMES = tuple(column.name for column in INFO_COLUMNS)


class SelectionOptions(SelectionKeywords, total=False):
    """What goes to :class:`~ccdiff_env.envs.vector.EgoVectorEnv`."""

    scenes: Scenes
    config: WorldConfig | None
    num_threads: int | None
    render_mode: str | None
    render_options: Mapping[str, Any] | None


class AdversarySelectionVectorEnv(AsVector):
    """Choose, once per plan of the background, which vehicle becomes an adversary of the ego.

    Worlds that ended restart within the step (SAME_STEP). World i of ``reset(seed=n)`` gets the
    seed n + i and then runs as the single environment. Environments can be pickled and copied.

    Actions are Discrete(R S + 1): candidate ``action // S`` at criticality ``strengths[action %
    S]``, and nobody for the last index. Observations are rows [R, F] of :data:`FEATURES`, the
    candidates nearest to the ego first. The reward is 1 for a collision that counts, less
    ``shift_cost`` times the shift of the guided plan in standard deviations. Episodes end with the
    ego's and with the horizon, which belongs to the task: both are terminations.

    Parameters
    ----------
    num_envs
        Number of worlds E.
    ego
        The ego's planner, see :func:`ccdiff_env.policies.planners.ego_driver`.
    max_candidates
        Rows R: vehicles that the background plans for, nearest to the ego first.
    strengths
        Criticalities S that an action chooses from.
    num_adversaries
        Vehicles that an action guides: its candidate and the others of closest approach.
    counts
        Which collisions with adversaries count, see :data:`Counts`.
    shift_cost
        Reward lost per standard deviation of shift; may be changed as training goes on.
    **options
        ``scenes``, ``config``, ``num_threads``, ``render_mode``, ``render_options`` and fields of
        :class:`~ccdiff_env.config.WorldConfig`, as for :class:`~ccdiff_env.EgoVectorEnv`. Traffic
        is ``"ccdiff"`` with :data:`DEFAULT_CCDIFF` unless told otherwise; its plans set the pace.

    Raises
    ------
    ConfigError
        For traffic that nothing guides, and options out of range.
    """

    reset_option_names = EgoVectorEnv.reset_option_names
    metadata = {  # noqa: RUF012 (Gymnasium's form)
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        ego: Ego = "idm",
        max_candidates: int = 8,
        strengths: Sequence[float] = STRENGTHS,
        num_adversaries: int = 1,
        counts: Counts = "all",
        shift_cost: float = 0.03,
        **options: Unpack[SelectionOptions],
    ) -> None:
        given: dict[str, Any] = dict(options)
        for name in _OWN:
            if name in given:
                raise ConfigError(f"{name} is not an option of adversary selection")
        for name, number in (
            ("max_candidates", max_candidates),
            ("num_adversaries", num_adversaries),
        ):
            if type(number) is not int or not 1 <= number <= 64:
                raise ConfigError(f"{name} is {number!r}, expected 1 to 64")
        self.strengths = tuple(float(strength) for strength in strengths)
        if not self.strengths or not all(0.0 < strength <= 10.0 for strength in self.strengths):
            raise ConfigError(f"strengths is {strengths!r}, expected numbers above 0, at most 10")
        if counts not in get_args(Counts):
            raise unknown("counts", str(counts), get_args(Counts))
        if not 0.0 <= shift_cost <= 1e6:
            raise ConfigError(f"shift_cost is {shift_cost!r}, expected 0 to 1000000")
        self.counts, self.shift_cost = counts, shift_cost
        scenes, config = scene_set(given.pop("scenes", None)), given.pop("config", None)
        if config is None and given.setdefault("traffic", "ccdiff") == "ccdiff":
            ccdiff = given.get("ccdiff", {})
            whole = {**DEFAULT_CCDIFF, **ccdiff} if isinstance(ccdiff, Mapping) else ccdiff
            given["ccdiff"] = whole
        if isinstance(ego, str) and ego in KINDS:  # the worlds drive it, and nobody observes
            config = config or WorldConfig(dt_s=scenes[0].dt)
            config = config.with_options(observation=_NO_ROWS)
        given |= {"scenes": scenes, "config": config, "driver": ego}
        #: The worlds, in which only the ego's planner acts.
        self.ego = EgoVectorEnv(num_envs, autoreset_mode="disabled", **given)
        networks = self.ego.config.guided_traffic("choice of adversaries")
        #: Steps of the worlds from one decision to the next.
        self.decision_steps, *others = dict.fromkeys(one.replan_steps for one in networks)
        if others:
            raise ConfigError(
                f"replan_steps are {self.decision_steps} and {others[0]}, expected one number for "
                "all traffic"
            )
        self.num_envs, self.max_candidates = num_envs, max_candidates
        self.num_adversaries = num_adversaries
        self.render_mode = self.ego.render_mode
        rows, bound = (max_candidates, len(FEATURES)), _TABLE["bound"]
        #: The action that chooses nobody, the last one.
        self.nobody = max_candidates * len(self.strengths)
        self.single_observation_space = spaces.Box(-bound, bound, rows, np.float32)
        self.single_action_space = spaces.Discrete(self.nobody + 1)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        #: Called after every step of the worlds, of which a decision has several.
        self.on_step: Callable[[], object] | None = None
        #: Agents in the rows of each world, and those that were guided in its episode.
        self.candidates: list[list[int]] = [[] for _ in range(num_envs)]
        self.adversaries: list[set[int]] = [set() for _ in range(num_envs)]
        #: Worlds [E] whose episode is over, or has not begun.
        self.ended = np.ones(num_envs, np.bool_)
        self._obs = np.zeros((num_envs, *rows), np.float32)
        self._recorders: dict[int, Recorder] = {}
        #: Sums of the episodes [K, E], and their decisions.
        self._totals = np.zeros((len(_NAMES) + 1, num_envs))

    @property
    def worlds(self) -> Worlds:  # type: ignore[override]
        """The native worlds."""
        return self.ego.worlds

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[F32, Info]:
        """Begin new episodes, with the seeds and options of :meth:`EgoVectorEnv.reset`.

        Returns
        -------
        obs, infos
            Observations [E, R, F]; ``scene``, ``scene_token``, ``seed``, ``episode_idx``.
        """
        _, infos = self.ego.reset(seed=seed, options=options)
        which = infos["_scene"]
        for e in np.flatnonzero(which).tolist():
            self.adversaries[e] = set()
            if self.counts == "avoidable":
                self._recorders[e] = Recorder(self.ego, world_idx=e)
        self.ended[which], self._totals[:, which] = False, 0.0
        self._look(which)
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
        ShapeError, ActionError
            If the actions do not fit; nothing has moved then.
        ResetNeededError
            Before the first reset.
        """
        rewards, table = self.decide(self.chosen(actions), all_running=True)
        done, who = self.ended.copy(), table.pop("adversary")

        def figures(mask: Bool) -> Info:
            shown = with_masks(_NAMES, np.stack(list(table.values())), mask)
            return {**shown, "adversary": who, "_adversary": mask}

        infos = figures(~done)
        if done.any():
            final, metrics = figures(done), self.metrics()
            final["metrics"] = with_masks(tuple(metrics), np.stack(list(metrics.values())), done)
            final["is_success"], final["_is_success"] = metrics["is_success"] > 0.5, done
            infos |= {"final_info": final, "_final_info": done, "_final_obs": done}
            infos["final_obs"] = np.full(self.num_envs, None, object)
            for e in np.flatnonzero(done):
                infos["final_obs"][e] = self._obs[e].copy()
            infos |= self.reset(options={"reset_mask": done})[1]
        return self._obs.copy(), rewards, done, np.zeros_like(done), infos

    def chosen(self, actions: Any) -> list[Choice]:
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
        found: list[Choice] = []
        for agents, seen, action in zip(self.candidates, self._obs, given.tolist(), strict=True):
            row, strength = divmod(action, len(self.strengths))
            order = seen[: len(agents), _APPROACH].argsort(kind="stable").tolist()
            first = [row, *(other for other in order if other != row)][: self.num_adversaries]
            guided = [agents[i] for i in first] if row < len(agents) else []
            found.append((guided, self.strengths[strength]))
        return found

    def decide(
        self, chosen: Sequence[Choice], *, all_running: bool = False
    ) -> tuple[F32, dict[str, npt.NDArray[Any]]]:
        """Advance the worlds that have not ended by one decision, without beginning new episodes.

        Parameters
        ----------
        chosen
            For each world, who is guided and how strongly.
        all_running
            Refuse worlds that have ended or were never reset.

        Returns
        -------
        rewards, table
            Rewards [E]; :data:`INFO_COLUMNS` by name and ``adversary`` (id or ``None``), [E].
        """
        if all_running and self.ended.any():
            raise ResetNeededError(f"world {self.ended.argmax()} has ended or was never reset")
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
            if step == 0:
                self._guidance(running, table, who)
            for e, recorder in self._recorders.items():
                if running[e]:
                    recorder.step()
            for e in np.flatnonzero(info["collision"] > 0.0).tolist():
                self._collision(e, table)
            self.ended |= terminated | truncated
            if self.on_step is not None:
                self.on_step()
        self._totals += np.stack([*table.values(), began])
        self._look(began)
        rewards = table["collisions"] - self.shift_cost * table["shift_sigmas"]
        return rewards.astype(np.float32), {**table, "adversary": who}

    def _guidance(
        self, running: Bool, table: dict[str, npt.NDArray[Any]], who: npt.NDArray[Any]
    ) -> None:
        """Note what the plans that were just made say about who is guided."""
        native = self.worlds.native
        for e in np.flatnonzero(running).tolist():
            found = native.guidance(e)
            if found is not None:
                agent, shift_sigmas, table["realism_cost"][e] = found
                table["shift_sigmas"][e] = shift_sigmas * self.num_adversaries
                table["guided"][e] = 1.0
                self.adversaries[e].add(agent)
                who[e] = self.worlds.scenes[native.status(e).scene_idx].agent_ids[agent]
        if np.isnan(table["shift_sigmas"]).any():
            raise ConfigError(
                f"traffic is {self.config.traffic!r}, expected a network that denoises: the shift "
                "of its plans is the cost of guidance"
            )

    def _collision(self, e: int, table: dict[str, npt.NDArray[Any]]) -> None:
        """Note the collision that the ego of a world just began."""
        native = self.worlds.native
        ego = native.status(e).ego_idx
        hits = {j: at_fault for i, j, *_, at_fault in native.contacts(e) if i == ego}
        table["ego_at_fault"][e] = float(any(hits.values()))
        adversaries = [hits[j] for j in hits if j in self.adversaries[e]]
        counts = bool(adversaries) and (self.counts != "ego_at_fault" or any(adversaries))
        if counts and self.counts == "avoidable":
            verdict = rollout_avoidability(self._recorders[e].rollout())
            counts = verdict is None or bool(verdict.avoidable)
        table["collisions"][e] += counts

    def metrics(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return figures [E] of the episodes so far; ``is_success``: a collision counted."""
        collisions, at_fault, shift, realism, guided, _, decisions = self._totals
        means = np.array([shift, realism, guided]) / np.maximum(decisions, 1.0)
        return {
            "is_success": np.minimum(collisions, 1.0),
            "collisions": collisions.copy(),
            "ego_at_fault": np.minimum(at_fault, 1.0),
            "mean_shift_sigmas": means[0],
            "mean_realism_cost": means[1],
            "guided": means[2],
            "decisions": decisions.copy(),
        }

    def action_masks(self) -> Bool:
        """Return which actions are legal [E, R S + 1], as MaskablePPO of sb3-contrib takes them."""
        there = np.repeat(self._obs[:, :, 0] > 0.5, len(self.strengths), axis=1)
        return np.pad(there, ((0, 0), (0, 1)), constant_values=True)

    def observation(self) -> F32:
        """Return the present observations [E, R, F] as a new array."""
        return self._obs.copy()

    def render(self) -> Any:
        """Return an image [H, W, 3] of every world; ``None`` without a render mode."""
        return self.ego.render()

    def _look(self, which: Bool) -> None:
        """Find the candidates of worlds and what is seen of them."""
        for e in np.flatnonzero(which).tolist():
            self.candidates[e], self._obs[e] = self.worlds.native.candidates(e, self.max_candidates)
