"""One world with the ego as its controlled agent, as a plain Gymnasium environment."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.drawing import RENDER_MODES, DrawnWorld
from ccdiff_env.envs.parts import EGO_OPTIONS, InfoLevel, OnWorlds, reset_options
from ccdiff_env.errors import ResetNeededError, SnapshotError
from ccdiff_env.record.certificate import Certificate
from ccdiff_env.scenes import SceneSet
from ccdiff_env.traffic import TrafficPlan
from ccdiff_env.worlds import Scenes, normalize_seed
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.snapshot import Snapshot
from ccdiff_env.worlds.spaces import Form

F32 = npt.NDArray[np.float32]


class EgoEnv(OnWorlds, DrawnWorld, gymnasium.Env[Any, Any]):
    """Drive the ego of a logged scene among traffic, along its recorded route.

    Action
        Box [2] in [-1, 1]; beyond, it is clipped. With the unicycle, +1 is 4 m/s² and -1 is
        -8 m/s² of acceleration, and 1 is 1 rad/s of yaw rate to the left. ``dynamics`` takes
        ``"bicycle"``, ``"delta_pose"`` or ``"assisted"`` (changes of what IDM would do) in its
        place. With ``discrete=True`` it is an index of a grid (Discrete).

    Observation
        ``observation="flat"``: Box [D], float32. ``"dict"``: a Box per entry, a MultiBinary per
        mask, with ``bev={}`` a bird's-eye raster besides. ``"bev"``: the raster alone, Box uint8
        [channels, S, S]. Places are in the ego's frame; ``worlds.layout`` names all numbers, with
        their units and scales. Numbers are bounded and never NaN.

    Reward
        Sum of weighted components: progress along the route, collision, leaving the road, comfort,
        speed above the limit, distance from the route, goal. ``reward={"goal": 5.0}`` sets weights;
        ``info`` holds each component as ``reward_<name>``.

    Start
        30 steps into the log of a scene that the seed draws, with all agents that are there then.
        ``start_spread_steps`` spreads the starts; ``options={"scene": name}`` names the scene.
        With ``ego="any"`` the seed draws a vehicle that drives on for 10 m, and a step of the log.

    End
        Terminated: a collision, a corner off the road, or the goal (the logged position at the
        horizon). Truncated: the horizon (100 steps), or the end of the log. ``info["metrics"]`` and
        ``info["is_success"]`` summarise the episode.

    Args:
        scenes: A :class:`SceneSet`, scenes, the text of a source (:func:`ccdiff_env.load`), or the
            name of a split of the embedded scenes.
        config: Configuration to start from.
        observation: ``"flat"``, ``"dict"`` or ``"bev"``, as above; or fields of
            :class:`~ccdiff_env.config.ObservationConfig` to change and the ``form``:
            ``{"form": "dict", "num_neighbors": 8}``.
        info: ``"full"``: all columns of every step; ``"end"``: only of the last step of an episode;
            ``"none"``: only numbers at resets: index of the scene, seed, episode.
        render_mode: ``None``, ``"rgb_array"`` or ``"human"`` (needs pygame).
        render_options: Options of images: ``size``, ``span_m``, ``centre``, ``heading_up``,
            ``route``, ``labels``, ``theme``.
        criticality: How critical CCDiff traffic is in each episode: a number, a range to draw from,
            or a function of the progress of training, which :meth:`set_progress` sets (see
            :class:`~ccdiff_env.worlds.curriculum.Curriculum`).
        **options: Fields of :class:`~ccdiff_env.config.WorldConfig` by name, such as
            ``traffic="idm"``, ``driver="idm"``, ``dynamics="bicycle"``, ``discrete=True``,
            ``bev={"size_px": 64}``. ``driver`` names a planner, too: ``"pdm"``, ``"ego"``,
            ``"module:name"``, a policy's file (docs/planners.md). With any driver but an
            external one, ``step`` ignores its action.

    Notes:
        Environments can be pickled and deep-copied in the middle of an episode. The state
        of a planner is not copied: after a copy, a fork or :meth:`restore` it is called afresh.
    """

    metadata = {"render_modes": RENDER_MODES}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        *,
        scenes: Scenes = None,
        config: WorldConfig | None = None,
        observation: Form | Mapping[str, Any] = "flat",
        info: InfoLevel = "full",
        render_mode: str | None = None,
        render_options: Mapping[str, Any] | None = None,
        criticality: Criticality | None = None,
        **options: Any,
    ) -> None:
        options = self._take(options, observation, info, render_mode, render_options)
        chosen, config = self._seat_ego(scenes, config, options)
        self._play(chosen, config, criticality)
        self.observation_space: gymnasium.Space[Any] = self.worlds.observation_space(self._form)
        self.action_space: gymnasium.Space[Any] = self.worlds.action_space
        self._actions: bytearray | None = bytearray()

    @property
    def scenes(self) -> SceneSet:
        """Scenes that the environment plays."""
        return self.worlds.scenes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a new episode.

        Args:
            seed: Any integer; ``None`` goes on with the world's generator.
            options: ``scene``: name or index of the scene; with ``ego="any"`` besides ``ego``: id,
                and ``start``: step of the log; ``style``: factors of weights of the reward;
                ``drivers``: drivers of single vehicles by id, for this episode.

        Returns:
            obs, info: First observation; ``scene``, ``scene_token``, ``seed``, ``episode_idx``, and
                where they are drawn ``ego``, ``ego_idx``, ``start_step``.
        """
        given = reset_options(options, EGO_OPTIONS)
        scene, *rest, drivers = (given.get(name) for name in EGO_OPTIONS)
        scene_idx = self.worlds.scene_index(scene)
        wanted = self.worlds.wanted(scene_idx, *rest)
        assigned = self.worlds.agent_drivers(drivers)
        normalized = None if seed is None else normalize_seed(seed)
        super().reset(seed=normalized)
        if normalized is None and not self.worlds.native.begun(0):
            normalized = int(self.np_random.integers(2**63))
        out = self.worlds.arrays()
        self.worlds.native.reset([normalized], [scene_idx], None, out, [wanted])
        if self._seat is not None:
            self._seat.reset([0])
            self._seat.see(out)
        self.worlds.assign(0, assigned)
        self._actions = bytearray()
        self._show()
        return self._observation(out.obs, out.bev), self.worlds.begin_episode(0, self._info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step.

        Args:
            action: Numbers [W] in [-1, 1] (beyond, they are clipped), or an index of the grid.

        Returns:
            obs, reward, terminated, truncated, info: ``info`` holds the info columns of the step
                and, at the end of an episode, ``metrics``.

        Raises:
            ShapeError, ActionError: If the action is invalid; the world is unchanged.
            ResetNeededError: Before the first reset and after the end of an episode.
        """
        if self._seat is not None and self.worlds.native.begun(0):
            action = self._seat.decide(self.worlds)[0]
        checked = self.worlds.actions(action, self.worlds.action_shape)
        out = self.worlds.arrays()
        self.worlds.native.step(checked, out)
        if self._seat is not None:
            self._seat.see(out)
        if self._actions is not None:
            self._actions += checked.tobytes()
        self._show()
        return (
            self._observation(out.obs, out.bev),
            float(out.reward[0, 0]),
            bool(out.terminated[0, 0]),
            bool(out.truncated[0, 0]),
            self._step_info(out, bool(out.done[0])),
        )

    def observation(self) -> Any:
        """Return the present observation once more, as a new array."""
        rows, bev = self.worlds.observe(0)
        return self._observation(rows[None], None if bev is None else bev[None])

    def expert_action(self) -> Any:
        """Return the action that leads to the ego's logged state at the next decision."""
        action: F32 = self.worlds.native.expert_actions(0)[0]
        if self.worlds.discrete:
            return np.int64(action[0])
        return action

    def snapshot(self) -> bytes:
        """Return everything that the environment's future depends on."""
        actions = None if self._actions is None else bytes(self._actions)
        return Snapshot.of(self.worlds, 0, actions).to_bytes()

    def restore(self, snapshot: bytes, *, seed: int | None = None) -> Any:
        """Return to the state of a snapshot, bit for bit.

        Args:
            snapshot: What :meth:`snapshot` of an environment of the same configuration and scenes
                gave.
            seed: Any integer: from here on, traffic draws from this seed; its present plan and
                drivers stay. The next episode is the first of the seed.

        Returns:
            obs: The observation of that moment; ``None`` if it was before the first reset.

        Raises:
            SnapshotError: If the bytes are damaged, or belong to another configuration or other
                scenes; nothing has changed then.
            ResetNeededError: With a seed, if the snapshot was taken before the first reset.
        """
        saved = Snapshot.from_bytes(snapshot)
        if len(saved.actions or b"") % (4 * self.worlds.native.action_width):
            raise SnapshotError("snapshot: actions do not fit")
        saved.put(self.worlds, 0, seed)
        known = seed is None and saved.actions is not None
        self._actions = bytearray(saved.actions or b"") if known else None
        if self._seat is not None:
            self._seat.reset([0])
        return self.observation() if self.worlds.native.begun(0) else None

    def explain(self) -> TrafficPlan:
        """Return the plan that CCDiff traffic follows.

        Raises:
            ResetNeededError: Before the first step after a reset: traffic plans in it.
            UnknownNameError: If CCDiff drives nobody.
        """
        plan = self.worlds.explain(0)
        if plan is None:
            raise ResetNeededError("explain: there is no plan before the first step: call step()")
        return plan

    def fork(self, *, seed: int | None = None) -> EgoEnv:
        """Return an independent environment in the same state, with a ``seed`` of its own."""
        fork = copy.deepcopy(self)
        if seed is not None:
            fork.restore(fork.snapshot(), seed=seed)
        return fork

    def certificate(self) -> Certificate:
        """Return the certificate of the episode so far: from it, it can be simulated again.

        Raises:
            SnapshotError: If the environment was restored with another seed, or from a snapshot
                that does not hold the actions.
            ResetNeededError: Before the first reset.
        """
        if self._actions is None:
            raise SnapshotError(
                "certificate: the environment was restored with another seed, or from a snapshot "
                "without the actions before it"
            )
        return Certificate.of(self.worlds, bytes(self._actions))
