"""Where the roads of the embedded city lie."""

from __future__ import annotations

from tools.embedded_city.city import City, Junction, Road
from tools.embedded_city.curves import Xy, filleted

LOCATION = "ccdiff-town"
CANVAS_M = (1000.0, 740.0)


def _road(
    name: str,
    ends: tuple[str, str],
    points: list[Xy],
    radii: list[float],
    *,
    lanes: tuple[int, int] = (1, 1),
    parking: tuple[bool, bool] = (False, False),
) -> Road:
    """Return a road through ``points``; with lanes along and against it, parking right and left."""
    return Road(name, *ends, filleted(points, radii), *lanes, *parking)


def build_city() -> City:
    """Return the city: an avenue from west to east, one from the middle to the north, and a ring
    of streets.
    """
    at: dict[str, Xy] = {
        "border-west": (15, 300), "merge-west": (130, 300), "west": (270, 300),
        "tee-west": (385, 300), "centre": (500, 300), "tee-east": (615, 310), "east": (730, 320),
        "merge-east": (870, 320), "border-east": (985, 320), "north": (490, 520),
        "merge-north": (490, 620), "border-north": (490, 725), "south": (510, 100),
        "tee-north": (385, 520), "tee-south": (615, 100),
    }  # fmt: skip
    junctions = [
        Junction("west", at["west"], crossings=True),
        Junction("centre", at["centre"], signals=True, crossings=True),
        Junction("east", at["east"], signals=True, crossings=True),
        Junction("north", at["north"], crossings=True),
        Junction("south", at["south"], crossings=True),
        Junction("tee-west", at["tee-west"], double_left=frozenset({"stem-west"})),
        Junction("tee-east", at["tee-east"], double_left=frozenset({"stem-east"})),
        Junction("tee-north", at["tee-north"]),
        Junction("tee-south", at["tee-south"], crossings=True),
        *(
            Junction(f"merge-{side}", at[f"merge-{side}"], reach_m=24.0)
            for side in ("west", "east", "north")
        ),
        *(Junction(f"border-{side}", at[f"border-{side}"]) for side in ("west", "east", "north")),
    ]

    def avenue(name: str, start: str, end: str, lanes: tuple[int, int] = (2, 2)) -> Road:
        return _road(name, (start, end), [at[start], at[end]], [], lanes=lanes)

    both = (True, True)
    roads = [
        avenue("entry-west", "border-west", "merge-west", (1, 1)),
        avenue("avenue-1", "merge-west", "west"),
        avenue("avenue-2", "west", "tee-west"),
        avenue("avenue-3", "tee-west", "centre"),
        avenue("avenue-4", "centre", "tee-east"),
        avenue("avenue-5", "tee-east", "east"),
        avenue("avenue-6", "east", "merge-east"),
        avenue("exit-east", "merge-east", "border-east", (1, 1)),
        avenue("parade-south", "south", "centre"),
        avenue("parade-north", "centre", "north"),
        avenue("parade-top", "north", "merge-north"),
        avenue("exit-north", "merge-north", "border-north", (1, 1)),
        _road("ring-southwest", ("west", "south"),
              [at["west"], (270, 190), (330, 120), (400, 100), at["south"]], [45, 40, 60],
              parking=both),
        _road("ring-south", ("south", "tee-south"), [at["south"], at["tee-south"]], []),
        _road("ring-southeast", ("tee-south", "east"),
              [at["tee-south"], (715, 100), (785, 160), (770, 235), at["east"]], [38, 30, 60],
              parking=(True, False)),
        _road("ring-northeast", ("east", "north"),
              [at["east"], (730, 440), (640, 470), (600, 520), at["north"]], [40, 50, 40]),
        _road("ring-north", ("north", "tee-north"), [at["north"], at["tee-north"]], []),
        _road("ring-northwest", ("tee-north", "west"),
              [at["tee-north"], (300, 520), (240, 460), (270, 400), at["west"]], [40, 40, 60],
              parking=both),
        _road("stem-west", ("tee-north", "tee-west"),
              [at["tee-north"], (385, 450), (370, 410), (385, 370), at["tee-west"]], [60, 40, 60],
              lanes=(2, 1)),
        _road("stem-east", ("tee-south", "tee-east"),
              [at["tee-south"], (615, 165), (632, 205), (615, 245), at["tee-east"]], [50, 40, 60],
              lanes=(2, 1)),
    ]  # fmt: skip
    return City(roads, junctions, CANVAS_M)
