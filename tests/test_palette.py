"""Colours of drivers are told apart by everybody, on both grounds."""

import itertools

import numpy as np
import pytest

from ccdiff_env.bench.plots import LOOKS, REST, colours
from ccdiff_env.view import render

#: Machado, Oliveira and Fernandes (2009), severity 1, on linear light.
SEEN = {
    "all": np.eye(3),
    "no green": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "no red": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
}
#: From linear sRGB to XYZ, white of D65.
XYZ = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
LEAST = 12.0  #: CIE 1976 distance of two colours, at least.


def lab(rgb, seen):
    """L*, a*, b* of a colour as it is seen."""
    part = np.array(rgb) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    x, y, z = XYZ @ np.clip(seen @ linear, 0.0, 1.0) / [0.9505, 1.0, 1.089]
    fx, fy, fz = (
        t ** (1 / 3) if t > 216 / 24389 else (24389 / 27 * t + 16) / 116 for t in (x, y, z)
    )
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


@pytest.mark.parametrize("seen", SEEN)
@pytest.mark.parametrize("theme", render.THEMES)
def test_any_two_drivers_are_told_apart(theme, seen):
    legend = render.legend(theme)
    found = {name: lab(legend[name], SEEN[seen]) for name in (*render.DRIVERS, "static obstacle")}
    for one, other in itertools.combinations(found, 2):
        assert np.linalg.norm(found[one] - found[other]) > LEAST, (one, other)


def test_charts_have_the_colours_of_images_and_orange_is_for_attacks_alone():
    names = {colour for colour, _ in LOOKS.values()} | {*REST}
    assert "adversary" not in names
    for i, theme in enumerate(render.THEMES):
        legend = render.legend(theme)
        for name in names:
            assert colours()[name][i] == f"#{bytes(legend[name]).hex()}"
    assert len({*LOOKS.values()}) == len(LOOKS)
