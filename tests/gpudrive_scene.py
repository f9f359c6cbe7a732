"""A made-up Waymo scene in GPUDrive's JSON: a bend of two lanes with a median and a driveway.

The road is a quarter of a ring round (cx, cy), driven counter-clockwise on the outer half and back
on the inner one; its edges are open lines with the road on their left.
"""

import json
import math

import numpy as np

STEPS = 91
CENTRE = (8000.0, -2500.0)
INNER, MEDIAN, OUTER = 20.0, (29.5, 30.5), 40.0
DRIVEWAY = [(41.0, 5.0), (38.0, 5.0), (38.0, 9.0), (55.0, 9.0), (55.0, 5.0)]
NOT_VALID = -10000.0


def _arc(radius, start, end, count=60):
    angles = np.radians(np.linspace(start, end, count))
    return [
        {"x": CENTRE[0] + radius * math.cos(a), "y": CENTRE[1] + radius * math.sin(a), "z": 0.5}
        for a in angles
    ]


def inside(points):
    """Whether places [N, 2] of the scene's own frame are on the drawn road; NaN near its ends."""
    x, y = points[:, 0], points[:, 1]
    radius, angle = np.hypot(x, y), np.degrees(np.arctan2(y, x))
    ring = (radius > INNER) & (radius < OUTER)
    ring &= (radius < MEDIAN[0]) | (radius > MEDIAN[1])
    driveway = (x > 38) & (x < 55) & (y > 5) & (y < 9)
    said = (angle > 12) & (angle < 78)
    return np.where(said | driveway, (ring & said) | driveway, np.nan)


def road_user(identity, place, heading, velocity, valid=True, kind="vehicle", size=(4.6, 2.0, 1.5)):
    """An object by places [T, 3], headings [T] and velocities [T, 2], nowhere where not valid."""
    valid = np.broadcast_to(valid, len(place))
    place, velocity = (np.where(valid[:, None], of, NOT_VALID) for of in (place, velocity))
    position = [dict(zip("xyz", row, strict=True)) for row in place.tolist()]
    return {
        "id": identity,
        "type": kind,
        **dict(zip(("length", "width", "height"), size, strict=True)),
        "position": position,
        "heading": np.where(valid, heading, NOT_VALID).tolist(),
        "velocity": [dict(zip("xy", row, strict=True)) for row in velocity.tolist()],
        "valid": valid.tolist(),
        "goalPosition": position[-1],
        "mark_as_expert": False,
    }


def vehicle(identity, radius, speed, start_deg, *, first=0, last=STEPS - 1, kind="vehicle"):
    """A road user that drives along a circle, counter-clockwise where the speed is positive."""
    steps = np.arange(STEPS)
    turned = math.radians(start_deg) + speed * steps * 0.1 / radius
    heading = turned + math.copysign(math.pi / 2, speed)
    out, along = (np.stack([np.cos(a), np.sin(a)], 1) for a in (turned, heading))
    place = np.column_stack([CENTRE + radius * out, np.full(STEPS, 0.5)])
    valid = (first <= steps) & (steps <= last)
    size = (4.6, 2.0, 1.5) if kind == "vehicle" else (0.8, 0.6, 1.5)
    wrapped = np.angle(np.exp(1j * heading))
    return road_user(identity, place, wrapped, abs(speed) * along, valid, kind, size)


def scene():
    """The file's contents."""
    lines = [
        ("lane", 2, _arc(35.0, 0, 45, 30)),
        ("lane", 2, _arc(35.0, 45, 90, 30)),
        ("lane", 2, _arc(25.0, 90, 0)),
        ("lane", 3, _arc(39.5, 0, 90)),
        ("road_edge", 15, _arc(OUTER, 0, 90)),
        ("road_edge", 15, _arc(INNER, 90, 0)),
        (
            "road_edge",
            16,
            _arc(MEDIAN[0], 10, 80) + _arc(MEDIAN[1], 80, 10) + _arc(MEDIAN[0], 10, 11, 2),
        ),
        ("road_line", 7, _arc(33.0, 0, 90)),
        ("road_line", 11, _arc(30.0, 0, 90)),
        ("crosswalk", 18, _arc(34.0, 20, 24, 3) + _arc(36.0, 24, 20, 3)),
        ("driveway", 20, [{"x": CENTRE[0] + x, "y": CENTRE[1] + y, "z": 0.0} for x, y in DRIVEWAY]),
        ("stop_sign", 17, _arc(41.0, 80, 80, 1)),
        ("speed_bump", 19, _arc(35.0, 60, 61, 4)),
    ]
    return {
        "name": "tfrecord-00000-of-00150",
        "scenario_id": "a1b2c3",
        "objects": [
            vehicle(11, 25.0, -6.0, 85.0, first=3, last=60),
            vehicle(7, 35.0, 5.0, 8.0),
            vehicle(12, 39.4, 3.0, 20.0, kind="cyclist"),
            vehicle(13, 42.0, -1.0, 50.0, kind="pedestrian"),
            vehicle(14, 36.0, 1.0, 30.0, first=5, last=5),
        ],
        "roads": [
            {"type": kind, "map_element_id": element, "id": i, "geometry": points}
            for i, (kind, element, points) in enumerate(lines)
        ],
        "tl_states": {},
        "metadata": {
            "sdc_track_index": 1,
            "objects_of_interest": [],
            "tracks_to_predict": [{"track_index": 1, "difficulty": 0}],
        },
    }


def save(path, data=None):
    """Write a file as the field's have it."""
    path.write_text(json.dumps(scene() if data is None else data), encoding="utf-8")
    return path
