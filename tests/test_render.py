"""Images of scenes and files of images: pixels and arrays."""

import math
import sys

import numpy as np
import pytest
from array_scenes import agent, array_scene
from PIL import Image

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, MissingFeatureError, UnknownNameError
from ccdiff_env.view import render

COLOURS = {name: np.array(rgb) for name, rgb in render.legend().items()}
PLAIN = {"trails": False, "route": False, "labels": False}


def ring(half: float) -> np.ndarray:
    return np.array([[-half, -half], [half, -half], [half, half], [-half, half]], np.float32)


@pytest.fixture(scope="module")
def scene() -> _native.Scene:
    """Ego eastwards at 10 m/s on a square with a hole; a walker that is there from step 10 on."""
    walks = {"kind": "pedestrian", "size": (0.8, 0.8, 1.8), "valid": np.arange(20) >= 10}
    agents = agent("ego", np.arange(20.0), size=(4.6, 1.9, 1.5)), agent("walker", 5.0, 8.0, **walks)
    layers = {"drivable_area": [{"exterior": ring(40), "holes": [ring(3) + 20]}]}
    return array_scene(*agents, name="square", layers=layers)


@pytest.fixture
def frames(scene) -> np.ndarray:
    """Six images [6, 81, 121, 3] of an ego that drives through them."""
    steps = range(0, 12, 2)
    return np.stack([scene.render(t, size=(121, 81), centre=(5.0, 0.0), span_m=40) for t in steps])


def test_everything_has_a_colour_of_its_own():
    colours = {k: v for k, v in render.legend().items() if k != "outline"}  # as dark as the ink
    assert len(set(colours.values())) == len(colours)


def test_a_gif_holds_all_images_at_their_rate_with_the_ego_in_its_colour(frames, tmp_path):
    render.save_gif(frames, tmp_path / "a.gif", 20.0)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == len(frames)
        for t in range(gif.n_frames):
            gif.seek(t)
            assert gif.info["duration"] == 50
            got = np.asarray(gif.convert("RGB")).astype(int)
            assert np.abs(got - frames[t]).max() < 48
            assert np.abs(got - frames[t]).mean() < 4.0


def test_an_mp4_of_odd_size_holds_all_images(frames, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    import imageio.v2 as imageio

    render.save_mp4(frames, tmp_path / "a.mp4", 10.0)
    # The reader claims endless length: no list(reader).
    with imageio.get_reader(tmp_path / "a.mp4") as reader:
        read = np.stack([frame for frame in reader])  # noqa: C416
    assert read.shape == (len(frames), 82, 122, 3)
    assert np.abs(read[:, :81, :121].astype(int) - frames).mean() < 4.0


def test_an_mp4_without_its_package_names_the_install_command(frames, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingFeatureError, match=r"imageio\[ffmpeg\]"):
        render.save_mp4(frames, tmp_path / "a.mp4", 10.0)


def test_the_middle_can_be_an_agent_a_point_or_wait_for_an_agent(scene):
    of_id = scene.render(12, centre="walker", size=(200, 200), span_m=40, **PLAIN)
    assert tuple(of_id[100, 100]) == tuple(COLOURS["replay"])
    of_point = scene.render(12, centre=(5.0, 8.0), size=(200, 200), span_m=40, **PLAIN)
    assert np.array_equal(of_id, of_point)
    before = scene.render(2, centre="walker", size=(200, 200), span_m=40, **PLAIN)
    assert tuple(before[100, 100]) == tuple(COLOURS["drivable area"])


def test_every_option_changes_the_image_and_the_same_call_repeats_it(scene):
    plain = scene.render(8, **PLAIN)
    assert np.array_equal(plain, scene.render(8, **PLAIN))
    for name in PLAIN:
        assert not np.array_equal(plain, scene.render(8, **{**PLAIN, name: True})), name


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"step": 20}, ConfigError, "step 20"),
        ({"step": -1}, ConfigError, "step is -1"),
        ({"centre": "nobody"}, UnknownNameError, "nobody"),
        ({"centre": (math.nan, 0.0)}, ConfigError, "centre"),
        ({"centre": (0.0, 0.0), "heading_up": True}, ConfigError, "heading up"),
        ({"span_m": 0.0}, ConfigError, "metres_per_pixel"),
        ({"size": (0, 100)}, ConfigError, "0 x 100"),
        ({"size": (100, -5)}, ConfigError, "100 x -5"),
        ({"size": (100, 100000)}, ConfigError, "8192"),
    ],
)
def test_what_cannot_be_drawn_is_refused_and_named_in_a_scene(scene, options, error, says):
    with pytest.raises(error, match=says):
        scene.render(**options)
