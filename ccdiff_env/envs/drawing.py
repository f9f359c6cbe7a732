"""One world of an environment: what is seen and said of a slot, images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from operator import index
from typing import Any

import gymnasium
from gymnasium.wrappers import HumanRendering

from ccdiff_env.envs.attributes import Attributes
from ccdiff_env.envs.image import image
from ccdiff_env.errors import ConfigError, unknown
from ccdiff_env.scenes import Scene
from ccdiff_env.worlds import StepArrays
from ccdiff_env.worlds.spaces import F32, U8, Form

Image = U8

#: Options of an image: width and height in pixels, metres across, agent id or (x, y) in the middle
#: (the ego by default), whether its heading points up, what is drawn, and on which ground.
RENDER_OPTIONS: dict[str, Any] = {
    "size": (640, 640),
    "span_m": 90.0,
    "centre": None,
    "heading_up": False,
    "route": True,
    "labels": True,
    "theme": "light",
}


def _two(read: Callable[[Any], Any], given: Iterable[Any]) -> tuple[Any, Any]:
    first, second = given
    return read(first), read(second)


#: How the value of an option is read, and what is expected.
_READ: dict[str, tuple[Callable[[Any], Any], str]] = {
    **dict.fromkeys(RENDER_OPTIONS, ({True: True, False: False}.__getitem__, "True or False")),
    "size": (lambda given: _two(index, given), "whole numbers of pixels across and down"),
    "span_m": (float, "a number of metres"),
    "centre": (lambda to: to if to is None or isinstance(to, str) else _two(float, to),
               "an agent id, or x and y in metres"),
    "theme": (str, ""),
}  # fmt: skip


def check_render_options(given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the options of images with defaults filled in; refuses unknown names and forms."""
    options = dict(RENDER_OPTIONS)
    for name, value in (given or {}).items():
        if name not in RENDER_OPTIONS:
            raise unknown("render option", str(name), RENDER_OPTIONS)
        read, expected = _READ[name]
        try:
            options[name] = read(value)
        except (TypeError, ValueError, KeyError, OverflowError):
            text = f"render option {name} is {value!r}, expected {expected}"
            raise ConfigError(text) from None
    return options


#: What single environments offer: a window only where pygame can open one.
RENDER_MODES = [*(["human"] if find_spec("pygame") else []), "rgb_array"]


class _Images(gymnasium.Env[Any, Any]):
    """Images as an environment, for the window of Gymnasium's wrapper: a reset shows one."""

    render_mode = "rgb_array"

    def __init__(self, draw: Callable[[], Image], fps: float) -> None:
        self._draw = draw
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": fps}

    def render(self) -> Any:
        return self._draw()

    def reset(self, **_: Any) -> tuple[None, dict[str, Any]]:
        return None, {}


class DrawnWorld(Attributes):
    """What every environment of one world has: its scene, what is seen, and images."""

    render_mode: str | None
    _render_options: dict[str, Any]
    _form: Form
    _info: str
    _window: HumanRendering[Any, Any] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle holds: all but the window."""
        return {name: value for name, value in vars(self).items() if name != "_window"}

    @property
    def scene(self) -> Scene:
        """Scene of the present episode."""
        return self.worlds.scenes[self.worlds.native.status(0).scene_idx]

    def _observation(self, obs: F32, bev: Image | None, slot: int = 0) -> Any:
        """Observation of a slot, from arrays [1, C, ...], in the chosen form."""
        raster = None if bev is None else bev[0, slot]
        return self.worlds.layout.observation(self._form, obs[0, slot], raster)

    def _step_info(self, out: StepArrays, ended: bool, slot: int = 0) -> dict[str, Any]:
        """Info columns of a slot's step, and at its end what episode it was, and metrics."""
        info: dict[str, Any] = {}
        if self._info == "full" or (self._info == "end" and ended):
            columns = out.columns[0, slot].tolist()
            info.update(zip(self.worlds.column_names, columns, strict=True))
        if ended and self._info != "none":
            info.update(self.worlds.episodes[0])
            metrics = self.worlds.native.metrics(0)[slot].tolist()
            info["metrics"] = dict(zip(self.worlds.metric_names, metrics, strict=True))
        return info

    def render(self) -> Image | None:
        """Return an image [H, W, 3], show it, or do nothing, as the render mode says."""
        if self.render_mode == "rgb_array":
            return self._image()
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() was called without a render mode: make the environment with "
                'render_mode="rgb_array" or "human".'
            )
        self._show()
        return None

    def _image(self) -> Image:
        return image(self.worlds, 0, **self._render_options)

    def _show(self) -> None:
        """Show the world in a window, where the render mode says so."""
        if self.render_mode == "human":
            fps = self.metadata["render_fps"]
            self._window = self._window or HumanRendering(_Images(self._image, fps))
            self._window.reset()
            import pygame

            pygame.display.set_caption(f"ccdiff-env: {self.scene.name}")

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()  # type: ignore[no-untyped-call]
            self._window = None
