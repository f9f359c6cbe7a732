"""The bird's-eye raster as an observation."""

import numpy as np
import pytest
import shapely
from gymnasium import spaces

import ccdiff_env
from ccdiff_env import EgoEnv
from ccdiff_env.config import BevConfig, ObservationConfig, WorldConfig
from ccdiff_env.errors import ConfigError

SMALL = {"size_px": 48, "metres_per_px": 0.75}
DRIVABLE = 0  #: Channel of the raster.


def test_forms_and_spaces(scenes):
    alone = EgoEnv(scenes=scenes, observation="bev")
    assert alone.observation_space == spaces.Box(0, 255, (5, 84, 84), np.uint8)
    both = EgoEnv(scenes=scenes, observation="dict", bev=SMALL)
    assert both.observation_space["bev"].shape == (5, 48, 48)
    assert both.worlds.layout.channels == ("drivable", "lines", "route", "agents", "ego")
    obs, _ = both.reset(seed=0)
    assert obs in both.observation_space
    assert np.array_equal(obs["bev"], both.observation()["bev"])
    config = WorldConfig(observation=ObservationConfig(bev=BevConfig(size_px=48)))
    assert EgoEnv(config=config, observation="bev").observation_space.shape == (5, 48, 48)
    assert "bev" not in EgoEnv(scenes=scenes, observation="dict").observation_space.spaces
    for unseen in (EgoEnv, ccdiff_env.parallel_env):
        with pytest.raises(ConfigError, match="rasters are shown by"):
            unseen(scenes=scenes, bev={})
    with pytest.raises(ConfigError, match="size_px"):
        EgoEnv(scenes=scenes, observation="bev", bev={"size_px": 3})
    with pytest.raises(ConfigError, match="size"):
        EgoEnv(scenes=scenes, observation="bev", bev={"size": 64})


@pytest.mark.parametrize("name", ["left-turn-04", "hard-brake-03", "merge-in-03"])
def test_drivable_pixels_are_those_whose_centres_shapely_finds_on_the_road(name, scenes):
    env = EgoEnv(scenes=scenes, observation="bev", bev={"size_px": 100, "metres_per_px": 0.4})
    env.reset(seed=0, options={"scene": name})
    layers = env.scene.map_layers()["drivable_area"]
    # holes that the crop has cut open share edges with their shell: rings one by one
    area = [
        [shapely.make_valid(shapely.Polygon(r)) for r in (p["exterior"], *p["holes"])]
        for p in layers
    ]
    road = shapely.union_all([shell - shapely.union_all(holes) for shell, *holes in area])
    shapely.prepare(road)
    edge = road.boundary
    rows, columns = np.mgrid[:100, :100]
    ahead, left = (75 - rows - 0.5) * 0.4, (50 - columns - 0.5) * 0.4
    for _ in range(12):
        obs = env.step(env.expert_action())[0]
        states = env.worlds.native.states(0)
        ego = env.scene.agent_ids.index("ego")
        (x, y), heading = states["position"][ego].astype(float), float(states["heading"][ego])
        points = shapely.points(
            x + ahead * np.cos(heading) - left * np.sin(heading),
            y + ahead * np.sin(heading) + left * np.cos(heading),
        )
        on_road = shapely.contains(road, points)
        # the ground has pixels half as wide: no centre is farther off than half their diagonal
        sure = shapely.distance(edge, points) > 0.1 * np.sqrt(2.0) + 0.01
        assert sure.mean() > 0.9
        assert 0.1 < on_road.mean() < 0.99
        assert np.array_equal(obs[DRIVABLE][sure] == 255, on_road[sure])
