"""What every environment is made from: worlds, planner or agents, images."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig, check_option
from ccdiff_env.envs.agent_selection import AgentSelection, Bool
from ccdiff_env.envs.attributes import Attributes
from ccdiff_env.envs.drawing import check_render_options
from ccdiff_env.errors import ConfigError, unknown
from ccdiff_env.planners.built_in import Seat, seat_driver
from ccdiff_env.scenes import SceneSet
from ccdiff_env.traffic.options import Autoreset
from ccdiff_env.worlds import Scenes, Worlds, asked_by, scene_set, world_config
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.spaces import FORMS, Form

InfoLevel = Literal["full", "end", "none"]
#: What resets of one ego per world take, and of several agents.
EGO_OPTIONS = ("scene", "ego", "start", "style", "drivers")
AGENT_OPTIONS = ("scene", "drivers")


def reset_options(given: Any, known: Sequence[str]) -> Mapping[str, Any]:
    """Return the options of a reset; unknown ones are a :class:`ConfigError`."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigError(f"options is {given!r}, expected a dictionary")
    for name in given:
        if name not in known:
            raise unknown("reset option", str(name), known)
    return given


class OnWorlds(Attributes):
    """How environments are made, and what can be changed in them while an ego learns."""

    _own: ClassVar[tuple[str, ...]] = ("criticality",)
    worlds: Worlds
    _seat: Seat | None
    _selection: AgentSelection

    def _take(
        self,
        options: Mapping[str, Any],
        form: Form | Mapping[str, Any],
        info: InfoLevel,
        render_mode: str | None,
        render_options: Mapping[str, Any] | None,
    ) -> dict[str, Any]:
        """Refuse choices that do not exist; return the options, columns of observations among them.

        ``form`` is that of observations, or a dictionary of
        :class:`~ccdiff_env.config.ObservationConfig` in which ``form`` names it.
        """
        for name in options:
            check_option(name, inspect.signature(type(self)).parameters)
        given = dict(options)
        if isinstance(form, Mapping):
            given["observation"] = {**form}
            form = given["observation"].pop("form", "flat")
        if form not in FORMS:
            raise unknown("observation form", str(form), FORMS)
        if info not in ("full", "end", "none"):
            raise unknown("info level", str(info), ("full", "end", "none"))
        modes = self.metadata["render_modes"]
        if render_mode not in (None, *modes):
            raise ConfigError(
                f"render_mode is {render_mode!r}, expected None or one of {', '.join(modes)}"
                + ' ("human" needs pygame)' * (render_mode == "human")
            )
        self._render_options = check_render_options(render_options)
        self.render_mode = render_mode
        self._form: Form = form
        self._info: str = info
        return given

    def _play(
        self,
        scenes: SceneSet,
        config: WorldConfig,
        criticality: Criticality | None,
        num_worlds: int = 1,
        num_threads: int | None = 1,
        autoreset: Autoreset = "disabled",
    ) -> None:
        """Make the worlds of a configuration."""
        self.worlds = Worlds(
            scenes,
            config.with_options(autoreset=autoreset),
            num_worlds=num_worlds,
            num_threads=num_threads,
            criticality=criticality,
        )
        self._pace(config)

    def _seat_ego(
        self, scenes: Scenes, config: WorldConfig | None, options: Mapping[str, Any]
    ) -> tuple[SceneSet, WorldConfig]:
        """Make the planner of one ego per world; return scenes and configuration of its worlds."""
        for name in ("controlled", "num_slots", "autoreset"):
            if name in options:
                raise ConfigError(f"{name} is not supported with one ego: use AgentVectorEnv")
        if config and (config.controlled not in ("ego", "any") or config.num_slots != 1):
            raise ConfigError(
                f"config.controlled is {config.controlled!r}, expected 'ego' or 'any'"
            )
        chosen = scene_set(scenes)
        self._seat, config, given = seat_driver(options, config, asked_by(chosen))
        return chosen, world_config(chosen, config, given, self._form)

    def _select_agents(
        self,
        scenes: Scenes,
        config: WorldConfig | None,
        options: Mapping[str, Any],
        shaping: float,
        /,
        **choice: Any,
    ) -> tuple[SceneSet, WorldConfig]:
        """Select several agents per world; return scenes and configuration of their worlds.

        ``choice`` is that of :class:`AgentSelection`.
        """
        for name in ("controlled", "ego", "num_slots", "autoreset"):
            if name in options:
                raise ConfigError(f"{name} is not supported with several agents: pass agents=")
        chosen = scene_set(scenes)
        resolved = world_config(chosen, config, options, self._form)
        self._selection = AgentSelection.of(chosen, resolved, **choice)
        return chosen, self._selection.config(chosen, resolved, shaping)

    def _in_slots(self, world_idx: int) -> tuple[list[str | None], Bool]:
        """Return the ids in the slots of a world [C], and which of them are adversaries [C]."""
        scene_idx = self.worlds.native.status(world_idx).scene_idx
        ids, agents = self.worlds.scenes[scene_idx].agent_ids, self.worlds.native.slot_agents
        names = [None if agent is None else ids[agent] for agent in agents(world_idx)]
        return names, self._selection.adversary_slots(scene_idx, names)

    @property
    def criticality(self) -> Criticality | None:
        """How critical traffic is, as the environment was told; set, it holds from the next reset.

        It takes what :class:`~ccdiff_env.worlds.curriculum.Curriculum` takes. ``None``: as
        configured.
        """
        return None if self.worlds.curriculum is None else self.worlds.curriculum.criticality

    @criticality.setter
    def criticality(self, criticality: Criticality) -> None:
        self.worlds.set_criticality(criticality)

    def set_progress(self, progress: float) -> None:
        """Set the progress of training, see :meth:`ccdiff_env.worlds.Worlds.set_progress`."""
        self.worlds.set_progress(progress)

    def set_scene_weights(self, weights: Sequence[float] | npt.NDArray[np.float64] | None) -> None:
        """Draw scenes by weights, see :meth:`ccdiff_env.worlds.Worlds.set_scene_weights`."""
        self.worlds.set_scene_weights(weights)
