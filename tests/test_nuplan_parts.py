"""What planners of nuPlan need of a scene and of their files, without nuplan-devkit."""

import importlib
import itertools
import os
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from shapely import Point, Polygon

import ccdiff_env
from ccdiff_env.errors import ConfigError, DatasetError, DatasetNotFoundError, MissingFeatureError
from ccdiff_env.interop.nuplan import devkit
from ccdiff_env.interop.nuplan.roads import Centreline, RoadGraph, lanes_of_route, surface
from ccdiff_env.interop.nuplan.settings import Settings, made_of
from ccdiff_env.planners.built_in import ego_driver

pytest.importorskip("yaml", reason="PyYAML is not installed: pip install 'ccdiff-env[nuplan]'")


def lane(points, after=(), before=(), kind="lane", width=3.5):
    """A lane along a line, as scenes have them."""
    line = Centreline(points).shape.buffer(0.5 * width, cap_style="flat")
    ring = np.array(line.exterior.coords)[:-1]
    return {
        "kind": kind,
        "centreline": np.array(points, float),
        "polygon": {"exterior": ring, "holes": []},
        "successors": list(after),
        "predecessors": list(before),
        "speed_limit_mps": None,
    }


@pytest.fixture
def crossroads():
    """Two lanes to the east, one back; the right one goes on straight or to the left.

    0, 1: eastwards, the left and the right; 2: westwards; 3: straight on from 1; 4: to the left
    from 0; 5 and 6: where they lead.
    """
    return [
        lane([(0, 3.5), (40, 3.5)], after=[4]),
        lane([(0, 0), (40, 0)], after=[3]),
        lane([(40, 7), (0, 7)]),
        lane([(40, 0), (60, 0)], [5], [1], "connector"),
        lane([(40, 3.5), (50, 8), (55, 20)], [6], [0], "connector"),
        lane([(60, 0), (100, 0)], before=[3]),
        lane([(55, 20), (55, 60)], before=[4]),
    ]


def test_lanes_side_by_side_are_a_road_block_from_left_to_right(crossroads):
    graph = RoadGraph(crossroads)
    assert graph.blocks[graph.block_of[0]] == [0, 1]
    assert graph.blocks[graph.block_of[2]] == [2]  # the other direction
    assert graph.blocks[graph.block_of[5]] == [5]


def test_connectors_make_a_block_of_each_pair_of_road_blocks(crossroads):
    graph = RoadGraph(crossroads)
    east, straight, left = (graph.block_of[i] for i in (0, 3, 4))
    assert straight != left
    assert graph.neighbours(east, after=True) == [left, straight]
    assert graph.neighbours(straight, after=False) == [east]
    assert not graph.is_lane_block(left)


def test_a_lane_and_what_follows_it_are_never_one_block():
    long = lane([(0, 3.5), (60, 3.5)])
    halves = [lane([(0, 0), (30, 0)], after=[2]), lane([(30, 0), (60, 0)], before=[1])]
    graph = RoadGraph([long, *halves])
    assert graph.block_of[1] != graph.block_of[2]


def test_a_route_is_a_chain_of_blocks_and_goes_on_straight(crossroads):
    graph = RoadGraph(crossroads)
    short = graph.route_blocks([(5.0, 0.2), (30.0, -0.2)])
    assert short == [graph.block_of[i] for i in (1, 3, 5)]
    turn = graph.route_blocks([(5.0, 3.5), (40.0, 3.5), (50.0, 8.0), (55.0, 20.0), (55.0, 30.0)])
    assert turn == [graph.block_of[i] for i in (0, 4, 6)]


def test_a_route_beside_all_lanes_is_none_and_becomes_lanes_itself(crossroads):
    graph = RoadGraph(crossroads)
    assert graph.route_blocks([(0.0, -30.0), (80.0, -30.0)]) is None
    assert RoadGraph([]).route_blocks([(0.0, 0.0), (10.0, 0.0)]) is None
    route = [(0.0, -30.0), (80.0, -30.0)]
    pieces = lanes_of_route(route, len(crossroads))
    both = RoadGraph([*crossroads, *pieces])
    chain = both.block_of[len(crossroads) :]
    assert len(chain) == len(set(chain)) == 3
    assert [both.neighbours(a, after=True) for a in chain] == [[chain[1]], [chain[2]], []]
    assert sum(both.roads[i].line.length_m for i in (7, 8, 9)) == pytest.approx(80.0)


