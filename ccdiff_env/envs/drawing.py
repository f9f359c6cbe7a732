"""How environments draw: options of images, and the window of ``render_mode="human"``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ccdiff_env.config import WorldConfig
from ccdiff_env.errors import ConfigError, MissingFeatureError, unknown
from ccdiff_env.scenes import Scene
from ccdiff_env.worlds import StepArrays, Worlds
from ccdiff_env.worlds.spaces import Form
from ccdiff_env.worlds.step_arrays import F32

Image = npt.NDArray[np.uint8]

FPS = 10  #: Images per second of simulated time.

#: Options of an image: width and height in pixels, metres across, agent id or (x, y) in the middle
#: (the ego by default), whether its heading points up, what is drawn, and on which ground.
RENDER_OPTIONS: dict[str, Any] = {
    "size": (640, 640),
    "span_m": 90.0,
    "centre": None,
    "heading_up": False,
    "trails": True,
    "route": True,
    "labels": True,
    "theme": "light",
}


def checked_render_options(given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the options of images with defaults filled in.

    Raises:
        ConfigError: If a name is unknown.
    """
    for name in given or {}:
        if name not in RENDER_OPTIONS:
            raise unknown("render option", str(name), RENDER_OPTIONS)
    return {**RENDER_OPTIONS, **(given or {})}


#: What single environments offer: a window only where pygame can open one.
RENDER_MODES = [*(["human"] if find_spec("pygame") else []), "rgb_array"]


def check_render_mode(mode: str | None, known: tuple[str, ...]) -> None:
    """Refuse a render mode that does not exist."""
    if mode is not None and mode not in known:
        raise ConfigError(f"render_mode is {mode!r}, expected None or one of {', '.join(known)}")


class Window:
    """A window that shows images at their pace; needs pygame."""

    def __init__(self, title: str) -> None:
        try:
            import pygame
        except ImportError as error:
            raise MissingFeatureError(
                'render_mode="human" needs pygame: pip install pygame'
            ) from error
        self._pygame = pygame
        self._title = title
        self._screen: Any = None
        self._clock: Any = None

    def show(self, image: Image) -> None:
        """Show an image [H, W, 3] and wait until its time is over."""
        pygame = self._pygame
        size = (image.shape[1], image.shape[0])
        if self._screen is None:
            pygame.display.init()
            pygame.display.set_caption(self._title)
            self._screen = pygame.display.set_mode(size)
            self._clock = pygame.time.Clock()
        surface = pygame.surfarray.make_surface(np.swapaxes(image, 0, 1))
        self._screen.blit(surface, (0, 0))
        pygame.event.pump()
        self._clock.tick(FPS)
        pygame.display.flip()

    def close(self) -> None:
        """Close the window."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None


class DrawnWorld:
    """What every environment of one world has: its scene, and images of it."""

    worlds: Worlds
    render_mode: str | None
    _render_options: dict[str, Any]
    _form: Form
    _info: str
    _window: Window | None = None
    _title = "ccdiff_env"  #: Title of the window.

    @property
    def config(self) -> WorldConfig:
        """Configuration of the world."""
        return self.worlds.config

    @property
    def scene(self) -> Scene:
        """Scene of the present episode."""
        return self.worlds.scenes[self.worlds.native.status(0).scene_idx]

    def _observation(self, obs: F32, bev: Image | None, slot: int = 0) -> Any:
        """Observation of a slot, from arrays [1, C, ...], in the chosen form."""
        raster = None if bev is None else bev[0, slot]
        return self.worlds.layout.observation(self._form, obs[0, slot], raster)

    def _step_info(self, out: StepArrays, ended: bool, slot: int = 0) -> dict[str, Any]:
        """Info columns of a slot's step, and at the end of its episode metrics."""
        info: dict[str, Any] = {}
        if self._info == "full" or (self._info == "end" and ended):
            columns = out.columns[0, slot].tolist()
            info.update(zip(self.worlds.column_names, columns, strict=True))
        if ended and self._info != "none":
            metrics = self.worlds.native.metrics(0)[slot].tolist()
            info["metrics"] = dict(zip(self.worlds.metric_names, metrics, strict=True))
        return info

    def render(self) -> Image | None:
        """Return an image [H, W, 3], show it, or do nothing, as the render mode says."""
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() was called without a render mode: make the environment with "
                'render_mode="rgb_array" or "human".'
            )
            return None
        image: Image = self.worlds.native.render(0, **self._render_options)
        if self.render_mode == "rgb_array":
            return image
        if self._window is None:
            self._window = Window(self._title)
        self._window.show(image)
        return None

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()
            self._window = None
