"""What every environment is made from: its worlds, its planner or selection, options of images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from ccdiff_env.config import WorldConfig
from ccdiff_env.envs.agent_selection import Adversaries, Agents, AgentSelection
from ccdiff_env.envs.drawing import check_render_mode, checked_render_options
from ccdiff_env.errors import ConfigError, unknown
from ccdiff_env.planners.built_in import Seat, seated
from ccdiff_env.traffic.options import Autoreset, VehicleRanking
from ccdiff_env.worlds import Scenes, Worlds, scene_set, world_config
from ccdiff_env.worlds.curriculum import Criticality
from ccdiff_env.worlds.spaces import FORMS, Form

InfoLevel = Literal["full", "end", "none"]


class Shared(NamedTuple):
    """Arguments that all environments take."""

    scenes: Scenes
    config: WorldConfig | None
    observation: Form
    info: InfoLevel
    render_mode: str | None
    render_options: Mapping[str, Any] | None
    criticality: Criticality | None
    modes: tuple[str, ...] = ("human", "rgb_array")  #: Render modes that there are.
    num_worlds: int = 1
    num_threads: int | None = 1
    autoreset: Autoreset = "disabled"

    def checked(self) -> dict[str, Any]:
        """Refuse choices that do not exist; return the options of images."""
        if self.observation not in FORMS:
            raise unknown("observation form", str(self.observation), FORMS)
        if self.info not in ("full", "end", "none"):
            raise unknown("info level", str(self.info), ("full", "end", "none"))
        check_render_mode(self.render_mode, self.modes)
        return checked_render_options(self.render_options)

    def worlds(self, scenes: Scenes, config: WorldConfig) -> Worlds:
        """Return the worlds of a configuration."""
        return Worlds(
            scene_set(scenes),
            config.with_options(autoreset=self.autoreset),
            num_worlds=self.num_worlds,
            num_threads=self.num_threads,
            trails=self.render_mode is not None,
            criticality=self.criticality,
        )


def ego_parts(
    shared: Shared, options: Mapping[str, Any]
) -> tuple[Worlds, Seat | None, dict[str, Any]]:
    """Return the worlds of one ego each, its planner, and options of images."""
    images = shared.checked()
    for name in ("controlled", "num_slots", "autoreset"):
        if name in options:
            raise ConfigError(f"{name} is not an option of environments with one ego per world")
    config = shared.config
    if config is not None and (config.controlled not in ("ego", "any") or config.num_slots != 1):
        raise ConfigError(f"config.controlled is {config.controlled!r}, expected 'ego' or 'any'")
    chosen = scene_set(shared.scenes)
    seat, config, given = seated(options, config, chosen[0].dt)
    resolved = world_config(chosen, config, given, shared.observation)
    return shared.worlds(chosen, resolved), seat, images


def agent_parts(
    shared: Shared,
    options: Mapping[str, Any],
    *,
    agents: Agents,
    ranking: VehicleRanking,
    adversaries: Adversaries,
    adversary_shaping: float,
) -> tuple[Worlds, AgentSelection, dict[str, Any]]:
    """Return the worlds of several agents each, who they are, and options of images."""
    images = shared.checked()
    for name in ("controlled", "ego", "num_slots", "autoreset"):
        if name in options:
            raise ConfigError(f"{name} is not an option of several agents: use agents")
    chosen = scene_set(shared.scenes)
    resolved = world_config(chosen, shared.config, options, shared.observation)
    selection = AgentSelection.of(
        chosen, resolved, agents=agents, ranking=ranking, adversaries=adversaries
    )
    resolved = selection.config(chosen, resolved, adversary_shaping)
    return shared.worlds(chosen, resolved), selection, images
