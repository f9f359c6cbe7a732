"""``Scene.render``: pixels against shapely and against the arrays that the scene gives out."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from array_scenes import agent, array_scene

from ccdiff_env import _native
from ccdiff_env.errors import ConfigError, UnknownNameError
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


def test_the_ego_is_in_the_middle_on_the_road_and_holes_show_the_ground(scene):
    image = scene.render(0, size=(300, 200), **PLAIN)
    assert image.shape == (200, 300, 3)
    assert image.dtype == np.uint8
    assert tuple(image[100, 150]) == tuple(COLOURS["ego"])
    # three pixels a metre: 10 m south of the middle, and the middle of the hole
    assert tuple(image[130, 150]) == tuple(COLOURS["drivable area"])
    assert tuple(image[100 - 60 + 15, 150 + 60]) == tuple(COLOURS["drivable area"])
    assert tuple(image[100 - 60, 150 + 60]) == tuple(COLOURS["ground"])


def test_the_middle_can_be_an_agent_a_point_or_wait_for_an_agent(scene):
    of_id = scene.render(12, centre="walker", size=(200, 200), span_m=40, **PLAIN)
    assert tuple(of_id[100, 100]) == tuple(COLOURS["replay"])
    of_point = scene.render(12, centre=(5.0, 8.0), size=(200, 200), span_m=40, **PLAIN)
    assert np.array_equal(of_id, of_point)
    before = scene.render(2, centre="walker", size=(200, 200), span_m=40, **PLAIN)
    assert tuple(before[100, 100]) == tuple(COLOURS["drivable area"])


def test_heading_up_is_north_up_turned_by_a_quarter_for_an_ego_that_heads_east(scene):
    turned = scene.render(12, size=(200, 200), heading_up=True, **PLAIN)
    north_up = scene.render(12, size=(200, 200), **PLAIN)
    difference = np.abs(np.rot90(north_up).astype(int) - turned)
    assert (difference.max(axis=2) > 40).mean() < 0.005


def test_every_option_changes_the_image_and_the_same_call_repeats_it(scene):
    plain = scene.render(8, **PLAIN)
    assert np.array_equal(plain, scene.render(8, **PLAIN))
    for name in PLAIN:
        assert not np.array_equal(plain, scene.render(8, **{**PLAIN, name: True})), name


def test_drawing_the_logged_agents_over_the_map_is_the_image_of_the_log(scene):
    tracks = scene.tracks()
    drawn = render.draw(
        tracks["position"][:, 12],
        scene=scene,
        heading_rad=tracks["heading"][:, 12],
        size_m=scene.sizes[:, :2],
        driver=["ego", "replay"],
        kind=scene.agent_types,
    )
    assert np.array_equal(drawn, scene.render(12, **PLAIN))


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
def test_what_cannot_be_drawn_is_refused_and_named(scene, options, error, says):
    with pytest.raises(error, match=says):
        scene.render(**options)


@pytest.mark.nuscenes
def test_drivable_area_of_a_real_scene_is_where_shapely_says(data_root):
    scenes, _ = _native.load_nuscenes(
        str(data_root / "nuscenes"),
        "v1.0-mini",
        names=["scene-0103"],
        exactly=True,
        dt=0.5,
        timing="recorded",
        interpolation="linear",
        ego_reference="rear_axle",
        kinds=["vehicle"],
        categories=["vehicle.ego"],
        map_margin=100.0,
        min_annotations=1,
        require_map=True,
        cache_directory=None,
    )
    scene, side, span_m = scenes[0], 400, 120.0
    layers = scene.map_layers()
    polygons = [shapely.Polygon(p["exterior"], p["holes"]) for p in layers["drivable_area"]]
    drivable = shapely.union_all(polygons)
    walkways = shapely.union_all([shapely.Polygon(p["exterior"]) for p in layers["walkways"]])
    crossings = [shapely.Polygon(p["exterior"]) for p in layers["ped_crossings"]]
    lines = [layer for name in ("road_dividers", "lane_dividers") for layer in layers[name]]
    lines += [lane["centreline"] for lane in layers["lanes"]]
    lines = shapely.union_all([shapely.LineString(line) for line in lines])
    step = 10
    tracks = scene.tracks()
    image = scene.render(step, size=(side, side), span_m=span_m, **PLAIN)
    centre = tracks["position"][0, step]
    rows, columns = np.mgrid[2:side:5, 2:side:5].reshape(2, -1)
    x = centre[0] + (columns + 0.5 - side / 2) * span_m / side
    y = centre[1] - (rows + 0.5 - side / 2) * span_m / side
    points = shapely.points(x, y)
    # only pixels that one layer alone decides
    clear = shapely.distance(drivable.boundary, points) > 1.0
    clear &= shapely.distance(lines, points) > 0.8
    clear &= shapely.distance(shapely.union_all([walkways, *crossings]), points) > 0.8
    shown = tracks["valid"][:, step]
    for where, size in zip(tracks["position"][shown, step], scene.sizes[shown], strict=True):
        clear &= np.hypot(x - where[0], y - where[1]) > 0.5 * math.hypot(size[0], size[1]) + 1.0
    inside = shapely.contains(drivable, points)
    assert (clear & inside).sum() > 300
    assert (clear & ~inside).sum() > 300
    seen = image[rows, columns]
    assert (seen[clear & inside] == COLOURS["drivable area"]).all()
    assert (seen[clear & ~inside] == COLOURS["ground"]).all()
