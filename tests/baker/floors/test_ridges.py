"""Tops of walls and beams narrower than 0.4 m are no floors, also where a step leads to them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import navbake
from box_worlds import box, world
from project_paths import SHARED_DATA

REPORT = SHARED_DATA / "reports/wall_tops/office.xml"


def wall_with_stairs(folder, width, height=1.0):
    """A wall along y in the middle of a floor, with treads of 0.2 m up to it."""
    parts = box("floor", -3, -2, -0.1, 3, 2, 0) + box("wall", 0, -2, 0, width, 2, height)
    for number in range(1, round(height / 0.2)):
        x = -0.3 * (round(height / 0.2) - number)
        parts += box(f"tread {number}", x, -0.5, 0, x + 0.3, 0.5, 0.2 * number)
    path = folder / "wall.xml"
    path.write_text(world(parts), encoding="utf-8")
    return path


def top_area(grid, height=1.0):
    return sum(
        float((level.free & np.isclose(level.floor_height, height, atol=1e-3)).sum())
        * level.cell_size**2
        for level in grid.levels
    )


@pytest.mark.parametrize(("width", "is_floor"), [(0.1, False), (0.2, False), (0.3, False),
                                                 (0.5, True), (0.8, True)])  # fmt: skip
def test_a_walls_top_is_a_floor_from_its_width_on(tmp_path, width, is_floor):
    path = wall_with_stairs(tmp_path, width)
    grid = navbake.bake(path)
    assert (top_area(grid) > 0.9 * width * 4) == is_floor
    # beside the uppermost tread, 1 m long, the wall's top is one more tread
    assert is_floor or top_area(grid) <= 1.1 * max(width, 0.1)
    assert navbake.verify(grid, path, sample=None).ok


@pytest.mark.parametrize(("height", "landing"), [(0.8, 0.6), (1.1, 0.88)])
@pytest.mark.parametrize("cell_size", [0.05, 0.1])
def test_no_floor_goes_on_from_a_landing_along_a_walls_top(tmp_path, height, landing, cell_size):
    """Under the wall is no floor that could go on in place of it."""
    parts = box("west", 0, 0, -0.1, 5, 4, 0) + box("east", 5.1, 0, -0.1, 8, 4, 0)
    parts += box("wall", 5, 0, 0, 5.1, 4, height) + box("landing", 3, 0, 0, 5, 1.2, landing)
    num_treads = round(landing / 0.2)
    for number in range(1, num_treads):
        x = 3 - 0.28 * (num_treads - number)
        top = landing * number / num_treads
        parts += box(f"tread {number}", x, 0, 0, x + 0.28, 1.2, top)
    path = tmp_path / "garden.xml"
    path.write_text(world(parts), encoding="utf-8")
    grid = navbake.bake(path, grid={"cell_size": cell_size})
    # the landing is 1.2 m deep: beside it, the wall's top is one more tread
    assert top_area(grid, height) <= 1.25 * 0.1
    finder = navbake.PathFinder(grid)
    assert finder.find_path((1, 2, 0), (4.5, 0.6, landing)) is not None
    assert not grid.at((5.05, 3.5, height)).free
    assert finder.find_path((4, 3, 0), (6, 3, 0)) is None
    assert navbake.verify(grid, path, sample=None).ok


def test_settings_keep_a_ridge(tmp_path):
    path = wall_with_stairs(tmp_path, 0.2)
    assert top_area(navbake.bake(path, floors={"tops": True})) > 0.7
    assert top_area(navbake.bake(path, floors={"from": [[0.1, 1.5, 1.0]]})) > 0.45


@pytest.mark.skipif(not REPORT.exists(), reason="needs shared/data")
def test_the_walls_of_an_office_stay_walls():
    grid = navbake.bake(REPORT)
    assert top_area(grid, 2.5) < 0.5
    assert len([room for room in grid.rooms if not room.outdoors]) == 2
    assert navbake.verify(grid, REPORT).ok


def test_a_scene_of_ridges_alone_says_what_keeps_them():
    beam = '<mujoco><worldbody><geom type="box" size="4 .15 .5"/></worldbody></mujoco>'
    spec = mujoco.MjSpec.from_string(beam)
    floors = {"min_area": 0.1, "shrink": 0.0}
    with pytest.raises(navbake.SceneError, match=r"narrower than 0\.4 m .*`floors\.tops: true`"):
        navbake.bake(spec, floors=floors)
    assert navbake.bake(spec, floors={**floors, "tops": True}).levels[0].free.all()


@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 70.0])
def test_the_corners_of_a_tier_are_floor_however_it_is_turned(angle):
    """A line across a corner is short between two drops, but a corner is no wall."""
    tier = f'<geom type="box" size="3 1 .2" pos="0 0 .2" euler="0 0 {angle}"/>'
    step = f'<body euler="0 0 {angle}"><geom type="box" size=".6 .25 .1" pos="0 1.25 .1"/></body>'
    ground = '<geom type="box" size="5 5 .05" pos="0 0 -.05"/>'
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><worldbody>{ground}{tier}{step}</worldbody></mujoco>"
    )
    level = navbake.bake(spec).levels[0]
    assert (abs(level.floor - 0.4) < 1e-6).sum() == pytest.approx(1200, abs=45)
    corner = np.radians(angle)
    x, y = 2.9 * np.cos(corner) - 0.9 * np.sin(corner), 2.9 * np.sin(corner) + 0.9 * np.cos(corner)
    assert level.at((x, y, 0.4)).floor == pytest.approx(0.4)
