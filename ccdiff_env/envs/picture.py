"""How environments draw: options of pictures, and the window of ``render_mode="human"``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ccdiff_env.config import unknown
from ccdiff_env.errors import ConfigError, MissingFeatureError

Image = npt.NDArray[np.uint8]

#: Pictures per second of simulated time.
FPS = 10

#: Options of a picture: width and height in pixels, metres across, agent id or (x, y) in the middle
#: (the ego by default), whether its heading points up, and what is drawn.
PICTURE: dict[str, Any] = {
    "size": (640, 640),
    "span_m": 90.0,
    "centre": None,
    "heading_up": False,
    "trails": True,
    "route": True,
    "labels": True,
}


def picture_options(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the options of pictures with defaults filled in.

    Raises
    ------
    ConfigError
        If a name is unknown.
    """
    for name in options or {}:
        if name not in PICTURE:
            raise unknown("picture option", str(name), PICTURE)
    return {**PICTURE, **(options or {})}


def check_render_mode(mode: str | None, known: tuple[str, ...]) -> None:
    """Refuse a render mode that does not exist."""
    if mode is not None and mode not in known:
        raise ConfigError(f"render_mode is {mode!r}, expected None or one of {', '.join(known)}")


class Window:
    """A window that shows pictures at their pace; needs pygame."""

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
        """Show a picture [H, W, 3] and wait until its time is over."""
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