def test_a_route_over_a_lane_leaves_its_block_as_it_was(crossroads):
    pieces = lanes_of_route([(0.0, 2.0), (80.0, 2.0)], len(crossroads))
    both = RoadGraph([*crossroads, *pieces])
    assert both.blocks[both.block_of[0]] == [0, 1]
    assert all(len(both.blocks[both.block_of[i]]) == 1 for i in (7, 8, 9))


def test_sides_of_a_lane_are_where_its_surface_ends(crossroads):
    left, right = RoadGraph(crossroads).roads[0].sides
    assert left[:, 1] == pytest.approx(3.5 + 1.75)
    assert right[:, 1] == pytest.approx(3.5 - 1.75)


def test_intersections_are_where_connectors_of_several_origins_overlap(crossroads):
    assert RoadGraph(crossroads).intersections() == []  # both come from one road block
    across = lane([(50, -15), (50, 15)], kind="connector", before=[8])
    south = lane([(50, -40), (50, -15)], after=[7])
    (found,) = RoadGraph([*crossroads, across, south]).intersections()
    assert found.contains(Point(50, 0))


def test_places_on_a_line_against_numpy():
    points = np.array([(0, 0), (3, 4), (3, 10)], float)
    line = Centreline(points)
    assert line.length_m == 11.0
    assert line.pose(8.0) == pytest.approx((3.0, 7.0, np.pi / 2))
    assert line.project(5.0, 7.0) == pytest.approx(8.0)
    assert line.offset(5.0, 7.0) == pytest.approx((0.0, -2.0, np.pi / 2))
    assert line.offset(3.0, 12.0) == pytest.approx((2.0, 0.0, np.pi / 2))


def test_surfaces_that_cross_themselves_keep_their_largest_part():
    bow = {"exterior": [(0, 0), (4, 4), (4, 0), (0, 2)], "holes": []}
    found = surface(bow)
    assert isinstance(found, Polygon)
    assert found.is_valid
    assert found.area > 0
    assert surface({"exterior": [], "holes": []}).is_empty


@pytest.mark.parametrize("name", ["left-turn-04", "merge-in-03", "queue-03", "free-curve-03"])
def test_routes_of_the_embedded_town_follow_its_lanes(name):
    scene = ccdiff_env.embedded_scenes("val")[name]
    graph = RoadGraph(scene.map_layers()["lanes"])
    ego = scene.tracks()["position"][scene.agent_ids.index("ego")]
    blocks = graph.route_blocks(ego[scene.tracks()["valid"][0]])
    assert blocks is not None
    pairs = itertools.pairwise(blocks)
    assert all(b in graph.neighbours(a, after=True) for a, b in pairs)


# settings of planners


@dataclass
class Share:
    numerator: int
    denominator: int = 1


class Mine:
    """Made as nuPlan's planners are."""

    def __new__(cls, *args, **kwargs):
        return super().__new__(cls)

    def __init__(self, step, names, speed, path):
        self.given = step, names, speed, path


SETTINGS = """
my_planner:
  _target_: {target}
  _convert_: 'all'
  step: {{_target_: test_nuplan_parts.Share, numerator: 8, denominator: 5}}
  names: [1e-4, {{_target_: test_nuplan_parts.Share, numerator: 3}}]
  speed: ???
  path: ${{oc.env:HOME}}
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout with the settings of one planner, and another with its class."""
    folder = tmp_path / "mine" / "config" / "simulation" / "planner"
    folder.mkdir(parents=True)
    (folder / "my_planner.yaml").write_text(SETTINGS.format(target="test_nuplan_parts.Mine"))
    folders = [str(tmp_path), os.path.dirname(__file__)]
    monkeypatch.setenv(devkit.VARIABLE, os.pathsep.join(folders))
    return tmp_path


def made(name):
    settings = Settings.of(name)
    return made_of(settings.values, "mine", own=settings.owns)


def test_settings_are_found_by_name_by_class_and_by_file(checkout):
    file = next(checkout.rglob("*.yaml"))
    for name in ("my_planner", "test_nuplan_parts.Mine", str(file)):
        found = Settings.of(f"nuplan:{name}?speed=3")
        assert found.values["speed"] == 3
        assert found.file is not None
        assert found.file.name == "my_planner.yaml"
        assert found.module == "test_nuplan_parts"


