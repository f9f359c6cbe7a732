"""Images of logs and worlds, and files of images: pixels and arrays."""

import math
import sys

import numpy as np
import pytest
from array_scenes import agent, array_scene, begun
from PIL import Image

from ccdiff_env import EgoEnv, _native
from ccdiff_env.errors import ConfigError, MissingFeatureError, UnknownNameError
from ccdiff_env.view import render
from ccdiff_env.view.sources import log_rollout
from ccdiff_env.view.video import Video

COLOURS = {name: np.array(rgb) for name, rgb in render.legend().items()}
PLAIN = {"route": False, "labels": False}


def drawn(scene: _native.Scene, step: int, **options) -> np.ndarray:
    """A step of the log, without captions."""
    return Video(log_rollout(scene), captions=False, **options).frame(step)


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
    return np.stack([drawn(scene, t, size=(121, 81), centre_m=(5.0, 0.0)) for t in range(0, 12, 2)])


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


def world(scene, **options) -> EgoEnv:
    """The scene as a world of its log, twelve steps on."""
    options = {"size": (200, 200), "span_m": 40.0, **PLAIN, **options}
    quiet = {"history_steps": 12, "horizon_steps": 5}
    env = begun(
        scenes=[scene], traffic="replay", render_mode="rgb_array", render_options=options, **quiet
    )
    return env


def test_the_middle_of_a_world_is_an_agent_or_a_point(scene):
    of_id = world(scene, centre="walker").render()
    assert tuple(of_id[100, 100]) == tuple(COLOURS["replay"])
    assert np.array_equal(of_id, world(scene, centre=(5.0, 8.0)).render())
    assert tuple(world(scene).render()[100, 100]) == tuple(COLOURS["ego"])


def test_every_option_changes_the_image_and_the_same_call_repeats_it(scene):
    plain = world(scene).render()
    assert np.array_equal(plain, world(scene, size=[200, 200], span_m=np.float64(40)).render())
    for name in PLAIN:
        assert not np.array_equal(plain, world(scene, **{name: True}).render()), name


@pytest.mark.parametrize("stands_m", [14.0, None], ids=["somebody in its way", "a free road"])
def test_the_caption_has_time_speed_and_the_end(monkeypatch, stands_m):
    said, draw = [], _native.render_arrays
    monkeypatch.setattr(
        _native, "render_arrays", lambda *of, **by: said.append(by["caption"]) or draw(*of, **by)
    )
    others = [] if stands_m is None else [agent("other", stands_m)]
    lone = array_scene(agent("ego", np.arange(20.0)), *others, name="line")  # 10 m/s along x
    env = begun(scenes=[lone], traffic="replay", render_mode="rgb_array", history_steps=1)
    ended = False
    while not ended:
        _, _, ended, _, _ = env.step(np.zeros(2, np.float32))
        env.render()
    *on_its_way, last = said
    assert on_its_way == [f"line  {0.1 * (i + 1):.1f} s  10.0 m/s" for i in range(len(said) - 1)]
    at_m = 1.0 + len(said)  # it began at x = 1 m
    if stands_m is None:
        assert at_m - 1.0 < 19.0 - 18.0 / 4 <= at_m  # the last quarter of its way of 18 m
        assert last == f"line  {0.1 * len(said):.1f} s  reached its goal"
    else:
        assert at_m - 1.0 < stands_m - 4.5 < at_m  # cars are 4.5 m long
        assert last == f"line  {0.1 * len(said):.1f} s  10.0 m/s  collided with 1"


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"centre": "nobody"}, UnknownNameError, "nobody"),
        ({"centre": (math.nan, 0.0)}, ConfigError, "centre"),
        ({"span_m": 0.0}, ConfigError, "metres_per_pixel"),
        ({"size": (0, 100)}, ConfigError, "0 x 100"),
        ({"size": (100, -5)}, ConfigError, "100 x -5"),
        ({"size": (100, 100000)}, ConfigError, "8192"),
        ({"theme": "grey"}, ConfigError, "theme"),
        ({"theme": 5}, ConfigError, "theme"),
        ({"size": 64}, ConfigError, "render option size is 64, expected whole numbers of pixels"),
        ({"size": (64, 64, 3)}, ConfigError, "render option size"),
        ({"size": (64.5, 64)}, ConfigError, "render option size"),
        ({"span_m": "wide"}, ConfigError, "span_m is 'wide', expected a number of metres"),
        ({"centre": 3.0}, ConfigError, "centre is 3.0, expected an agent id, or x and y"),
        ({"labels": "no"}, ConfigError, "labels is 'no', expected True or False"),
    ],
)
def test_what_cannot_be_drawn_is_refused_and_named(scene, options, error, says):
    with pytest.raises(error, match=says):
        world(scene, **options).render()
