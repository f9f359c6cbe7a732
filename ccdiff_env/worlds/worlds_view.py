"""Worlds as a planner sees them: what a vehicle can know, and nothing that changes them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ccdiff_env.errors import ConfigError
from ccdiff_env.worlds import Worlds

#: What can be read, of each kind of object; a mapping says what its own parts show, or what comes
#: of a call.
_SCENE = dict.fromkeys(("dt", "location", "agent_types", "agent_categories", "sizes", "map_layers"))
_CONFIG = dict.fromkeys((
    "action", "decision_steps", "dt_s", "history_steps", "horizon_steps", "num_slots",
    "observation", "on_collision", "on_off_road", "reward", "speed_limit_mps", "style",
    "terminate_at_goal",
))  # fmt: skip
_STATUS = dict.fromkeys(("scene_idx", "step_idx", "elapsed_steps", "ego_idx"))
_NATIVE: dict[str, Any] = {
    **dict.fromkeys((
        "action_bounds", "action_width", "begun", "contacts", "layout_json", "num_actions",
        "num_worlds", "off_road", "planner_actions", "route", "slot_agents", "slot_alive",
        "states",
    )),
    "status": _STATUS,
}  # fmt: skip
_WORLDS: dict[str, Any] = {
    **dict.fromkeys((
        "action_space", "column_names", "columns", "layout", "metric_names", "num_slots",
        "num_worlds", "observation_space", "observe",
    )),
    "config": _CONFIG,
    "native": _NATIVE,
    "scenes": _SCENE,
}  # fmt: skip


class _View:
    """Shows some attributes of an object and refuses the others by name."""

    def __init__(self, target: Any, shown: Mapping[str, Any], path: str) -> None:
        self._target, self._shown, self._path = target, shown, path

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name not in self._shown:
            raise ConfigError(
                f"{self._path}.{name} is for planners that say privileged = True; others read "
                + ", ".join(self._shown)
            )
        found, parts = getattr(self._target, name), self._shown[name]
        if parts is _SCENE:
            return _Scenes(found, parts, f"{self._path}.{name}", self._target)
        return found if parts is None else _View(found, parts, f"{self._path}.{name}")

    def __repr__(self) -> str:
        """Return what can be read, with the values where they are numbers."""
        parts = (
            self._shown
            if self._shown is not _STATUS
            else [f"{name}={getattr(self._target, name)}" for name in _STATUS]
        )
        return f"{self._path}({', '.join(parts)})"

    def __call__(self, *given: Any) -> _View:
        return _View(self._target(*given), self._shown, f"{self._path}()")

    def __getitem__(self, index: Any) -> _View:
        return _View(self._target[index], self._shown, f"{self._path}[{index}]")

    def __len__(self) -> int:
        return len(self._target)


class _Scenes(_View):
    """Scenes of worlds by number, of whose agents those are shown that are there at present."""

    def __init__(self, target: Any, shown: Mapping[str, Any], path: str, worlds: Worlds) -> None:
        super().__init__(target, shown, path)
        self._worlds = worlds

    def __getitem__(self, index: Any) -> _View:
        if not isinstance(index, (int, np.integer)):
            raise ConfigError(f"{self._path}[{index!r}]: scenes go by their numbers")
        scene = self._target[int(index)]
        return _Scene(scene, self._shown, f"{self._path}[{index}]", self._worlds)


class _Scene(_Scenes):
    def __getattr__(self, name: str) -> Any:
        found = super().__getattr__(name)
        if name not in ("agent_types", "agent_categories", "sizes"):
            return found
        there = np.zeros(self._target.num_agents, np.bool_)
        native = self._worlds.native
        for i in range(native.num_worlds):
            if native.begun(i) and self._worlds.scenes[native.status(i).scene_idx] is self._target:
                there |= native.states(i)["active"]
        if name == "sizes":
            return np.where(there[:, None], found, np.float32(0.0))
        return [text if here else "" for text, here in zip(found, there, strict=True)]


def behind(shown: Any) -> Any:
    """Return what a view shows, for functions of the package that only read it."""
    return shown._target if isinstance(shown, _View) else shown


def worlds_view(worlds: Worlds, who: str) -> Any:
    """Return worlds that can only be read, and show what a vehicle can know; errors name ``who``.

    There is no log, snapshot or plan of others, no name, token or hash of a scene, no seed, and
    nothing of who drives the others. Agents that are not there at present have size 0 and empty
    types and categories. This is a convention, not a sandbox: code that digs through private
    names gets through, and who knows all scenes can tell them apart by what is there.
    """
    return _View(worlds, _WORLDS, f"{who}: worlds")