def test_settings_make_objects_of_parts(checkout):
    assert made("nuplan:my_planner?speed=3&path=x&step.numerator=4").given == (
        Share(4, 5),
        [1e-4, Share(3)],
        3,
        "x",
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("path=x", r"speed is '\?\?\?', give it as \?speed=value"),
        ("speed=1", r"path is '\$\{oc.env:HOME\}', give it as \?path=value"),
        ("path=x&speed=1&step.parts=2", r"Share: .*'parts'; it takes numerator, denom"),
        ("path=x&speed=1&stop.numerator=2", r"no part 'stop' in its settings, there are step"),
        ("path=x&speed=1&sped=2", "Mine: .*'sped'; it takes step, names, speed, path, as"),
    ],
)
def test_settings_that_do_not_fit_name_the_value(checkout, options, says):
    with pytest.raises(ConfigError, match=says):
        made(f"nuplan:my_planner?{options}")


def test_a_class_without_settings_is_made_with_options(checkout):
    assert Settings.of("nuplan:datetime.date?year=1").values == {
        "_target_": "datetime.date",
        "year": 1,
    }
    with pytest.raises(ConfigError, match="it takes numerator, denominator"):
        made("nuplan:fractions.Fraction?part=1")


@pytest.mark.parametrize("text", ["%s", "test_nuplan_parts.Share, numerator: {_target_: %s}"])
@pytest.mark.parametrize(
    "target", ["os.system", "numpy.load", "torch.load", "test_nuplan_parts.Polygon", "system", "."]
)
def test_files_of_settings_name_no_foreign_code(checkout, text, target):
    # a file's name is none of a package
    (checkout / "os.yaml").write_text(f"p: {{_target_: {text % target}, command: exit}}")
    with pytest.raises(ConfigError, match=r"_target_ is .*, expected a class of nuplan or torch"):
        made(f"nuplan:{checkout}/os.yaml")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("your_planner", "no settings 'your_planner' in the checkouts, there are my_planner"),
        ("nothing.of.Mine", "no module 'nothing'"),
        ("datetime.dates", "no 'dates' in module 'datetime'"),
    ],
)
def test_names_that_are_not_there_are_refused(checkout, name, says):
    with pytest.raises(ConfigError, match=says):
        made(f"nuplan:{name}")


@pytest.mark.parametrize("text", ["[1, 2]", "a: {b: 1}", "a: [", ""])
def test_damaged_settings_name_their_file(tmp_path, text):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(DatasetError, match=r"bad\.yaml"):
        Settings.of(f"nuplan:{tmp_path}/bad.yaml")


# the devkit


def test_without_the_devkit_a_planner_of_it_says_what_to_do(monkeypatch):
    monkeypatch.delenv(devkit.VARIABLE, raising=False)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if "nuplan" not in p])
    for name in [name for name in sys.modules if name.partition(".")[0] == "nuplan"]:
        monkeypatch.delitem(sys.modules, name)
    if importlib.util.find_spec("nuplan") is not None:
        pytest.skip("nuplan-devkit is installed")
    with pytest.raises(MissingFeatureError, match="CCDIFF_NUPLAN"):
        ego_driver("nuplan:idm_planner")


def test_a_checkout_that_is_not_there_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv(devkit.VARIABLE, str(tmp_path / "none"))
    with pytest.raises(DatasetNotFoundError, match="none, which is no folder"):
        ego_driver("nuplan:idm_planner")


def test_packages_that_are_missing_can_be_imported_and_not_used(monkeypatch):
    finder = devkit._Finder(frozenset({"cloudy", "retry"}))
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, finder])
    for name in ("cloudy", "cloudy.sky", "retry"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    cloudy, retry = (importlib.import_module(name) for name in ("cloudy", "retry"))
    sky = importlib.import_module("cloudy.sky")
    assert not isinstance(1, cloudy.Frame)
    assert sky.frames.Frame.__name__ == "Frame"
    with pytest.raises(
        MissingFeatureError, match=r"calls cloudy\.sky\.Session: pip install cloudy"
    ):
        sky.Session("s3")
    assert retry.retry(ValueError, tries=3)(len)([1]) == 1  # decorates while modules are imported
    for name in ("cloudy", "cloudy.sky", "retry"):
        sys.modules.pop(name, None)
