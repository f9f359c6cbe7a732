"""Top-down images: drawing agents and lines, and writing images and videos to files."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, MissingFeatureError, ShapeError
from ccdiff_env.traffic.python import AGENT_KINDS

if TYPE_CHECKING:
    from types import ModuleType

__all__ = ["DRIVERS", "KINDS", "LOOK", "THEMES", "draw", "legend", "save"]

Image: TypeAlias = npt.NDArray[np.uint8]

_NUMBERS = {name: number for name, _, number in _native.drivers()}
#: Who moves an agent; sets its colour. Further drivers look like one of these.
DRIVERS = tuple(name for i, (name, number) in enumerate(_NUMBERS.items()) if i == number)
KINDS = AGENT_KINDS  #: Kinds of agents; set their shape.
THEMES = ("light", "dark")  #: Grounds that images are drawn on; the replay page has the same.
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
    return colours | {name: colours[DRIVERS[number]] for name, number in _NUMBERS.items()}


def draw(
    position_m: npt.ArrayLike,
    *,
    scene: _native.Scene | None = None,
    heading_rad: npt.ArrayLike,
    size_m: npt.ArrayLike,
    driver: str | Sequence[str] = "replay",
    kind: str | Sequence[str] = "vehicle",
    collided: npt.ArrayLike | None = None,
    parked: npt.ArrayLike | None = None,
    arrived: npt.ArrayLike | None = None,
    size: tuple[int, int] = (640, 640),
    span_m: float = 100.0,
    centre_m: tuple[float, float] | None = None,
    up_rad: float = math.pi / 2,
    route_m: npt.ArrayLike = (),
    trails: Iterable[tuple[npt.ArrayLike, str]] = (),
    samples: Iterable[tuple[npt.ArrayLike, str]] = (),
    plans: Iterable[tuple[npt.ArrayLike, str]] = (),
    arrows: Iterable[tuple[int, int, float]] = (),
    collisions_m: npt.ArrayLike = (),
    names: Sequence[str] = (),
    caption: str = "",
    scale_bar: bool = False,
    legend: Iterable[tuple[str, str]] = (),
    theme: str = "light",
    svg: bool = False,
) -> Any:
    """Draw agents and lines on the map of a scene, or on bare ground.

    Args:
        position_m: Centres [A, 2], metres.
        scene: Scene whose map lies below; all coordinates are of its frame. Its agents are not
            drawn: :meth:`Scene.render` draws its log.
        heading_rad: Headings [A], radians counter-clockwise from +x.
        size_m: Lengths and widths [A, 2], metres, > 0.
        driver, kind: One of :data:`DRIVERS` and :data:`KINDS` for all agents, or one per agent.
        collided: Agents [A] to outline in red.
        parked, arrived: Agents [A] that are hollow, and to outline in green.
        size: Width and height of the image, pixels.
        span_m: Metres across the width.
        centre_m: Point in the middle; the first agent by default.
        up_rad: Direction that points to the top; π/2 (the default) puts +y there.
        route_m: Points [N, 2] of a broad band.
        trails, samples, plans: Lines ([N, 2] points, driver): where agents were (oldest first),
            where they may go (thin), and where they mean to go (thick). All fade.
        arrows: Edges (i, j, weight in 0..1) between agents: i influences j.
        collisions_m: Points [N, 2] to mark.
        names: What stands above each agent [A], in letters, figures and ``. , : - + = / _ ( )``;
            none by default. Images with less than 3.5 pixels a metre have none, people need 14.
        caption: Text in the upper left corner, likewise.
        scale_bar: Whether to draw a bar of a round number of metres.
        legend: Rows (driver or name in :func:`legend`, what it is called), in the lower right
            corner. Images that are too small for it have none.
        theme: One of :data:`THEMES`.
        svg: Return the text of an SVG instead.

    Returns:
        ndarray: Image [H, W, 3], uint8; or the SVG.

    Raises:
        ShapeError: If arrays do not fit together.
        ConfigError: If a name is unknown, a number is not finite or out of range.
    """
    position = _points("position_m", position_m)
    num_agents = len(position)
    heading = np.ascontiguousarray(heading_rad, dtype=np.float32)
    if heading.ndim != 1:
        raise ShapeError(f"heading_rad has shape {list(heading.shape)}, expected [A]")
    if centre_m is None:
        centre_m = (float(position[0, 0]), float(position[0, 1])) if num_agents else (0.0, 0.0)
    if len(names) not in (0, num_agents):
        raise ShapeError(f"names has {len(names)} entries, expected {num_agents}, one per agent")
    none = np.zeros(num_agents, bool)
    marks = [none if m is None else np.asarray(m, bool) for m in (collided, parked, arrived)]
    return _native.render_arrays(
        position,
        heading,
        _points("size_m", size_m),
        _numbers("kind", kind, KINDS, num_agents),
        _numbers("driver", driver, DRIVERS, num_agents),
        *marks,
        scene=scene,
        size=size,
        span_m=span_m,
        centre_m=centre_m,
        up_rad=up_rad,
        route_m=_points("route_m", route_m),
        trails=[(_points("trail", p), _number("driver", d, DRIVERS)) for p, d in trails],
        samples=[(_points("sample", p), _number("driver", d, DRIVERS)) for p, d in samples],
        plans=[(_points("plan", p), _number("driver", d, DRIVERS)) for p, d in plans],
        arrows=list(arrows),
        collisions_m=_points("collisions_m", collisions_m),
        names=[*names],
        caption=caption,
        scale_bar=scale_bar,
        legend=_legend_rows(list(legend), theme),
        theme=theme,
        svg=svg,
    )


def save(frames: npt.ArrayLike | Iterable[Image], path: str | Path, *, fps: float = 10.0) -> None:
    """Write an image or a video; the suffix of the file says which.

    Args:
        frames: One image [H, W, 3] or images [T, H, W, 3] (array or iterable) of one size, uint8.
        path: ``.png`` (one image), ``.gif`` or ``.mp4``. The folder must exist.
        fps: Images per second. GIF counts time in hundredths of a second.

    Raises:
        ShapeError: If there is no image, or not all of them are uint8 [H, W, 3] of one size.
        ConfigError: If the suffix is another one, a PNG gets several images, or ``fps`` is not
            positive.
        MissingFeatureError: If the package that writes the format is not installed.
    """
    path = Path(path)
    stack = _stack(frames)
    if not (math.isfinite(fps) and fps > 0.0):
        raise ConfigError(f"fps is {fps}, expected a positive number")
    suffix = path.suffix.lower()
    if suffix == ".png":
        if len(stack) != 1:
            raise ConfigError(
                f"{path.name}: a PNG holds one image, got {len(stack)}; use .gif or .mp4"
            )
        pillow().fromarray(stack[0]).save(path)
    elif suffix == ".gif":
        _save_gif(stack, path, fps)
    elif suffix == ".mp4":
        _save_mp4(stack, path, fps)
    else:
        raise ConfigError(f"{path.name}: suffix is {suffix!r}, expected .png, .gif or .mp4")


def _save_gif(stack: Image, path: Path, fps: float) -> None:
    library = pillow()
    # One palette for the whole video, taken from a few of its images: colours do not flicker.
    # A stripe of each colour of the legend keeps rare ones, as the red of collisions.
    few = stack[:: max(1, len(stack) // 8)]
    colours = [rgb for theme in THEMES for rgb in legend(theme).values()]
    stripes = np.repeat(np.array(colours, np.uint8), 8, axis=0)[:, None, :]
    images = [*few, np.repeat(stripes, stack.shape[2], axis=1)]
    palette = library.fromarray(np.concatenate(images)).quantize(128, method=0, dither=0)
    images = [library.fromarray(frame).quantize(palette=palette, dither=0) for frame in stack]
    images[0].save(
        path, save_all=True, append_images=images[1:], duration=max(20, round(1000.0 / fps)), loop=0
    )


def _save_mp4(stack: Image, path: Path, fps: float) -> None:
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
    imageio.mimwrite(path, list(stack), fps=fps, **how)


def pillow() -> ModuleType:
    """Return Pillow's module of images; without Pillow, a :class:`MissingFeatureError`."""
    try:
        from PIL import Image as library
    except ImportError as error:
        raise MissingFeatureError("writing images needs Pillow: pip install pillow") from error
    return library


