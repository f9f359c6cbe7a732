"""Custom traffic models, written in Python."""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, PolicyError, ShapeError, raised_by
from ccdiff_env.scenes.scene_types import AGENT_KINDS as AGENT_KINDS
from ccdiff_env.system.fields import documented, shapes
from ccdiff_env.system.named_objects import named_instance
from ccdiff_env.traffic.checked_options import check
from ccdiff_env.traffic.options import PythonOptions

if TYPE_CHECKING:
    from ccdiff_env.scenes import Scene, SceneSet

F32 = npt.NDArray[np.float32]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

#: Distance between places of :attr:`TrafficBatch.route_m`, m.
ROUTE_SPACING_M: float = _native.ROUTE_SPACING_M


@documented
@dataclass(frozen=True, eq=False, kw_only=True)
class TrafficBatch:
    """What a traffic model sees: all agents of all worlds for which a plan is due.

    M agents of W worlds, H past states each, the present one last. Positions and headings are those
    of the frame of each agent's scene. Entries of states that are not valid are zero.
    """

    position_m: F32  #: Centres, m, [M, H, 2].
    heading_rad: F32  #: Headings, rad, [M, H].
    speed_mps: F32  #: Speeds along the heading, m/s, [M, H].
    valid: Bool  #: Whether the agent was there, [M, H].
    size_m: F32  #: Lengths and widths, m, [M, 2].
    kind: npt.NDArray[np.uint8]  #: Kinds, indices of :data:`AGENT_KINDS`, [M].
    #: Agents [M] that the model drives; the others have other drivers, and their plans are not
    #: looked at.
    drives: Bool
    is_ego: Bool  #: Whether an agent is its world's ego, or driven from outside, [M].
    #: Whether a vehicle never moves in its log, and stays where it is for other traffic, [M].
    is_parked: Bool
    world: I64  #: World of each agent among the W, [M]; agents of a world stand together.
    agent: I64  #: Index of each agent in its scene, [M].
    #: Scene of each world with its map (:meth:`~ccdiff_env.Scene.map_layers`), W of them.
    scenes: tuple[Scene, ...]
    scene_idx: I64  #: Index of each world's scene in the environment's list, [W].
    elapsed_steps: I64  #: Steps since each world's episode began, [W].
    #: Seed of each world's random numbers for this plan, [W]: another one for every plan, the same
    #: whatever the batch.
    seed: npt.NDArray[np.uint64]
    #: Strength that a curriculum or ``override_plan`` asks of each world, 0 where nobody does, [W].
    criticality: F32
    dt_s: float  #: Seconds between states, and between the steps of a plan.
    #: Places on each vehicle's route, from where it is on, :data:`ROUTE_SPACING_M` apart, m, in the
    #: frame of its scene, [M, P, 2]. Routes are those of IDM and CCDiff: the logged path, then
    #: the lanes ahead, else straight on. They tell where a vehicle goes, not when.
    route_m: F32
    #: Whether a route is told and goes so far, [M, P]; no routes are told of others than vehicles.
    route_valid: Bool
    __repr__ = shapes

    @classmethod
    def from_log(
        cls,
        scenes: Sequence[Scene],
        steps: Sequence[int] | npt.NDArray[np.integer[Any]],
        *,
        future_steps: int,
        history_states: int = PythonOptions.history_states,
        route_points: int = PythonOptions.route_points,
        seed: int = 0,
    ) -> tuple[TrafficBatch, LoggedFuture]:
        """Return what a model would be told at steps of logs, and what came after: for training.

        The arrays are those of an episode that starts at the step, bit for bit. World ``i`` is
        scene ``i`` at step ``i``; the agents are those logged at that step; ``drives`` says which
        of them are vehicles. Another ``seed`` gives other numbers in :attr:`seed`.

        Args:
            scenes: The scene of each world, W of them with one step ``dt``; a scene may stand there
                twice.
            steps: Steps of their logs, 0 to ``num_steps - 1``, [W].
            future_steps: States after the step F that :class:`LoggedFuture` tells, up to 10000.
            history_states, route_points: As of :class:`PythonTraffic`: H and P.
            seed: Any integer.

        Raises:
            ShapeError: If there is not one step for each scene.
            ConfigError: If there is no scene, or a number is out of its range.
            SceneError: If scenes have different ``dt``.
        """
        options = {"history_states": history_states, "route_points": route_points}
        check("PythonOptions", "python", options)
        listed = list(scenes)
        if not listed:
            raise ConfigError("scenes: empty, expected at least one scene")
        try:
            at, future = [operator.index(step) for step in steps], operator.index(future_steps)
        except TypeError as error:
            raise ConfigError(f"steps, future_steps: {error}, expected integers") from None
        if not 0 <= future <= 10_000:
            raise ConfigError(f"future_steps is {future}, expected 0 to 10000")
        if any(step < 0 for step in at):
            raise ConfigError(f"steps: {min(at)}, expected at least 0")
        arrays, after = _native.traffic_batch_from_log(
            listed, at, history_states, route_points, future, operator.index(seed) % 2**64
        )
        return cls(**arrays, scenes=tuple(listed), dt_s=listed[0].dt), LoggedFuture(**after)


@documented
@dataclass(frozen=True, eq=False, kw_only=True)
class LoggedFuture:
    """Logged states of the M agents of a batch after its step; zero where not valid."""

    position_m: F32  #: Centres, m, in the frame of each agent's scene, [M, F, 2].
    heading_rad: F32  #: Headings, rad, in that frame, [M, F].
    speed_mps: F32  #: Speeds along the heading, m/s, [M, F].
    valid: Bool  #: Whether the agent is logged, [M, F].
    __repr__ = shapes


