"""The set that scenes come in."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import overload

from ccdiff_env._native import Scene
from ccdiff_env.errors import ConfigError, UnknownNameError, hint_of
from ccdiff_env.scenes.load_report import LoadReport
from ccdiff_env.scenes.windows import Windows


class SceneSet(Sequence[Scene]):
    """An immutable sequence of scenes with the report of their load.

    Args:
        scenes: The scenes, with names that are unique in the set.
        report: What the load has to say, or a function that makes the report when it is first
            looked at; empty where the scenes were not loaded from files.
        window: How the scenes were cut from logs, for episodes to be those of the windows.

    Examples:
        ``scenes[0]``, ``scenes[:4]`` (a :class:`SceneSet`), ``scenes["scene-0061"]``,
        ``"scene-0061" in scenes``.
    """

    __slots__ = ("_by_name", "_names", "_report", "_scenes", "window")

    def __init__(
        self,
        scenes: Iterable[Scene],
        report: LoadReport | Callable[[], LoadReport] | None = None,
        window: Windows | None = None,
    ) -> None:
        self._scenes = tuple(scenes)
        self._names = tuple(scene.name for scene in self._scenes)
        self._by_name = {name: index for index, name in enumerate(self._names)}
        if len(self._by_name) != len(self._scenes):
            twin = next(name for name in self._names if self._names.count(name) > 1)
            raise ConfigError(f"two scenes have the same name, {twin!r}: a SceneSet has it once")
        self._report = report if report is not None else LoadReport()
        self.window = window

    def having(self, scenes: Iterable[Scene], window: Windows | None = None) -> SceneSet:
        """Return a set of other scenes with the same report."""
        return SceneSet(scenes, self._report, window or self.window)

    @property
    def report(self) -> LoadReport:
        """What the load has to say."""
        if not isinstance(self._report, LoadReport):
            self._report = self._report()
        return self._report

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scenes, in order."""
        return self._names

    def __len__(self) -> int:
        return len(self._scenes)

    def __iter__(self) -> Iterator[Scene]:
        return iter(self._scenes)

    def __contains__(self, value: object) -> bool:
        return value in self._by_name if isinstance(value, str) else value in self._scenes

    @overload
    def __getitem__(self, key: int | str) -> Scene: ...
    @overload
    def __getitem__(self, key: slice) -> SceneSet: ...
    def __getitem__(self, key: int | str | slice) -> Scene | SceneSet:
        """Return a scene by index or name, or a set by slice (with the whole load's report)."""
        if isinstance(key, slice):
            return self.having(self._scenes[key])
        if isinstance(key, str):
            if key not in self._by_name:
                hint = hint_of(key, self.names)
                raise UnknownNameError(f"no scene {key!r} among the {len(self)} loaded: {hint}")
            key = self._by_name[key]
        try:
            return self._scenes[key]
        except IndexError:
            raise IndexError(f"no scene {key} among the {len(self)} loaded") from None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SceneSet) and self._scenes == other._scenes

    def __hash__(self) -> int:
        return hash(self._scenes)

    def __deepcopy__(self, memo: object) -> SceneSet:
        return self  # it never changes

    def __repr__(self) -> str:
        return (
            f"SceneSet({len(self)} scenes: {', '.join(self.names[:3])}{', ...' * (len(self) > 3)})"
        )