def data_address(image: Image, colours: int) -> str:
    """Return the address of an image that is its own data, a PNG of so many colours."""
    buffer = io.BytesIO()
    pillow().fromarray(image).quantize(colours).save(buffer, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _stack(frames: npt.ArrayLike | Iterable[Image]) -> Image:
    """Images as one array [T, H, W, 3]."""
    try:
        array: Any = np.asarray(frames if isinstance(frames, np.ndarray) else list(frames))  # type: ignore[arg-type]
    except ValueError as error:
        raise ShapeError(f"frames have different shapes: {error}") from None
    array = array[None] if array.ndim == 3 else array
    if array.dtype != np.uint8 or array.ndim != 4 or array.shape[-1] != 3 or 0 in array.shape:
        raise ShapeError(
            f"frames are {array.dtype} {list(array.shape)}, "
            "expected uint8 [T, H, W, 3] without a zero"
        )
    return np.ascontiguousarray(array)


def _legend_rows(
    listed: Sequence[tuple[str, str]], theme: str
) -> list[tuple[tuple[int, int, int], str]]:
    colours = all_colours(theme)
    for name, _ in listed:
        if name not in colours:
            raise ConfigError(f"legend has {name!r}, expected one of {', '.join(colours)}")
    return [(colours[name], title) for name, title in listed]


def _points(what: str, value: npt.ArrayLike) -> npt.NDArray[np.float32]:
    array = np.ascontiguousarray(value, dtype=np.float32)
    if array.size == 0:
        return np.zeros((0, 2), np.float32)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ShapeError(f"{what} has shape {list(array.shape)}, expected [N, 2]")
    return array


def _number(what: str, name: str, names: tuple[str, ...]) -> int:
    if names is DRIVERS and name in _NUMBERS:
        return _NUMBERS[name]
    if name not in names:
        raise ConfigError(f"{what} is {name!r}, expected one of {', '.join(names)}")
    return names.index(name)


def _numbers(
    what: str, name: str | Sequence[str], names: tuple[str, ...], num_agents: int
) -> npt.NDArray[np.uint8]:
    listed = [name] * num_agents if isinstance(name, str) else name
    return np.array([_number(what, n, names) for n in listed], dtype=np.uint8)
