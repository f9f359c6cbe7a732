"""Colours of images, and files of images and videos."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import MissingFeatureError
from ccdiff_env.system.files import writing

if TYPE_CHECKING:
    from types import ModuleType

Image: TypeAlias = npt.NDArray[np.uint8]

NUMBERS = {name: number for name, _, number in _native.drivers()}  #: Of drivers.
#: Who moves an agent; sets its colour. Further drivers look like one of these.
DRIVERS = tuple(name for i, (name, number) in enumerate(NUMBERS.items()) if i == number)
THEMES = ("light", "dark")  #: Grounds that images are drawn on; the replay page has the same.
NEAR = 8  #: Colours that differ no more than this in each channel are one in small palettes.
#: Times, lengths and strengths that images and the replay page share, by name.
LOOK = dict(_native.render_look())


def legend(theme: str = "light") -> dict[str, tuple[int, int, int]]:
    """Return names and colours (red, green, blue) of everything in an image, drivers first.

    Raises:
        ConfigError: If the theme is not one of :data:`THEMES`.
    """
    return dict(_native.render_legend(theme))


def all_colours(theme: str = "light") -> dict[str, tuple[int, int, int]]:
    """Return :func:`legend`, with further drivers by name."""
    colours = legend(theme)
    return colours | {name: colours[DRIVERS[number]] for name, number in NUMBERS.items()}


def save_gif(stack: Image, path: Path, fps: float) -> None:
    """Write images [T, H, W, 3], ``fps`` a second; GIF counts time in hundredths of a second."""
    library = pillow()
    # One palette for the whole video, taken from a few of its images: colours do not flicker.
    few = library.fromarray(np.concatenate(stack[:: max(1, len(stack) // 8)]))
    palette = _palette(few, 128)
    images = [library.fromarray(frame).quantize(palette=palette, dither=0) for frame in stack]
    options = {"duration": max(20, round(1000.0 / fps)), "loop": 0}
    with writing(path):
        images[0].save(path, save_all=True, append_images=images[1:], **options)


def save_mp4(stack: Image, path: Path, fps: float) -> None:
    """Write images [T, H, W, 3], ``fps`` a second.

    Without imageio and ffmpeg a :class:`MissingFeatureError`.
    """
    try:
        import imageio.v2 as imageio
        import imageio_ffmpeg  # noqa: F401
    except ImportError as error:
        raise MissingFeatureError(
            "writing .mp4 needs imageio with ffmpeg: pip install 'imageio[ffmpeg]'"
        ) from error
    # The codec halves the colour planes: both sides must be even.
    _, height, width, _ = stack.shape
    stack = np.pad(stack, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    how: Any = {"codec": "libx264", "quality": 8, "pixelformat": "yuv420p", "macro_block_size": 1}
    with writing(path):
        imageio.mimwrite(path, list(stack), fps=fps, **how)


def pillow() -> ModuleType:
    """Return Pillow's module of images; without Pillow, a :class:`MissingFeatureError`."""
    try:
        from PIL import Image as library
    except ImportError as error:
        raise MissingFeatureError("writing images needs Pillow: pip install pillow") from error
    return library


def _palette(image: Any, colours: int) -> Any:
    """Return a palette of so many colours for an image: those of the legend, as they are, which
    rare things have, and those that it has most of.
    """
    kept = np.unique([[*rgb] for theme in THEMES for rgb in legend(theme).values()], axis=0)
    most = image.quantize(colours - len(kept), method=0, dither=0).getpalette()
    others = np.reshape(most, (-1, 3))
    far = np.abs(others[:, None] - kept).max(axis=-1).min(axis=-1) > NEAR
    palette = pillow().new("P", (1, 1))
    palette.putpalette(np.concatenate([kept, others[far]]).ravel().tolist())
    return palette


def data_address(image: Image) -> str:
    """Return the address of an image that is its own data, a PNG of 256 colours."""
    buffer, drawn = io.BytesIO(), pillow().fromarray(image)
    drawn = drawn.quantize(palette=_palette(drawn, 256), dither=0)
    drawn.save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
