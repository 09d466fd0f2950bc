"""Pictures of flights: where things are on them, by their pixels."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
from PIL import Image

import navbake
from navbake.errors import MissingDependencyError
from navbake.views.flight import draw_flight

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def hall():
    """4 × 2 × 2 m, with a wall up to 1 m in the middle."""
    occupied = np.zeros((40, 20, 20), dtype=bool)
    occupied[20, :, :10] = True
    return navbake.VoxelGrid(values=occupied, origin=(0.0, 0.0, 0.0), res=0.1)


@pytest.fixture(scope="module")
def flight(hall):
    return navbake.VoxelFinder(hall, 0.2).find_path((0.5, 1.0, 0.5), (3.5, 1.0, 0.5))


def draw(*content):
    picture = Image.open(io.BytesIO(draw_flight(*content))).convert("RGB")
    return np.asarray(picture).astype(int)


def test_both_maps_have_one_scale_and_the_tube_the_balls_width(hall, flight):
    pixels = draw(hall, flight, "hall")
    red, green, blue = pixels.transpose(2, 0, 1)
    is_tube = blue - red > 25
    per_metre = 150 * (8.3 - 1.1) / 4.0  # the hall is wider than the path is long
    # between start and wall, the plan's tube runs along x: as high as the ball
    column = is_tube[:, int(150 * 0.55 + 1.2 * per_metre)]
    plan = column[: int(150 * 0.6 + 2.1 * per_metre)]
    assert plan.sum() == pytest.approx(0.4 * per_metre, abs=8)
    # the wall is 2 m long from above, and 1 m high in the section
    is_gray = (red == green) & (green == blue)
    wall_x = int(150 * 0.55 + 2.02 * per_metre)
    assert (is_gray & (red > 100) & (red < 230))[:, wall_x].sum() > 1.2 * per_metre
    is_section_gray = is_gray & (abs(red - 90) < 3)
    wall_height = is_section_gray.sum(axis=0).max() / per_metre  # the tube hides its top corners
    assert 0.8 < wall_height < 1.03


def test_a_title_changes_the_heading_alone(hall, flight):
    named, bare = draw(hall, flight, "hall"), draw(hall, flight)
    rows = np.flatnonzero((named != bare).any(axis=(1, 2)))
    assert 0 < len(rows) < 40 and rows.max() < 60


def test_a_flight_of_no_length_is_drawn(hall):
    path = navbake.VoxelFinder(hall, 0.2).find_path((0.5, 1.0, 0.5), (0.5, 1.0, 0.5))
    assert draw(hall, path).shape[1] == 1245


def test_without_the_extra_it_says_what_to_install(hall, flight, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependencyError, match=r"navbake\[plot\]"):
        draw_flight(hall, flight)