#: From a batch to poses x, y (m), heading (rad) in the scene's frame [M, T, 3], or accelerations
#: (m/s²) and yaw rates (rad/s) [M, T, 2], after and during each of the next T steps.
TrafficModel: TypeAlias = Callable[[TrafficBatch], Any]


@dataclass(frozen=True)
class PythonTraffic(PythonOptions):
    """A custom traffic model as a driver: ``traffic=PythonTraffic(model)``.

    The model is called once per plan phase for all worlds that are due, and its plans are followed
    in between. It must be a function of what it sees (randomness from ``seed`` alone): then the
    same seed gives the same traffic, and snapshots, which hold the plans, need nothing of it.

    Args:
        model: From a :class:`TrafficBatch` to poses [M, T, 3] or accelerations and yaw rates [M, T,
            2], an array or a tensor of torch. The latter are driven by a unicycle that does not
            reverse.
        replan_steps: Steps from one plan to the next, 1 to T.
        history_states: Past states H of each agent, the present one included.
        least_history_states: Fewest of them that the log must have at the start of an episode; the
            states before it are told as not valid.
        route_points: Places P on each vehicle's route.

    Examples:
        >>> import ccdiff_env, numpy as np
        >>> from ccdiff_env.traffic import PythonTraffic
        >>> def coast(batch):
        ...     return np.zeros((len(batch.kind), 10, 2), np.float32)
        >>> env = ccdiff_env.make_vec(4, traffic=PythonTraffic(coast))
    """

    model: TrafficModel | str

    def __post_init__(self) -> None:
        if not callable(self.model) and not isinstance(self.model, str):
            raise ConfigError(f"python.model is {self.model!r}, expected a function or an object")
        steps = {f.name: getattr(self, f.name) for f in dataclasses.fields(PythonOptions)}
        check("PythonOptions", "python", steps)

    @classmethod
    def load(cls, path: str) -> PythonTraffic:
        """Import a model by its path, ``"module:name"`` or ``"module:Class?option=value"``.

        Args:
            path: A function, an object, a class (made with the options), or a
                :class:`PythonTraffic`.

        Raises:
            ConfigError: If there is no such thing or option, or the class wants arguments.
        """
        made = named_instance(path, "traffic model")
        return made if isinstance(made, PythonTraffic) else cls(made)

    @property
    def described(self) -> str:
        """Path of the model, for reports and the fingerprint of a configuration."""
        if isinstance(self.model, str):
            return self.model
        named: Any = self.model if hasattr(self.model, "__qualname__") else type(self.model)
        return f"{named.__module__}:{named.__qualname__}"


class BoundTraffic:
    """A model in an environment: what is called with arrays, checks the answer and returns it.

    ``name`` is that of the driver; messages call the model by its path.
    """

    def __init__(self, name: str, traffic: PythonTraffic, scenes: SceneSet, dt_s: float) -> None:
        if isinstance(traffic.model, str):
            raise ConfigError(
                f"named_drivers.{name}: the model {traffic.model!r} is a name, expected an object: "
                "files do not import code, PythonTraffic.load does"
            )
        self._name, self._model = traffic.described, traffic.model
        self._replan_steps = traffic.replan_steps
        self._scenes, self._dt_s = list(scenes), dt_s

    def __call__(self, arrays: Mapping[str, npt.NDArray[Any]]) -> F32:
        """Return the plans [M, T, 3] or [M, T, 2] of the agents of a batch.

        Another shape, or too few steps for the time between plans, is a :class:`ShapeError`; a plan
        that is not finite a :class:`PolicyError`.
        """
        scenes = tuple(self._scenes[i] for i in arrays["scene_idx"])
        batch = TrafficBatch(**arrays, scenes=scenes, dt_s=self._dt_s)
        where = ", ".join(scene.name for scene in scenes[:3])
        with raised_by(f"traffic {self._name!r}", where):
            answer = self._model(batch)
        if hasattr(answer, "detach"):
            answer = answer.detach().cpu().numpy()
        try:
            plans = np.array(answer, np.float32, order="C", ndmin=1)
        except (TypeError, ValueError) as error:
            raise ShapeError(f"traffic {self._name!r}: {error}, expected an array") from None
        rows, least = len(batch.kind), self._replan_steps
        fits = plans.ndim == 3 and plans.shape[0] == rows and plans.shape[2] in (2, 3)
        if not fits or plans.shape[1] < least:
            raise ShapeError(
                f"traffic {self._name!r}: plans have shape {list(plans.shape)}, expected "
                f"[{rows}, T, 3] or [{rows}, T, 2] with T of at least {least} (replan_steps)"
            )
        sound = (np.abs(plans) < 1e6).all(axis=(1, 2))  # neither NaN nor infinite either
        bad = np.flatnonzero(batch.drives & ~sound)
        if bad.size:
            scene = scenes[batch.world[bad[0]]]
            agent = scene.agent_ids[batch.agent[bad[0]]]
            values = plans[bad[0]]
            worst = values[~(np.abs(values) < 1e6)][0]
            raise PolicyError(
                f"traffic {self._name!r}: plan of agent {agent!r} of scene {scene.name!r} holds "
                f"{worst}, expected finite numbers below 1e6"
            )
        plans[~batch.drives] = 0.0
        return plans
